"""Layouts in which Foxglove and PlotJuggler show a log of ours."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from vpptwin.system.files import write_files

NAMES = ("foxglove.json", "plotjuggler.xml")


def write_layouts(folder: Path, force: bool = False) -> list[Path]:
    """Copy the layouts into a folder, which is made if need be; returns their paths."""
    return write_files({folder / name: (files(__name__) / name).read_bytes() for name in NAMES}, force)
