"""Effects that are installed: packages whose entry points in the group `vpptwin.effects` name modules with effects."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

GROUP = "vpptwin.effects"


def locate_effects(file: str | Path, folder: Path | None = None) -> Path:
    """The Python file with effects that is meant: one of that path, or else the one that is installed by that name.

    Args:
        file: path or name.
        folder: from which a relative path goes; None for the current one.
    """
    path = (folder or Path()) / file
    return path if path.exists() else list_installed().get(str(file), path)


@cache
def list_installed() -> dict[str, Path]:
    """Name → Python file of every installed module with effects; found without running any code."""
    found = {point.name: find_module(point.module) for point in entry_points(group=GROUP)}
    return {name: file for name, file in found.items() if file is not None}


def find_module(name: str) -> Path | None:
    """The file of a module, None if there is none; packages that it lies in are not imported."""
    top, *rest = name.split(".")
    spec = find_spec(top)
    if spec is None:
        return None
    within = [Path(root, *rest) for root in spec.submodule_search_locations or []]
    files = [file for place in within for file in (place / "__init__.py", place.with_suffix(".py"))]
    return next(filter(Path.is_file, files if rest else [Path(spec.origin or "")]), None)
