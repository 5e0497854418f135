"""Compiled work and numpy's, which hold no lock, on all cores of this process."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import numpy as np


@cache
def threads() -> ThreadPoolExecutor:
    """Threads for what holds no lock and starts no threads itself."""
    return ThreadPoolExecutor(os.cpu_count() or 1)


if hasattr(os, "register_at_fork"):  # a fork has none of its parent's threads, and would wait for them
    os.register_at_fork(after_in_child=threads.cache_clear)


def in_parts(work: Callable[[int, int], object], count: int, workers: int = 0, least: int = 1) -> None:
    """Do work on `count` rows in as many parts as there are workers, side by side.

    Args:
        work: told the first row and one past the last of each part.
        count: of rows.
        workers: parts at most; 0 for as many as there are cores.
        least: rows for which another part pays.
    """
    parts = min(workers or os.cpu_count() or 1, max(count // least, 1))
    (first, end), *rest = pairwise(np.linspace(0, count, parts + 1).astype(int).tolist())
    others = [threads().submit(work, *part) for part in rest]
    work(first, end)
    for other in others:
        other.result()


def map_rows(function: Callable[..., np.ndarray], *arrays: np.ndarray, least: int = 1) -> np.ndarray:
    """What a function makes of arrays whose rows have nothing to do with each other, in parts of `least` rows or more.

    Args:
        function: of parts of the arrays, whose result has as many rows.
        arrays: of as many rows each.
        least: rows for which another part pays.
    """
    found: dict[int, np.ndarray] = {}

    def work(first: int, end: int) -> None:
        found[first] = function(*(array[first:end] for array in arrays))

    in_parts(work, len(arrays[0]), least=least)
    return np.concatenate([found[first] for first in sorted(found)]) if len(found) > 1 else found[0]
