"""benchmarks/soak.py finds nothing in a few commands, and finds what ends badly."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import soak


@pytest.mark.slow
def test_a_few_commands_end_well(tmp_path: Path) -> None:
    """No traceback, no hang, no process, no file left behind."""
    (tmp_path / "out").mkdir()
    seed = int(os.environ["VPPTWIN_SEED"])
    for number in range(2):
        name, problems = soak.run_one(np.random.default_rng([seed, number]), tmp_path)
        assert problems == [], name


def test_what_is_not_whole_is_told(tmp_path: Path) -> None:
    """Half a log, half a page, no JSON, a draft."""
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n half")
    (tmp_path / "a.html").write_text("<html>half")
    (tmp_path / "a.json").write_text('{"a": NaN')
    (tmp_path / ".a.json.123").write_text("")
    assert sorted(problem.split(":")[0] for problem in soak.judge_files(tmp_path)) == [
        "left behind", "no JSON", "not whole", "not whole",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("code", "said"), [(1, "Traceback (most recent call last)"), (2, "no line of ours"), (0, "\x1b[2J")]
)
def test_commands_that_end_badly_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, said: str
) -> None:
    """A traceback, another line than ours, control characters."""
    (tmp_path / "out").mkdir()
    (tmp_path / "vpptwin").mkdir()
    (tmp_path / "vpptwin" / "__init__.py").touch()
    (tmp_path / "vpptwin" / "__main__.py").write_text(
        f"import sys\nprint({said!r}, file=sys.stderr)\nsys.exit({code})\n"
    )
    monkeypatch.setattr(soak, "ROOT", tmp_path)
    monkeypatch.setattr(soak, "draw_command", lambda rng, folder: ["fly"])
    _, problems = soak.run_one(np.random.default_rng(1), tmp_path)  # which is not killed
    assert problems


def test_kills_wait_until_signals_are_heeded(tmp_path: Path) -> None:
    """However slowly Python starts: a program that takes two seconds to catch SIGTERM gets it after that."""
    program = "import signal, sys, time\ntime.sleep(2)\nsignal.signal(signal.SIGTERM, lambda *_: sys.exit(7))\n"
    with subprocess.Popen([sys.executable, "-c", program + "time.sleep(100)"]) as child:
        soak.Kill(signal.SIGTERM, 0.0).wait(child, tmp_path)
        child.send_signal(signal.SIGTERM)
    assert child.returncode == 7


@pytest.mark.parametrize(
    ("name", "kills"),
    [("layouts", 10), *(pytest.param(*each, marks=pytest.mark.slow) for each in (("layouts", 30), ("compare", 4)))],
)
def test_what_is_killed_full_or_shared_stays_whole(tmp_path: Path, name: str, kills: int) -> None:
    """Kills, two processes in one place, disks that are full: the benchmark has the other commands."""
    rng = np.random.default_rng(int(os.environ["VPPTWIN_SEED"]))
    assert soak.try_kills(name, rng, tmp_path, kills) == []
    assert soak.try_pair(name, tmp_path) == []
    assert soak.try_disks(name, tmp_path) == []


@pytest.mark.slow
def test_halves_and_mixtures_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that writes in place: half a file after a kill, those of two runs after two at once."""
    (tmp_path / "vpptwin").mkdir()
    (tmp_path / "vpptwin" / "__init__.py").touch()
    program = """import signal, sys, time
signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
for name in ("ab" if sys.argv[1] == "1" else "ba"):
    with open(f"out/{name}", "w") as file:
        print(sys.argv[1], file=file, flush=True)
        time.sleep(0.5)
        print(sys.argv[1], file=file)
"""
    (tmp_path / "vpptwin" / "__main__.py").write_text(program)
    monkeypatch.setattr(soak, "ROOT", tmp_path)
    monkeypatch.setitem(soak.WRITING, "worse", ["SEED"])
    found = soak.try_kills("worse", np.random.default_rng(1), tmp_path, 12)
    assert any("neither old nor new" in problem for problem in found)
    assert any("two runs" in problem for problem in soak.try_pair("worse", tmp_path))
