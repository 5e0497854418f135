"""Progress on standard error: a bar that moves on a terminal, a line now and then where a file collects it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from threading import Event, Thread

from tqdm import tqdm

QUIET_S = 30.0
"""Time between two lines in a file [s]."""


def open_bar(**options: object) -> tqdm:
    """A tqdm bar, of simulation steps unless `options` of tqdm say otherwise.

    Nothing is drawn before the first step, so that input that is refused leaves one line and no bar.
    """
    make = partial(tqdm, unit=" steps", unit_scale=True, dynamic_ncols=True, delay=1e-6)
    if not sys.stderr.isatty():
        make = partial(make, mininterval=QUIET_S, maxinterval=QUIET_S)
    return make(**options)


def tell_stage(bar: tqdm, text: str) -> None:
    """Put what is being done beside the bar, once there is one."""
    bar.set_postfix_str(text, refresh=bar.n > 0)


def tell_line(text: str) -> None:
    """Say what takes a while, where it is collected."""
    print(f"vpptwin: {text}", file=sys.stderr, flush=True)


@contextmanager
def tell_wait(text: str, always: bool = False) -> Iterator[None]:
    """While in the block, text and the seconds so far on a terminal; a file gets nothing, or `always` a line."""
    if not sys.stderr.isatty():
        if always:
            tell_line(text)
        yield
        return
    over = Event()
    with tqdm(desc=text, bar_format="{desc}: {elapsed}", leave=False, total=1) as bar:

        def show() -> None:
            while not over.wait(0.5):
                bar.refresh()

        clock = Thread(target=show, daemon=True)
        clock.start()
        try:
            yield
        finally:
            over.set()
            clock.join()
