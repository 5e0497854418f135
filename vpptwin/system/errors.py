"""The one exception that users see as a single line on stderr and exit code 2."""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Any
from unicodedata import category

MAX_CHARACTERS = 1000
"""Characters shown of each part of a message, which may quote what a file holds."""
EXTRAS = {
    "train": ("torch", "tensordict", "torchrl", "hydra", "omegaconf", "tensorboard", "psutil"),
    "deploy": ("onnx", "onnxscript", "onnxruntime"),
    "ray": ("ray",),
    "gymnasium": ("gymnasium",),
    "logs": ("pyarrow", "pyulog", "pymavlink", "rosbags"),
    "urdf": ("xacro",),
    "menagerie": ("mujoco_menagerie", "robot_descriptions"),
    "rerun": ("rerun",),
    "video": ("imageio_ffmpeg",),
    "interactive": ("plotly",),
    "gpu": ("warp", "mujoco_warp"),
}
"""Modules that come with no plain `pip install vpptwin`, by the extra that brings them."""


def escape_text(text: str) -> str:
    """Text from files of anyone's without what would steer a terminal."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def check_name(name: str) -> None:
    """Refuse a file's name that no page, picture or JSON can hold."""
    if any(category(c) in ("Cc", "Cs") for c in name):
        raise InputError(f"the name {name!r}", "one in UTF-8 without control characters", "rename it")


class InputError(ValueError):
    """Bad input: what was found, what was expected, and what to do.

    Args:
        found: what the input holds, naming the file or key it was found in.
        expected: what would have been accepted.
        action: what the user can do about it.
    """

    def __init__(self, found: str, expected: str, action: str) -> None:
        self.found, self.expected, self.action = found, expected, action
        parts = (found, f"expected {expected}", action)
        line = "; ".join(part if len(part) <= MAX_CHARACTERS else f"{part[:MAX_CHARACTERS]}…" for part in parts)
        super().__init__(escape_text(" ".join(line.split())))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        """From one process to another it stays what it is."""
        return type(self), (self.found, self.expected, self.action)


class MissingError(InputError, AttributeError):
    """A name of a module that takes an extra which is not installed: for `hasattr` it is not there."""


def suggest(name: str, known: Iterable[str], otherwise: str = "check the name") -> str:
    """What to do about a name that is unknown: the known one that is closest to it, if one is close."""
    close = get_close_matches(name, known, n=1)
    return f"did you mean {close[0]}?" if close else otherwise


def explain_missing(error: ModuleNotFoundError, need: str = "") -> InputError | None:
    """Which extra brings a module that is not installed, and what needs it; None if it is none of theirs."""
    module = str(error.name).partition(".")[0]
    for extra, modules in EXTRAS.items():
        if module in modules:
            found = f"{need} needs {module}, which" if need else module
            return InputError(f"{found} is not installed", f"vpptwin[{extra}]", f"pip install 'vpptwin[{extra}]'")
    return None


def describe_failure(error: Exception) -> str:
    """What failed, in one line: bad input as it says itself; a mistake of ours by its kind and place."""
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, OSError) and error.strerror:
        return escape_text(f"{error.strerror} ({error.filename or type(error).__name__})")
    *_, last = [None, *traceback.extract_tb(error.__traceback__)]
    place = f" ({Path(last.filename).name}:{last.lineno})" if last else ""
    told = " ".join(f"{type(error).__name__}: {error}".split())[:MAX_CHARACTERS]
    return f"{escape_text(told)}{place}, which is a mistake of vpptwin: please report it"


def load_extra(module: str, need: Path | str) -> Any:  # noqa: ANN401
    """A module that comes with an extra.

    Args:
        module: its name.
        need: what needs it, a log or a model.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        problem = explain_missing(error, str(need))
        if problem is None:
            raise
        raise problem from None
