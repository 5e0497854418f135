# What CI runs is what `make` runs. Everything lives in .venv; `make help` lists the targets.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory
# Modules are compiled when first imported (see `install`): where nothing may be kept of that, as containers like to have
# it, every process compiles numpy, numba and torch again, 10 s each.
export PYTHONDONTWRITEBYTECODE :=

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# 3.11 first: it is the version that the pinned wheels are tested with. Override: make install PYTHON=/path/to/python
PYTHON ?= $(firstword $(foreach name,python3.11 python3 python3.12 python3.13 python3.14 python,\
	$(shell $(name) -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && echo $(name))))
# Where pip looks for torch besides PyPI, whose Linux build brings several GB of CUDA.
# For a small download: make install TORCH_INDEX=https://download.pytorch.org/whl/cpu
TORCH_INDEX ?=
# Which tests: make test SELECT='slow' runs the long sweeps, SELECT='' everything.
SELECT ?= not slow
PYTEST_ARGS ?=

.PHONY: help install demo test night newest check docs format lock repository clean distclean

help: ## this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(firstword $(MAKEFILE_LIST))

install: $(STAMP) ## everything into .venv, with the pinned versions

# The stamp is written last, so that an install that failed or was interrupted is taken up again.
# torch goes in alone and first: asked for as a range it would be replaced by the newest build. Modules are compiled when
# they are first imported: of all 23 000 that takes a minute, and most never are.
$(STAMP): pyproject.toml constraints.txt
	@if [[ -z "$(PYTHON)" ]]; then \
		echo "vpptwin needs Python 3.11 or newer, found $$(python3 --version 2>&1 || echo none);" \
			"install one, or name it: make install PYTHON=/path/to/python3.11" >&2; exit 1; fi
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo "vpptwin needs Python 3.11 or newer, and $(PYTHON) is $$($(PYTHON) --version 2>&1 || true)" >&2; exit 1; }
	@$(BIN)/python -c 'import pip, sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || $(PYTHON) -m venv --clear $(VENV) || { \
		rm -rf $(VENV); echo "could not make $(VENV): on Debian and Ubuntu, apt install python3-venv" >&2; exit 1; }
	@echo "1 of 2: torch into $(VENV) (the largest download)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)) \
		--constraint constraints.txt "$$(grep '^torch==' constraints.txt)"
	@echo "2 of 2: vpptwin and everything else that it can use into $(VENV)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt --editable '.[dev]'
	@touch $@

demo: $(STAMP) ## diagnose the flights that ship with the project, write a report
	$(BIN)/vpptwin demo

# One thread per worker: two workers already fill two cores, and torch's own threads would fight them. A worker that
# dies ends the run: with another in its place xdist 3.8 waits for ever (pytest-dev/pytest-xdist#1378).
test: $(STAMP) ## all tests but the long sweeps (make test SELECT= runs those too)
	OMP_NUM_THREADS=1 MPLBACKEND=Agg $(BIN)/python -m pytest -n 2 --dist loadfile --max-worker-restart 0 --no-loadscope-reorder -m "$(SELECT)" $(PYTEST_ARGS)

night: $(STAMP) ## the long sweeps too, with a seed drawn for this run, which pytest prints
	$(MAKE) test SELECT= VPPTWIN_SEED=$$(od -An -N4 -tu4 /dev/urandom | tr -d ' ')

newest: $(STAMP) ## tests of the engine with the newest MuJoCo of the index, if that is not the pinned one
	OMP_NUM_THREADS=1 MPLBACKEND=Agg $(BIN)/python .ci/newest.py

check: $(STAMP) ## lint, format, types, words
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q -n 0 tests/test_words.py

docs: $(STAMP) ## the documentation site, into site/, to open from disk; warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "file://$(CURDIR)/site/index.html"

format: $(STAMP) ## let ruff format and fix what it can
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

lock: $(STAMP) ## write constraints.txt anew from what .venv holds now
	$(BIN)/python .ci/lock.py > constraints.txt.new
	mv constraints.txt.new constraints.txt
	@touch $(STAMP)

repository: $(STAMP) ## write where the repository lies into metadata, README, citation and site: make repository URL=https://...
	$(BIN)/python .ci/repository.py "$(URL)"

clean: ## remove what runs leave behind, keep .venv
	rm -rf out runs outputs build dist site .pytest_cache .mypy_cache .ruff_cache .hypothesis constraints.txt.new
	find vpptwin proving tests examples benchmarks -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true

distclean: clean ## clean, and remove .venv too
	rm -rf $(VENV)
