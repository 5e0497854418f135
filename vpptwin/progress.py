"""Progress on standard error: a bar that moves on a terminal, a line now and then where a file collects it."""

from __future__ import annotations

import sys
from functools import partial

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
