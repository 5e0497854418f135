"""Ctrl-C, SIGTERM and effects that fail in mid-flight: one line, the exit code of it, nothing left behind."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.twin.own_effect_files import WAVE
from vpptwin.system.errors import InputError
from vpptwin.system.files import DRAFTS, LEFT, replace_files
from vpptwin.system.signals import defer_signal, heed_signals
from vpptwin.twin import load_twin

ROOT = Path(__file__).resolve().parents[1]
STOPPED = "vpptwin: stopped\n"
FAILING = WAVE.replace("slide", "rail_x").replace(
    "    return -force",
    """    if abs(motion.position - 0.3) < 0.01:
        if force == 0.71:
            raise ValueError("boom")
        if force == 0.72:
            return np.nan
        while force == 0.73:
            force = force * 1.0
    return -force""",
)
"""It fails where a flight of x_steps gets to and the trial does not, at forces that nobody tries."""


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """A command in a folder, which is on its path."""
    environment = {**os.environ, "PYTHONPATH": f"{folder}:{ROOT}"}
    command = [sys.executable, "-m", "vpptwin", *arguments]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder, env=environment
    )


def finish(child: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit code and what it said on stderr, but for what it compiled."""
    said = child.communicate(timeout=120)[1]
    return child.returncode, re.sub(r"^vpptwin: compiling .*\n", "", said, flags=re.MULTILINE)


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait until something is so, a minute at most."""
    until = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.01)


@pytest.fixture(scope="module")
def failing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with effects that fail in flight: one file, so that its step is compiled once."""
    folder = tmp_path_factory.mktemp("failing")
    (folder / "own.py").write_text(FAILING)
    return folder


def start_flight(folder: Path, force: float) -> subprocess.Popen[str]:
    """A flight with such an effect, at a force [N]."""
    drone = "model: rail_rig.xml\nvehicle: vehicle.yaml\n"
    (folder / "twin.yaml").write_text(drone + f"effects: {{rail_x.wave: {{force: {force}}}}}\neffects_from: [own.py]\n")
    flown = "fly --manoeuvre x_steps --duration 5 --twin twin.yaml --effects own.py --out flight.mcap"
    return start(folder, *flown.split())


@pytest.mark.parametrize(
    ("where", "how"),
    [
        ("import", signal.SIGINT), ("finalizer", signal.SIGINT), ("swallowed", signal.SIGINT),
        pytest.param("import", signal.SIGTERM, marks=pytest.mark.slow),
        pytest.param("import", signal.SIGHUP, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_a_signal_is_one_line_wherever_it_comes(tmp_path: Path, how: signal.Signals, where: str) -> None:
    """While a module is imported, in a finalizer, in a block that takes it for something else."""
    kill = f"os.kill(os.getpid(), {int(how)})"
    if where == "import":
        (tmp_path / "slow.py").write_text(
            f"import os\ntry:\n    {kill}\nexcept BaseException:\n    raise ImportError\n"
        )
        text = "import slow\n"
    elif where == "finalizer":
        text = f"import os\nclass A:\n    def __del__(self):\n        {kill}\na = A()\ndel a\n"
    else:
        text = f"import os\ntry:\n    {kill}\nexcept BaseException:\n    pass\nraise ValueError\n"
    (tmp_path / "own.py").write_text(text)
    assert finish(start(tmp_path, "effects", "--effects", "own.py")) == (128 + how, STOPPED)


def test_the_line_is_one_of_its_own_behind_a_bar(tmp_path: Path) -> None:
    """Where the process ends at once nobody closes the bar."""
    (tmp_path / "slow.py").write_text("import os\nos.kill(os.getpid(), 2)\n")
    (tmp_path / "own.py").write_text("import sys\nprint('\\rbar', end='', file=sys.stderr)\nimport slow\n")
    assert finish(start(tmp_path, "effects", "--effects", "own.py")) == (130, f"\nbar\n{STOPPED}")


@pytest.mark.parametrize("how", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_signal_leaves_no_drafts(tmp_path: Path, how: signal.Signals) -> None:
    """A diagnosis that is stopped in mid-search: its folder, which it made, is gone."""
    child = start(tmp_path, "diagnose", str(ROOT / "demo/flights/flip.mcap"), "--out", "out")
    wait_for(lambda: any((tmp_path / "out").glob(f"{DRAFTS}*")))
    child.send_signal(how)
    child.send_signal(how)  # the same impatience
    code, said = finish(child)
    assert code == 128 + how
    assert said.splitlines(keepends=True)[-1] == STOPPED
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("force", "said"), [(0.71, "own.py:9: ValueError: boom; "), pytest.param(0.72, "diverges ", marks=pytest.mark.slow)]
)
def test_effects_that_raise_or_make_no_number_in_flight_end_it(failing: Path, force: float, said: str) -> None:
    """No log is written of a flight that cannot be believed."""
    code, line = finish(start_flight(failing, force))
    assert code == 2
    assert line.count("\n") == 1, line
    assert said in line
    assert not (failing / "flight.mcap").exists()


@pytest.mark.slow
def test_compiled_code_that_does_not_end_is_not_waited_for(failing: Path) -> None:
    """An effect with a loop that ends everywhere but in flight: Ctrl-C works nevertheless."""
    child = start_flight(failing, 0.73)
    with pytest.raises(subprocess.TimeoutExpired):
        child.wait(10.0)
    child.send_signal(signal.SIGINT)
    began = time.monotonic()
    assert finish(child) == (130, STOPPED)
    assert time.monotonic() - began < 10.0
    assert not (failing / "flight.mcap").exists()


@pytest.mark.parametrize("taken", [True, False])
def test_a_signal_that_is_deferred_interrupts_nothing_and_the_next_one_does(
    monkeypatch: pytest.MonkeyPatch, taken: bool
) -> None:
    """Where it is taken; one that is not, and one behind the block, interrupt as ever."""
    monkeypatch.setattr("vpptwin.system.signals.AGAIN", 0.0)
    told: list[int] = []

    def take(number: int) -> bool:
        told.append(number)
        return taken

    with heed_signals() as heard:
        with defer_signal(take):
            if taken:
                os.kill(os.getpid(), signal.SIGTERM)
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGHUP)
    assert heard == [signal.SIGINT, signal.SIGHUP]
    assert told == [signal.SIGTERM if taken else signal.SIGINT]


def test_effects_that_never_return_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled, and as Python: a line names them."""
    monkeypatch.setattr("vpptwin.twin.robot.effect_trial.LONGEST", 5.0)
    endless = WAVE.replace("slide", "rail_x").replace(
        "    return -force", "    while force > -1.0:\n        force = 1.0\n    return -force"
    )
    (tmp_path / "own.py").write_text(endless)
    with pytest.raises(InputError, match=r"rail_x\.wave has not returned within 5 s; .* a loop that does not end"):
        load_twin("nominal", [tmp_path / "own.py"])


def test_drafts_of_the_killed_go(tmp_path: Path) -> None:
    """Those of yesterday, not those of a run that may be going on."""
    for name, age in (("old", 2.0 * LEFT), ("new", 0.5 * LEFT)):
        (tmp_path / f"{DRAFTS}{name}").mkdir()
        os.utime(tmp_path / f"{DRAFTS}{name}", (0.0, time.time() - age))
    with replace_files(tmp_path, ["a"]) as drafts:
        (drafts / "a").touch()
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{DRAFTS}new", "a"]
    # A device in the place of a result, which a user with all rights could lose.
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="is no file"), replace_files(tmp_path, ["pipe"]):
        pass
    assert (tmp_path / "pipe").is_fifo()
