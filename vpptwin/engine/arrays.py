"""numpy's arrays and torch's tensors alike: the library of an array, and others beside it."""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import Any

import numpy as np

Array = Any
"""One or the other."""


def library(array: Array) -> Any:  # noqa: ANN401
    """The module whose functions take this array: numpy, or torch, which nothing here imports."""
    return sys.modules["torch"] if type(array).__module__.partition(".")[0] == "torch" else np


def beside(array: Array, values: Any) -> Array:  # noqa: ANN401
    """Numbers as an array of the same library, in the same place and of its precision; a tensor is kept, to be read."""
    given = np.asarray(values, dtype=float)
    return given if library(array) is np else place(given.tobytes(), given.shape, array.dtype, array.device)


@lru_cache(maxsize=256)
def place(numbers: bytes, shape: tuple[int, ...], dtype: Any, device: Any) -> Any:  # noqa: ANN401
    """The tensor of some numbers on a device, which they are sent to once."""
    given = np.frombuffer(numbers).reshape(shape)
    return sys.modules["torch"].tensor(given, dtype=dtype, device=device)
