"""Compiling by numba, kept on disk where a disk can be written and in memory alone where not."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from itertools import count
from pathlib import Path
from pickle import UnpicklingError
from secrets import randbits
from typing import Any, TypeVar

from llvmlite import ir
from numba import cfunc, njit, types
from numba.core import cgutils
from numba.core.bytecode import FunctionIdentity
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numba.core.targetconfig import TargetConfig
from numba.extending import intrinsic, register_jitable
from numba.np.arrayobj import get_itemsize, make_array, populate_array

Function = TypeVar("Function", bound=Callable[..., Any])
# Arrays at addresses belong to nobody; that numba counts who uses them is a third of what there is to compile.
NOT_COUNTED = {"_nrt": False}
INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of functions that only compiled code calls."""
KEPT = "__pycache__/*.nb?"
"""What numba keeps beside a file."""


@cache
def can_keep() -> bool:
    """Whether numba finds a folder for what it compiles of this package: beside it or in the user's cache."""
    try:
        njit(cache=True)(_probe)
    except RuntimeError:
        return False
    return True


def _probe() -> None:
    """Nothing."""


def compilable(forceinline: bool = False, keep: bool = False) -> Callable[[Function], Function]:
    """A decorator for functions that compiled code may call; in Python they stay as they are.

    Args:
        forceinline: whether it always becomes part of what calls it.
        keep: whether what is compiled of it is kept on disk for all rigs; it may use nothing of other files.
    """

    def make(function: Function) -> Function:
        options: dict[str, Any] = {}
        if keep and can_keep():
            options = {"cache": True, "error_model": "numpy", **NOT_COUNTED}
            _kept.append(function)
        made: Function = register_jitable(forceinline=forceinline, **INNER, **options)(function)
        return made

    return make


_kept: list[Callable[..., Any]] = []


def name_apart() -> None:
    """Let what numba compiles from here on have names that no other process gives.

    Numba tells functions of one name and signature by a number that every process counts from 1, and names records by
    another; what two processes left on disk may then bear the same names, and of those the linker takes the first. Two
    rigs of one process would share a step that is one's alone.
    """
    FunctionIdentity._unique_ids = count(randbits(62))


def c_function(signature: Any, keep: bool = True, **options: Any) -> Callable[[Callable[..., Any]], Any]:  # noqa: ANN401
    """A decorator that makes a C function of a Python one.

    Args:
        signature: numba's, of arguments and result.
        keep: whether it may be kept on disk and, the next time, be loaded from there.
        options: of `numba.cfunc`.
    """

    def make(function: Callable[..., Any]) -> Any:  # noqa: ANN401
        name_apart()
        with uncollected(), hashed_once():
            try:
                return _make(function, signature, keep, options | NOT_COUNTED)
            except NumbaError:  # as it makes arrays of its own
                return _make(function, signature, keep, options)

    return make


def _make(function: Callable[..., Any], signature: Any, keep: bool, options: dict[str, Any]) -> Any:  # noqa: ANN401
    """The C function of a Python one, from disk or kept there where that can be."""
    for _ in range(2 if keep else 0):
        try:
            return cfunc(signature, cache=True, **options)(function)
        except (UnpicklingError, EOFError):  # a file was cut off: once more, without it
            for kept in (function, *_kept):
                drop_cache(kept)
        except (RuntimeError, OSError):  # no folder that can be written, a full disk
            break
    with unkept():
        return cfunc(signature, **options)(function)


@contextmanager
def unkept() -> Iterator[None]:
    """Nothing that is compiled in the block is looked for on disk or kept there, nor what is called from it."""
    enable = Dispatcher.enable_caching
    Dispatcher.enable_caching = lambda self: None  # type: ignore[method-assign]
    try:
        yield
    finally:
        Dispatcher.enable_caching = enable  # type: ignore[method-assign]


@contextmanager
def uncollected() -> Iterator[None]:
    """No garbage is looked for in the block: numba makes objects by the million, and keeps most."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@contextmanager
def hashed_once() -> Iterator[None]:
    """Options of numba are hashed and compared in the block as ever, without a table of all of them made each time.

    numba looks up every way to type every operation under its options: a quarter of the time that compiling takes.
    """
    hashing, equal = TargetConfig.__hash__, TargetConfig.__eq__

    def hash_names(self: TargetConfig) -> int:
        return _hash_options(type(self))

    def is_equal(self: TargetConfig, other: object) -> bool:
        if type(self) is not type(other):
            return equal(self, other)
        mine, theirs = self._values, other._values
        return mine == theirs or all(getattr(self, k) == getattr(other, k) for k in mine.keys() | theirs.keys())

    TargetConfig.__hash__, TargetConfig.__eq__ = hash_names, is_equal  # type: ignore[method-assign]
    try:
        yield
    finally:
        TargetConfig.__hash__, TargetConfig.__eq__ = hashing, equal  # type: ignore[method-assign]


@cache
def _hash_options(kind: type[TargetConfig]) -> int:
    """What numba hashes of any options of a kind: their names."""
    return hash(tuple(sorted(kind.options)))


def drop_cache(function: Callable[..., Any]) -> None:
    """Remove what numba keeps beside the file that a function comes from."""
    for file in Path(function.__code__.co_filename).parent.glob(KEPT):
        with suppress(OSError):
            file.unlink()


# In the place of numba.carray, which compiles a function of its own for every shape.
@intrinsic
def array_at(typing_context: Any, address: Any, shape: Any, dtype: Any) -> tuple[Any, Callable[..., Any]]:  # noqa: ANN401
    """An array at an address, an int64 or a pointer: `array_at(address, (rows, columns), np.float64)`.

    Args:
        typing_context: numba's.
        address: of the first element.
        shape: a tuple.
        dtype: a numpy type or dtype.
    """
    array = types.Array(dtype.dtype, len(shape), "C")

    def generate(context: Any, builder: ir.IRBuilder, signature: Any, args: Sequence[ir.Value]) -> ir.Value:  # noqa: ANN401
        made = make_array(array)(context, builder)
        given = zip(cgutils.unpack_tuple(builder, args[1]), shape)
        sizes = [context.cast(builder, size, kind, types.intp) for size, kind in given]
        itemsize = ir.Constant(ir.IntType(64), get_itemsize(context, array))
        strides = [itemsize]
        for size in reversed(sizes[1:]):
            strides.insert(0, builder.mul(strides[0], size))
        element = context.get_data_type(array.dtype).as_pointer()
        place = builder.inttoptr if isinstance(args[0].type, ir.IntType) else builder.bitcast
        populate_array(
            made, data=place(args[0], element), shape=sizes, strides=strides, itemsize=itemsize, meminfo=None
        )
        return made._getvalue()

    return array(address, shape, dtype), generate
