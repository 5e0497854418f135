"""Arrays at addresses: what compiled code sees of numpy's memory."""

from __future__ import annotations

import numpy as np
from numba import njit

from vpptwin.engine.compile import array_at


@njit
def look(
    numbers: int, table: int, words: int, halves: int, flags: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Copies of arrays at addresses; the second number is doubled where it lies."""
    seen = array_at(numbers, (3,), np.float64)
    seen[1] *= 2.0
    return (
        seen.copy(),
        array_at(table, (2, 3), np.float64).copy(),
        array_at(words, (2,), np.int64).copy(),
        array_at(halves, (3,), np.int32).copy(),
        array_at(flags, (4,), np.bool_).copy(),
    )


def test_arrays_at_addresses() -> None:
    """Numbers of every type are read where they lie, in the shape asked for, and writing changes them there."""
    arrays = (
        np.array([0.5, 1.5, 2.5]),
        np.arange(6.0).reshape(2, 3),
        np.array([1, -(2**40)], np.int64),
        np.array([1, -2, 3], np.int32),
        np.array([True, False, True, True]),
    )
    found = look(*(array.ctypes.data for array in arrays))
    assert arrays[0][1] == 3.0
    for array, copy in zip(arrays, found):
        np.testing.assert_array_equal(copy, array)
        assert copy.dtype == array.dtype


@njit
def write_table(address: int, rows: int, values: np.ndarray) -> None:
    """Write the same row into all of a table."""
    for k in range(rows):
        array_at(address, (rows, len(values)), np.float64)[k, :] = values


def test_rows_are_written_in_place() -> None:
    """A row assigned as a whole arrives in memory: numba's own inlining once dropped it."""
    table = np.zeros((4, 3))
    write_table(table.ctypes.data, 4, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(table, np.tile([1.0, 2.0, 3.0], (4, 1)))
