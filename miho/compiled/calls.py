"""The compiled forms of calls by address; importing this registers them with numba."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload, register_jitable

from miho.compiled.addresses import call
from miho.quantities import Array


def _call(builder: Any, result: ir.Type, arguments: Any) -> Any:
    """Call the function whose address is the first argument with the others."""
    address, *others = arguments
    signature = ir.FunctionType(result, [argument.type for argument in others])
    return builder.call(builder.inttoptr(address, signature.as_pointer()), others)


@intrinsic
def _called(
    context: Any, function: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any
) -> Any:
    """Call a function of eight whole numbers that gives nothing."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _call(builder, ir.VoidType(), arguments)
        return context.get_dummy_value()

    return types.none(*[types.int64] * 9), generate


@overload(call, jit_options={"_nrt": False})
def _call_compiled(
    function: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any
) -> Any:
    def implementation(
        function: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any
    ) -> None:
        _called(function, a, b, c, d, e, f, g, h)

    return implementation


@intrinsic
def _called_for_number(
    context: Any, function: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, limit: Any
) -> Any:
    """Call a function of seven whole numbers and a number that gives a number."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _call(builder, ir.DoubleType(), arguments)

    return types.float64(*[types.int64] * 8, types.float64), generate


@intrinsic
def pointer(context: Any, address: Any) -> Any:
    """An address as a pointer to numbers, of which `numba.carray` makes an array."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.DoubleType().as_pointer())

    return types.CPointer(types.float64)(types.int64), generate


@register_jitable
def mean_square(
    theta: Array, limit: float, function: int, tape: int, X: Array, y: Array, first: int
) -> float:
    """`tape_mean_square` of the machine, at `function`."""
    value: float = _called_for_number(
        function, tape, theta.ctypes.data, X.ctypes.data, X.shape[1], y.ctypes.data, y.size, first,
        limit,
    )  # fmt: skip
    return value
