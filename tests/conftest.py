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


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of measured data beside the checkout; the test is skipped where there is none."""
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip(f"needs the measured data in {folder}")
    return folder


LONG = (
    "test_hidden_mechanics.py", "test_double_pendulum.py", "test_hidden_effects.py", "test_reality.py",
    "test_cli.py", "twin/test_own_effects.py", "effects/test_catalogue.py", "train/test_training.py",
    "test_own_effects.py", "train/test_ray.py", "test_free_body.py", "test_antx.py", "test_reality_log.py",
    "train/test_resume.py", "test_simple_pendulum.py", "engine/test_cache.py", "twin/test_independent.py",
    "test_mechanism_sessions.py", "test_other_rigs.py", "test_free_decay.py",
    "test_tutorials.py", "test_notebooks.py", "viz/test_serve.py", "viz/test_browser.py", "viz/test_live.py",
    "viz/test_frames.py", "test_mechanisms.py", "identification/test_identify.py", "identification/test_free_flight.py",
    "diagnosis/judgement/test_experiment.py", "diagnosis/search/test_doubt.py", "benchmarks/test_throughput.py",
    "benchmarks/test_peers.py",
    "benchmarks/test_soak.py", "test_fuzz.py", "test_signals.py", "actuators/test_adaptive.py",
)  # fmt: skip
"""Files that take longest, first: two workers that share them file by file are then done at about the same time.

The second and fourth need nothing that is compiled: while one worker does them, the other compiles the drone's step,
which is on disk when both need it.
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
