"""Whatever is spoilt in a log, a twin, a model or a checkpoint: it works, or one line says what is wrong, soon."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from proving.fuzzers import DRAW
from tests.measured import read_peak
from vpptwin.logs import read_flight
from vpptwin.logs.spelling import list_flights
from vpptwin.mapping.survey import survey
from vpptwin.system.errors import InputError
from vpptwin.train.evaluate.evaluate import Conditions, evaluate
from vpptwin.train.learn.checkpoint import build_policy, read_checkpoint
from vpptwin.twin import Twin, load_twin

ROUNDS = 15
"""Of the seed of this run, forty of another one."""


def fly_twin(path: Path) -> None:
    """Load a twin, and step it where it is the drone."""
    spec = load_twin(path)
    if spec.robot.rotorcraft is not None:
        twin = Twin(spec, 1, num_threads=1)
        twin.step_policy(twin.initial_state(), np.array([[5.0, 0.0]]), 0.01)


def fly_checkpoint(path: Path) -> None:
    """Build the policy of a checkpoint, and fly it in the nominal twin."""
    _, trained = build_policy(read_checkpoint(path), path)
    if trained.task.episode <= 6.0:
        evaluate(path, Conditions(tracks=1, twin="nominal"))


def look(path: Path) -> None:
    """Look at all flights of a folder."""
    for flight in list_flights(path):
        survey(flight)


USES: dict[str, Callable[[Path], object]] = {
    "log": read_flight, "twin": fly_twin, "model": fly_twin, "checkpoint": fly_checkpoint,
    "set": look, "bag": read_flight, "parts": fly_twin, "table": look,
}  # fmt: skip


def use(kind: str, path: Path) -> str:
    """What becomes of a file: the line that refuses it, or nothing; anything else fails."""
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
    held, began = read_peak(os.getpid()), time.process_time()
    try:
        USES[kind](path)
        line = ""
    except InputError as error:
        line = str(error)
    assert "\n" not in line
    assert line.isprintable(), line
    assert not line or len(line.split("; ")) >= 3, line
    assert len(line) < 4000
    assert time.process_time() - began < 20.0, line
    assert read_peak(os.getpid()) < held + 1000.0, line
    return line


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("seed", "rounds"), [pytest.param("25", 40, marks=pytest.mark.slow), (os.environ["VPPTWIN_SEED"], ROUNDS)]
)
@pytest.mark.parametrize("kind", DRAW)
def test_spoilt_files_are_refused_or_work(
    kind: str, seed: str, rounds: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some of each kind from the seed of this run; more of another one are `slow`."""
    monkeypatch.chdir(tmp_path)
    lines = []
    for number in range(rounds):
        path = DRAW[kind](np.random.default_rng([int(seed), number]), tmp_path)
        lines.append(use(kind, path))
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert sum(map(bool, lines)) > rounds / 4  # most of them are of no use
    assert "this ran" not in "".join(lines)
    assert "root:x:" not in "".join(lines)  # somebody's file
