"""Compiled code inside MuJoCo's step: a C function that Batch's threads call without Python's lock.

MuJoCo has one control callback per process. It is ours only while one of our batches steps, under a lock, and it
passes over every simulation but ours, which `userdata` marks: a mark, the address of the context, the row.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import mujoco
import numpy as np

MARK = int.from_bytes(b"vpptwin!", "little")
"""First word of `userdata` in our simulations."""
WORDS = 3
"""Size of `userdata`."""

FUNCTION = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)
"""A control callback, void(const mjModel*, mjData*), in the form that MuJoCo's bindings take."""

_LOCK = threading.RLock()


def stop_clock() -> float:
    """Time that does not pass [ms]."""
    return 0.0


def keep_quiet(text: int) -> None:
    """Take a warning of the engine and leave it."""


@cache
def compile_both() -> tuple[Any, Any]:
    """The two as C functions; numba loads here, as reading a model does without."""
    from numba import types

    from vpptwin.engine.compile import c_function

    return c_function(types.float64())(stop_clock), c_function(types.void(types.voidptr))(keep_quiet)


@contextmanager
def stopped_clock() -> Iterator[None]:
    """Let the engine's profiling clock stand still in the block.

    MuJoCo's Python bindings install one that the engine reads some thirty times a step, a third of the step of a model
    as small as ours.
    """
    clock = mujoco.get_mjcb_time()
    mujoco.set_mjcb_time(compile_both()[0].ctypes)
    try:
        yield
    finally:
        mujoco.set_mjcb_time(clock)


@contextmanager
def installed(callback: object) -> Iterator[None]:
    """Run our control callback (a ctypes function) while in the block; what was installed before comes back after.

    The engine's profiling clock stands still meanwhile. Its warnings, which it would write into a file of the working
    folder, are left: they are of simulations that diverge, and `vpptwin.twin.health` tells those.
    """
    with _LOCK, stopped_clock(), exchanged(callback, compile_both()[1].ctypes):
        yield


@contextmanager
def left_alone() -> Iterator[None]:
    """Run without a control callback while in the block: MuJoCo calls it while it compiles a model, too."""
    with _LOCK, exchanged(None, keep_quiet):
        yield


@contextmanager
def exchanged(callback: object, silence: object) -> Iterator[None]:
    """Put a control callback and a taker of warnings in the place of those that were there, while in the block."""
    before, warning = mujoco.get_mjcb_control(), mujoco.get_mju_user_warning()
    mujoco.set_mjcb_control(callback)
    mujoco.set_mju_user_warning(silence)
    try:
        yield
    finally:
        mujoco.set_mjcb_control(before)
        mujoco.set_mju_user_warning(warning)


def mark_rows(userdata: np.ndarray, context: np.ndarray) -> None:
    """Mark simulations as ours: `userdata` (N, WORDS) of a batch, and the array that holds their context."""
    words = np.empty((len(userdata), WORDS), np.int64)
    words[:, 0], words[:, 1], words[:, 2] = MARK, context.ctypes.data, np.arange(len(userdata))
    userdata[:] = words.view(np.float64)
