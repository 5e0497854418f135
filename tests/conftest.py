"""What every test may need: data outside the repository, and a browser."""

from __future__ import annotations

import os
import shutil
import signal
import sys
from pathlib import Path

import hypothesis
import numpy as np
import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


SEED = "1"
"""Of everything that tests draw, unless `VPPTWIN_SEED` names another, as `make night` does."""
hypothesis.settings.register_profile("same", derandomize=True, database=None)


def pytest_configure() -> None:
    """Fix the seed of what is hidden in flights, and the examples of hypothesis, unless a seed is given.

    Workers of xdist inherit it.
    """
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # what nohup has processes ignore, those that tests start ignore too
    if os.environ.setdefault("VPPTWIN_SEED", SEED) == SEED:
        hypothesis.settings.load_profile("same")


def pytest_report_header() -> str:
    """Print the seed, so that a run can be repeated even where nothing failed."""
    return f"VPPTWIN_SEED={os.environ['VPPTWIN_SEED']}"


@pytest.fixture(autouse=True)
def _same_draws() -> None:
    """What a test draws without a generator of its own does not depend on the tests before it."""
    seed = int(os.environ["VPPTWIN_SEED"])
    np.random.seed(seed)  # noqa: NPY002
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(seed)


@pytest.fixture(autouse=True)
def _trust_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """What one test lets run, no other does."""
    monkeypatch.setattr("vpptwin.system.trust._trusted", set())


@pytest.fixture(autouse=True)
def _compile_quietly(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test finds on standard error does not depend on what tests before it have compiled."""
    monkeypatch.setattr("vpptwin.system.progress.tell_line", lambda text: None)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of measured data beside the checkout; the test is skipped where there is none."""
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip(f"needs the measured data in {folder}")
    return folder


LONG = (
    "test_cli.py", "test_free_body.py", "test_hidden_effects.py", "estimation/test_gate.py",
    "test_hidden_mechanics.py", "test_kinds_diagnosed.py", "train/test_training.py", "test_tutorials.py",
    "twin/test_own_effects.py", "diagnosis/judgement/test_contradiction.py", "test_signals.py", "test_antx.py",
    "test_overwriting.py", "engine/test_cache.py", "twin/test_independent.py", "diagnosis/test_stopping.py",
    "viz/test_serve.py", "test_site.py", "pilot/test_flight.py", "logs/test_corruptions.py",
    "actuators/test_adaptive.py", "estimation/test_units.py", "logs/test_bombs.py", "train/test_config.py",
    "train/test_presets.py", "test_reality_log.py", "identification/test_history.py",
    "identification/test_identify.py", "identification/test_free_flight.py", "train/test_device_env.py",
    "diagnosis/judgement/test_other_motors.py", "diagnosis/report/test_output.py", "test_double_pendulum.py",
    "diagnosis/judgement/test_experiment.py", "test_mechanism_sessions.py", "train/test_ray.py",
    "train/test_resume.py", "test_simple_pendulum.py", "test_notebooks.py", "benchmarks/test_soak.py",
    "benchmarks/test_peers.py", "benchmarks/test_throughput.py",
)  # fmt: skip
"""Files that take longest, first: two workers that share them file by file are then done at about the same time.

The second and fourth need nothing of the drone: while one worker does them, the other compiles the drone's step, which
is on disk when both need it.
"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first; skip the tests marked `browser` where there is no Chromium."""
    place = {file: i for i, file in enumerate(LONG)}
    tests = Path(__file__).parent
    assert all((tests / file).is_file() for file in LONG), "LONG names a file that is gone"
    items.sort(key=lambda item: place.get(item.path.relative_to(tests).as_posix(), len(LONG)))
    if shutil.which("chromium"):
        return
    for item in items:
        if item.get_closest_marker("browser"):
            item.add_marker(pytest.mark.skip(reason="needs Chromium: apt install chromium"))
