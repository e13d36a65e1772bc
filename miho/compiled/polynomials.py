"""The compiled forms of the elementary functions; importing this registers them with numba.

They are polynomials without branches, which the processor evaluates for several points at once; the
mathematical library does not. Every operation is rounded as IEEE 754 says, so that results are the
same bits on every machine that has a fused multiply-add (x86-64 since 2013, Arm64).

Error against the exact value: `sin` and `cos` at most 2.3e-16 + 1 unit in the last place for |x| <=
2^40, NaN beyond 2^45, where neighbouring numbers are a hundredth of a period apart; `atan` at most
3 units in the last place everywhere. The sine of -0.0 is +0.0. The coefficients interpolate
sin(r)/r on [0, pi/2] and atan(t)/t on [0, tan(pi/8)] at Chebyshev nodes of the argument's square,
computed with 50 digits; the polynomials alone are within 2.1e-19 and 3.5e-17 of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload, register_jitable

from miho.compiled.elementary import atan, cos, sin, where

INVERSE_PI = 1 / math.pi
PI_HIGH = math.pi
PI_LOW = 1.2246467991473532e-16  # pi - PI_HIGH
TO_INTEGER = 1.5 * 2.0**52
"""Added to a number of less than half its size it leaves the nearest integer in the last bits."""
LARGEST = 2.0**45
SIGN = np.int64(-(2**63))
TAN_PI_8 = math.tan(math.pi / 8)
TAN_3PI_8 = math.tan(3 * math.pi / 8)

S1, S2, S3, S4, S5, S6, S7, S8 = (
    -0.16666666666666666, 0.008333333333333186, -0.00019841269841208676, 2.7557319211229542e-06,
    -2.5052106890563577e-08, 1.6058940878180048e-10, -7.643026549781953e-13, 2.721574853796351e-15,
)  # fmt: skip
A1, A2, A3, A4, A5, A6, A7, A8, A9, A10 = (
    -0.3333333333332844, 0.1999999999885511, -0.14285714180976467, 0.11111106180455946,
    -0.09090773074808414, 0.07689953496306857, -0.06640233930429408, 0.056883492268090106,
    -0.04348052215716462, 0.021135373157693246,
)  # fmt: skip


@intrinsic
def _fma(context: Any, x: Any, y: Any, z: Any) -> Any:
    """X y + z, rounded once."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


@intrinsic
def _bits(context: Any, x: Any) -> Any:
    """The bits of a number as an integer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), generate


@intrinsic
def _number(context: Any, bits: Any) -> Any:
    """The number that has these bits."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.DoubleType())

    return types.float64(types.int64), generate


@register_jitable(inline="always")
def _sine_near_zero(r: float) -> float:
    """Sine for |r| <= pi / 2, by Estrin's scheme."""
    z = r * r
    z2 = z * z
    low = _fma(_fma(S4, z, S3), z2, _fma(S2, z, S1))
    high = _fma(_fma(S8, z, S7), z2, _fma(S6, z, S5))
    s: float = _fma(_fma(high, z2 * z2, low) * z, r, r)
    return s


@register_jitable(inline="always")
def _sine(x: float) -> float:
    shifted = _fma(x, INVERSE_PI, TO_INTEGER)
    n = shifted - TO_INTEGER
    r = _fma(n, -PI_LOW, _fma(n, -PI_HIGH, x))
    s: float = _number(_bits(_sine_near_zero(r)) ^ (_bits(shifted) << 63))
    return s if abs(x) <= LARGEST else math.nan


@register_jitable(inline="always")
def _cosine(x: float) -> float:
    """cos(r + (n + 1/2) pi) = -(-1)^n sin(r)."""
    shifted = _fma(x, INVERSE_PI, -0.5) + TO_INTEGER
    n = (shifted - TO_INTEGER) + 0.5
    r = _fma(n, -PI_LOW, _fma(n, -PI_HIGH, x))
    s: float = _number(_bits(-_sine_near_zero(r)) ^ (_bits(shifted) << 63))
    return s if abs(x) <= LARGEST else math.nan


@register_jitable(inline="always")
def _arctangent(x: float) -> float:
    """From |x| to at most tan(pi / 8) by atan(a) = pi/4 + atan((a-1)/(a+1)) = pi/2 + atan(-1/a)."""
    a = abs(x)
    upper, middle = a > TAN_3PI_8, a > TAN_PI_8
    numerator = a - 1.0 if middle else a
    denominator = a + 1.0 if middle else 1.0
    offset = math.pi / 4 if middle else 0.0
    numerator = -1.0 if upper else numerator
    denominator = a if upper else denominator
    offset = math.pi / 2 if upper else offset
    t = numerator / denominator
    z = t * t
    z2 = z * z
    z4 = z2 * z2
    low = _fma(_fma(A4, z, A3), z2, _fma(A2, z, A1))
    high = _fma(_fma(A8, z, A7), z2, _fma(A6, z, A5))
    p = _fma(_fma(_fma(A10, z, A9), z4, high), z4, low)
    angle: float = _number(_bits(offset + _fma(p * z, t, t)) | (_bits(x) & SIGN))
    return angle


def _compiled(function: Callable[[Any], Any], of_number: Callable[[float], float]) -> None:
    """Give a function its compiled form, for numbers and for arrays (n,).

    The linker knows compiled functions by name alone, so each gets that of its function.
    """

    def of_array(x: Any) -> Any:
        y = np.empty_like(x)
        for i in range(x.size):
            y[i] = of_number(x[i])
        return y

    of_array.__qualname__ += f".{function.__name__}"
    register_jitable(error_model="numpy")(of_array)

    @overload(function, jit_options={"error_model": "numpy"})
    def choose(x: Any) -> Any:
        chosen = of_array if isinstance(x, types.Array) else of_number

        def implementation(x: Any) -> Any:
            return chosen(x)

        implementation.__qualname__ += f".{function.__name__}"
        return implementation


_compiled(sin, _sine)
_compiled(cos, _cosine)
_compiled(atan, _arctangent)


@overload(where)
def _choose(condition: Any, x: Any, y: Any) -> Any:
    """For numbers without the array that NumPy's makes, so that the processor chooses several."""

    def of_numbers(condition: Any, x: Any, y: Any) -> Any:
        return x if condition else y

    def of_arrays(condition: Any, x: Any, y: Any) -> Any:
        return np.where(condition, x, y)

    arrays = any(isinstance(each, types.Array) for each in (condition, x, y))
    return of_arrays if arrays else of_numbers
