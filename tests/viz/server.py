"""A Python program that prints where it serves, run until it is interrupted as by Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]


def hear_interrupts() -> None:
    """A shell starts what runs in the background deaf to Ctrl-C, and its children are so too."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def serve(*arguments: str, said: str = "") -> Iterator[str]:
    """Run `python ARGUMENTS`; the address on the first line that says `said`. Interrupted it has to end quietly."""
    server = subprocess.Popen(
        [sys.executable, "-u", *arguments], stdout=subprocess.PIPE, text=True, cwd=ROOT, preexec_fn=hear_interrupts
    )
    assert server.stdout is not None
    try:
        yield next(line.split()[0] for line in server.stdout if line.startswith("http") and said in line)
    finally:
        os.kill(server.pid, signal.SIGINT)
    assert server.wait(20) == 0
