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


class Rows:
    """Some rows of numpy's arrays, by number: what is computed for them is computed for no other.

    Args:
        ids: numbers of the rows, (count,) int.
        every: these are all rows, which are read in place.
    """

    def __init__(self, ids: np.ndarray, every: bool = False) -> None:
        self.ids, self.count = ids, len(ids)
        self.key: Any = slice(None) if every else ids

    def take(self, array: Array) -> Array:
        """Their part of an array."""
        return array[self.key]

    def put(self, array: Array, values: Any) -> None:  # noqa: ANN401
        """Write values, or one for all, into their part of an array."""
        array[self.key] = values


class MaskedRows:
    """The rows of tensors where a mask, (N,) bool, is true: all N are computed, so that a device is asked for none."""

    key = slice(None)

    def __init__(self, mask: Array) -> None:
        self.mask, self.count = mask, len(mask)

    def take(self, tensor: Array) -> Array:
        """The tensor, all of it."""
        return tensor

    def put(self, tensor: Array, values: Any) -> None:  # noqa: ANN401
        """Write values, (N, ...), or one for all, into the rows of the mask."""
        mask = self.mask.reshape(-1, *(1,) * (tensor.dim() - 1))
        tensor.copy_(library(tensor).where(mask, values, tensor))


def select(mask: Array) -> Rows | MaskedRows:
    """The rows where a mask, (N,) bool, is true."""
    if library(mask) is not np:
        return MaskedRows(mask)
    ids = np.flatnonzero(mask)
    return Rows(ids, len(ids) == len(mask))
