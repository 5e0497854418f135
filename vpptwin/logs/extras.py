"""Libraries that only some logs need."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from vpptwin.errors import InputError


def load_extra(module: str, path: Path | str, extra: str = "logs") -> Any:  # noqa: ANN401
    """A module that comes with an extra.

    Args:
        module: its name.
        path: the log that needs it.
        extra: of vpptwin's.

    Raises:
        InputError: saying how to get it, if it is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError:
        library = module.split(".")[0]
        found = f"{path} needs {library}, which is not installed"
        raise InputError(found, "the extra that brings it", f"pip install 'vpptwin[{extra}]'") from None
