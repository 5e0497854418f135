"""Arrays at addresses, for compiled code that is handed MuJoCo's structs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from llvmlite import ir
from numba import carray, njit, types
from numba.extending import intrinsic


@intrinsic
def pointer_to(typing_context: object, address: object) -> tuple[object, Callable[..., object]]:
    """A pointer from an address held in an int64."""

    def generate(context: object, builder: ir.IRBuilder, signature: object, args: Sequence[ir.Value]) -> ir.Value:
        return builder.inttoptr(args[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), generate


@njit(forceinline=True)
def float64_at(address: int, count: int) -> np.ndarray:
    """(count,) numbers at an address."""
    return carray(pointer_to(address), (count,), np.float64)  # type: ignore[call-arg]


@njit(forceinline=True)
def float64_table_at(address: int, rows: int, columns: int) -> np.ndarray:
    """(rows, columns) numbers at an address."""
    return carray(pointer_to(address), (rows, columns), np.float64)  # type: ignore[call-arg]


@njit(forceinline=True)
def int64_at(address: int, count: int) -> np.ndarray:
    """(count,) 64-bit integers at an address."""
    return carray(pointer_to(address), (count,), np.int64)  # type: ignore[call-arg]


@njit(forceinline=True)
def int32_at(address: int, count: int) -> np.ndarray:
    """(count,) 32-bit integers at an address."""
    return carray(pointer_to(address), (count,), np.int32)  # type: ignore[call-arg]


@njit(forceinline=True)
def bool_at(address: int, count: int) -> np.ndarray:
    """(count,) bytes at an address as truth values."""
    return carray(pointer_to(address), (count,), np.bool_)  # type: ignore[call-arg]
