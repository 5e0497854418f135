"""Arrays at addresses, for compiled code that is handed MuJoCo's structs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import get_itemsize, make_array, populate_array


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
