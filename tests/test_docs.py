"""Commands in README and docs are ones that the command line takes, and files that they link to exist."""

from __future__ import annotations

import re
import shlex
import tomllib
from functools import reduce
from importlib import import_module
from pathlib import Path

import pytest
import yaml

from vpptwin import __version__
from vpptwin.cli.main import build_parser
from vpptwin.train.main import parse_overrides
from vpptwin.twin import load_twin

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    [
        *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
        *(page for pattern in ("*.md", "tutorials/*.md") for page in (ROOT / "docs").glob(pattern)),
        *(ROOT / "examples").glob("*/README.md"),
    ]
)


def find_commands(text: str) -> list[str]:
    """What follows `vpptwin` in indented blocks, and in code spans that are whole commands."""
    blocks = re.findall(r"^ {4}(?:[A-Z_]+=\S+ )?vpptwin (.*?)(?: {2,}#.*)?$", text, flags=re.MULTILINE)
    spans = [span for span in re.findall(r"`vpptwin ([^`]*)`", text) if " " in span and "|" not in span]
    return [command for command in [*blocks, *spans] if "..." not in command and "…" not in command]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_are_understood(page: Path) -> None:
    """Every command of a page parses; overrides of `train` name options that exist."""
    for command in find_commands(page.read_text(encoding="utf-8")):
        words = shlex.split(command)
        if words[0] == "train":
            parse_overrides([word for word in words[1:] if not word.startswith("-")])
        else:
            build_parser().parse_args(words)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    """Pictures, pages and files that a page links to are there."""
    links = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    missing = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert missing == []


def find_name(name: str) -> object:
    """A module, or what it holds: a function, a class, a value.

    Raises:
        AttributeError: if there is none.
    """
    module, rest = name, ""
    while True:
        try:
            found: object = import_module(module)
            break
        except ModuleNotFoundError:
            module, _, last = module.rpartition(".")
            rest = f"{last}.{rest}" if rest else last
    return reduce(getattr, rest.split(".") if rest else [], found)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_code_that_pages_name_exists(page: Path) -> None:
    """Names of the package, files of the repository, scripts and their options."""
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"`(vpptwin(?:\.\w+)*\.\w{2,})`", text):  # a file `vpptwin.h` is none
        find_name(name)
    paths = re.findall(r"`((?:vpptwin|models|benchmarks|proving|tests|demo)/[\w./-]+\.\w+)`", text)
    scripts = re.findall(r"\b(?:python|pytest) ((?:benchmarks|tests|examples)/[\w/]+\.py)([^`\n]*)", text)
    assert [path for path in [*paths, *(script for script, _ in scripts)] if not (ROOT / path).exists()] == []
    for script, options in scripts:
        known = "".join(p.read_text() for p in [ROOT / script, *(ROOT / script).parent.glob("*/*.py")])
        assert [o for o in re.findall(r"--[a-z][\w-]*", options.split("#")[0]) if f'"{o}"' not in known] == [], script


def test_the_whole_paper_is_on_its_page() -> None:
    """Every equation, figure and table that the paper labels."""
    paper = ROOT.parent / "shared/paper.tex"
    if not paper.exists():
        pytest.skip("needs ../shared/paper.tex")
    labels = set(re.findall(r"\\label\{(\w+)\}", paper.read_text(encoding="utf-8")))
    labels = {label for label in labels if not label.startswith("sec_")} - {"Adaptive_Actuator_Controller"}
    told = (ROOT / "docs/paper.md").read_text(encoding="utf-8")
    assert len(labels) == 18
    assert {label for label in labels if f"`{label}`" not in told} == set()


def test_the_readme_counts_the_effects() -> None:
    """As many as the nominal drone may have."""
    counted = re.search(r"a planar drone with (\d+) effects", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert counted is not None
    assert int(counted[1]) == len(load_twin().catalogue)


def test_the_citation_is_of_this_version() -> None:
    """CITATION.cff has what its format requires, the package's version and licence, and the paper."""
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(cited)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (cited["version"], cited["license"]) == (__version__, project["license"])
    assert cited["references"][0]["url"] == project["urls"]["Paper"]
    assert [author["family-names"] for author in cited["references"][0]["authors"]] == ["Wang", "Zhao"]


def test_enough_is_found() -> None:
    """The pages' commands are seen at all."""
    assert sum(len(find_commands(page.read_text(encoding="utf-8"))) for page in PAGES) > 60
