"""A command run as a user does, with what it cost: processor time and peak memory."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Cost:
    """Exit code, what was printed, processor time [s] and peak memory [MB]."""

    code: int
    out: str
    err: str
    seconds: float
    megabytes: float

    def check_refused(self, *parts: str) -> None:
        """Require exit code 2 and one line on standard error that holds these parts."""
        assert self.code == 2, self.err
        assert self.out == ""
        assert self.err.startswith("vpptwin: "), self.err
        assert self.err.count("\n") == 1, self.err
        for part in parts:
            assert part in self.err, self.err


def run_measured(*arguments: object, folder: Path, extra: Mapping[str, str] | None = None) -> Cost:
    """Run `vpptwin ARGUMENTS` in a folder, where its output stays out of the way."""
    out, err = folder / ".out", folder / ".err"
    command = [sys.executable, "-m", "vpptwin", *map(str, arguments)]
    with out.open("w") as to_out, err.open("w") as to_err:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), **(extra or {})}
        child = subprocess.Popen(command, stdout=to_out, stderr=to_err, cwd=folder, env=environment)
        peak, ended = 0.0, 0
        while not ended:  # `ru_maxrss` would count what this process held when it forked
            peak = max(peak, read_peak(child.pid))
            time.sleep(0.005)
            ended, status, usage = os.wait4(child.pid, os.WNOHANG)
    child.returncode = os.waitstatus_to_exitcode(status)
    seconds = usage.ru_utime + usage.ru_stime
    cost = Cost(child.returncode, out.read_text(), err.read_text(), seconds, peak)
    out.unlink()
    err.unlink()
    return cost


def read_peak(pid: int) -> float:
    """The most memory that a process has held so far [MB]; 0 where it is gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((float(line.split()[1]) / 1024.0 for line in lines if line.startswith("VmHWM")), 0.0)
