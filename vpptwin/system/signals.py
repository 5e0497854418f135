"""Signals that end a command: one line, nothing left behind, no traceback."""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from types import FrameType
from typing import NoReturn

from vpptwin.system.errors import InputError
from vpptwin.system.files import discard_all

AGAIN = 1.0
"""A signal so soon [s] after another is the same impatience; it interrupts no tidying up."""
PATIENCE, PATIENT = 3.0, 30.0
"""Compiled code that has not come back so long [s] after a signal is not waited for; the latter where that would lose
what was found, unless a second signal comes."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Terminated(KeyboardInterrupt):
    """SIGTERM, or a terminal that was closed: unlike Ctrl-C it is no usual way to leave a command that runs on."""


@contextlib.contextmanager
def until_interrupted() -> Iterator[None]:
    """A block that Ctrl-C leaves, and whose command goes on; other signals end the command."""
    try:
        yield
    except Terminated:
        raise
    except KeyboardInterrupt:
        pass


def end(code: int, line: str = "stopped") -> NoReturn:
    """End the process at once, without drafts left behind."""
    discard_all()
    write_line(line)
    os._exit(code)


def write_line(line: str) -> None:
    """A line on stderr, from wherever a signal came; streams may be in the middle of something."""
    begin = "\n" if getattr(sys.stderr, "midline", False) else ""
    with contextlib.suppress(OSError):
        os.write(2, f"{begin}vpptwin: {line}\n".encode())


class Handler:
    """What happens at Ctrl-C, SIGTERM and a closed terminal.

    Attributes:
        heard: numbers of the signals that interrupted.
        last: when the last one came [s].
        deferred: asked whether the next one is to interrupt nothing, as it was told of it; None for nobody.
    """

    def __init__(self) -> None:
        self.heard: list[int] = []
        self.last = -math.inf
        self.deferred: Callable[[int], bool] | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Interrupt, or end the process where that would lead nowhere."""
        before, self.last = self.last, time.monotonic()
        if self.last <= before + AGAIN:
            return
        if self.deferred is not None and self.deferred(number):
            self.deferred = None
            return
        if is_importing(frame):
            end(128 + number)
        self.heard.append(number)
        raise KeyboardInterrupt if number == signal.SIGINT else Terminated


@contextlib.contextmanager
def defer_signal(tell: Callable[[int], bool]) -> Iterator[None]:
    """Tell the number of a signal in the block, which goes on if the answer is yes; the next one is heeded as ever.

    Only where `heed_signals` heeds them: elsewhere, as in somebody's notebook, they do what they did.
    """
    handler = next((h for h in map(signal.getsignal, SIGNALS) if isinstance(h, Handler)), None)
    if handler is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    handler.deferred = tell
    try:
        yield
    finally:
        handler.deferred = None


@contextlib.contextmanager
def heed_signals() -> Iterator[list[int]]:
    """Ctrl-C, SIGTERM and a closed terminal raise KeyboardInterrupt in the block; yields the numbers of what came.

    Where that would lead nowhere they end the process: while modules are imported, as libraries take what interrupts
    them for an error of their own; in finalizers, where Python prints and forgets it; in code that does not come back.
    So does what compiled code raises, which Python would print and forget too.
    """
    handler = Handler()
    heard = handler.heard
    if threading.current_thread() is not threading.main_thread():
        yield heard
        return
    done, crashed = threading.Event(), threading.Lock()
    reader, writer = os.pipe()

    def watch() -> None:
        while number := os.read(reader, 1):
            came, again = time.monotonic(), False
            patience = PATIENCE if handler.deferred is None else PATIENT
            while handler.last < came - AGAIN and time.monotonic() < came + patience and not again:
                if done.is_set():
                    return
                if select.select([reader], [], [], 0.1)[0]:
                    again = time.monotonic() > came + AGAIN or not os.read(reader, 1)
            if handler.last < came - AGAIN and not done.is_set():
                end(128 + number[0])

    def forget(lost: sys.UnraisableHookArgs) -> None:
        if isinstance(lost.exc_value, KeyboardInterrupt) and heard:
            end(128 + heard[0])
        if "numba" in str(lost.object):  # an effect of the user's own has raised in mid-flight: what follows is wrong
            with crashed:
                end(2, str(explain_crash(lost)))
        hook(lost)

    os.set_blocking(writer, False)
    heeded = [number for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    handlers = {number: signal.signal(number, handler) or signal.SIG_DFL for number in heeded}
    woken = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    hook, sys.unraisablehook = sys.unraisablehook, forget
    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield heard
    finally:
        for number, earlier in handlers.items():
            signal.signal(number, earlier)
        signal.set_wakeup_fd(woken)
        sys.unraisablehook = hook
        done.set()
        os.close(writer)
        watcher.join()
        os.close(reader)


def explain_crash(lost: sys.UnraisableHookArgs) -> InputError:
    """What compiled code raised that cannot raise, and where."""
    places = traceback.extract_tb(lost.exc_traceback)
    place = f"{places[-1].filename}:{places[-1].lineno}: " if places else ""
    found = f"{place}{lost.exc_type.__name__}: {lost.exc_value}"
    return InputError(found, "an effect that returns numbers wherever a simulation gets to", "correct it")


def is_importing(frame: FrameType | None) -> bool:
    """Whether a module is being imported at a frame."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
