"""Small sets for the tests of SimGap."""

from __future__ import annotations

from pathlib import Path

from proving.simgap.sets import draw_set


def draw_small_set(folder: Path, seed: int = 7, **chosen: list[int]) -> Path:
    """A set of some sessions of cheap worlds."""
    draw_set(folder, seed, chosen or {"pendula": [0, 1], "watched": [0]}, public=True)
    return folder
