"""Work in processes: as in one, an error of any ends all, and nothing outlives who asked for it."""

from __future__ import annotations

import math
import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from vpptwin.system.errors import InputError
from vpptwin.system.files import check_own
from vpptwin.system.jobs import read_jobs, share_out

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_item_once(jobs: int) -> None:
    """With its number, in whatever order."""
    assert dict(share_out(math.sqrt, [1.0, 4.0, 9.0], jobs)) == {0: 1.0, 1: 2.0, 2: 3.0}


def test_bad_input_stays_what_it_is(tmp_path: Path) -> None:
    """From another process too; by then that is ended."""
    mine = tmp_path / "mine.json"
    mine.write_text("mine")
    with pytest.raises(InputError) as here:
        check_own([mine])
    assert str(pickle.loads(pickle.dumps(here.value))) == str(here.value)
    with pytest.raises(InputError) as there:
        dict(share_out(check_own, [[], [mine]], 2))
    assert str(there.value) == str(here.value)
    assert not [child for child in psutil.Process().children() if "spawn_main" in " ".join(child.cmdline())]


@pytest.mark.slow
def test_work_by_ray(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same by Ray's processes on this machine, which end with the work."""
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    assert dict(share_out(math.sqrt, [1.0, 4.0, 9.0], "ray")) == {0: 1.0, 1: 2.0, 2: 3.0}
    mine = tmp_path / "mine.json"
    mine.write_text("mine")
    with pytest.raises(InputError, match=r"mine\.json is there, and vpptwin did not write it"):
        dict(share_out(check_own, [[mine]], "ray"))
    children = psutil.Process().children(recursive=True)
    _, alive = psutil.wait_procs([child for child in children if "ray" in " ".join(child.cmdline())], 10.0)
    assert alive == []


def test_a_process_that_ends_is_told() -> None:
    """As when memory runs out, in a line."""
    with pytest.raises(InputError, match="a process ended"):
        dict(share_out(os._exit, [1, 1], 2))


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_nothing_is_left_running(number: int) -> None:
    """Whatever ends the process that shared out the work."""
    script = "if __name__ == '__main__':\n import time; from vpptwin.system.jobs import share_out\n"
    script += " dict(share_out(time.sleep, [90, 90], 2))"
    parent = subprocess.Popen([sys.executable, "-c", script], env={**os.environ, "PYTHONPATH": str(ROOT)})
    deadline = time.monotonic() + 60.0
    children: list[psutil.Process] = []
    while len(children) < 2 and time.monotonic() < deadline:
        time.sleep(0.1)
        every = psutil.Process(parent.pid).children(recursive=True)
        children = [child for child in every if "spawn_main" in " ".join(child.cmdline())]
    assert len(children) == 2
    time.sleep(2.0)  # until they have begun
    parent.send_signal(number)
    parent.wait(20)
    _, alive = psutil.wait_procs(children, 20)
    assert alive == []


@pytest.mark.parametrize("text", ["0", "-1", "two", "1.5", "", "99999"])
def test_numbers_of_jobs(text: str) -> None:
    """Processes are counted from 1."""
    with pytest.raises(InputError, match="1 to 1024 processes, or ray"):
        read_jobs(text)
    assert (read_jobs("3"), read_jobs("ray")) == (3, "ray")
