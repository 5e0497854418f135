"""Signals that end a command: one line, nothing left behind, no traceback."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import NoReturn

from vpptwin.files import discard_all

AGAIN = 1.0
"""A signal so soon [s] after another is the same impatience; it interrupts no tidying up."""
PATIENCE = 3.0
"""Compiled code that has not come back so long [s] after a signal is not waited for."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def end(number: int) -> NoReturn:
    """End the process at once for a signal, without drafts left behind."""
    discard_all()
    with contextlib.suppress(OSError):
        os.write(2, b"vpptwin: stopped\n")
    os._exit(128 + number)


@contextlib.contextmanager
def heed_signals() -> Iterator[list[int]]:
    """Ctrl-C, SIGTERM and a closed terminal raise KeyboardInterrupt in the block; yields the numbers of what came.

    Where that would lead nowhere they end the process: while modules are imported, as libraries take what interrupts
    them for an error of their own; in finalizers, where Python prints and forgets it; in code that does not come back.
    """
    heard: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield heard
        return
    last, done = -math.inf, threading.Event()
    reader, writer = os.pipe()

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal last
        before, last = last, time.monotonic()
        if last > before + AGAIN:
            if is_importing(frame):
                end(number)
            heard.append(number)
            raise KeyboardInterrupt

    def watch() -> None:
        while number := os.read(reader, 1):
            came = time.monotonic()
            if not done.wait(PATIENCE) and last < came - AGAIN:
                end(number[0])

    def forget(lost: sys.UnraisableHookArgs) -> None:
        if isinstance(lost.exc_value, KeyboardInterrupt) and heard:
            end(heard[0])
        hook(lost)

    os.set_blocking(writer, False)
    heeded = [number for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    handlers = {number: signal.signal(number, stop) or signal.SIG_DFL for number in heeded}
    woken = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    hook, sys.unraisablehook = sys.unraisablehook, forget
    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield heard
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(woken)
        sys.unraisablehook = hook
        done.set()
        os.close(writer)
        watcher.join()
        os.close(reader)


def is_importing(frame: FrameType | None) -> bool:
    """Whether a module is being imported at a frame."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
