"""The machine's elementary functions against mpmath, and their bits on each level."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import mpmath
import numpy as np
import pytest

from experiments.check.coefficients import FILE, text
from miho.core import OPERATIONS, Instruction, Tape, machine
from miho.quantities import Array

POINTS, MANY_POINTS = 1500, 100_000
needs_machine = pytest.mark.skipif(machine() is None, reason="the machine was not built")


class Accuracy(NamedTuple):
    """An exact function of mpmath, the range of its argument, and the largest error allowed [ulp].

    The limits are the largest errors at 10^5 points, rounded up.
    """

    exact: Callable[[Any], Any]
    low: float
    high: float
    ulps: float


FUNCTIONS: Mapping[str, Accuracy] = {
    "EXP": Accuracy(mpmath.exp, -700, 700, 1.1),
    "EXPM1": Accuracy(mpmath.expm1, -30, 700, 2.5),
    "LOG": Accuracy(mpmath.log, 1e-300, 1e12, 1.1),
    "LOG1P": Accuracy(mpmath.log1p, -0.999, 1e6, 2.5),
    "LOG10": Accuracy(mpmath.log10, 1e-300, 1e12, 1.1),
    "LOG2": Accuracy(lambda x: mpmath.log(x, 2), 1e-300, 1e12, 1.1),
    "SIN": Accuracy(mpmath.sin, -1e6, 1e6, 1.1),
    "SINCOS": Accuracy(mpmath.sin, -10, 10, 1.1),
    "COS": Accuracy(mpmath.cos, -1e6, 1e6, 1.1),
    "TAN": Accuracy(mpmath.tan, -1e6, 1e6, 2.5),
    "ASIN": Accuracy(mpmath.asin, -1, 1, 3.5),
    "ACOS": Accuracy(mpmath.acos, -1, 1, 3.5),
    "ATAN": Accuracy(mpmath.atan, -1e6, 1e6, 2.5),
    "SINH": Accuracy(mpmath.sinh, -700, 700, 2.5),
    "COSH": Accuracy(mpmath.cosh, -700, 700, 2.5),
    "TANH": Accuracy(mpmath.tanh, -20, 20, 2.5),
    "ASINH": Accuracy(mpmath.asinh, -1e12, 1e12, 3.5),
    "ACOSH": Accuracy(mpmath.acosh, 1, 1e12, 3.5),
    "ATANH": Accuracy(mpmath.atanh, -0.999, 0.999, 3.5),
}


def evaluated(name: str, *operands: Array, level: int = -1) -> Array:
    """One operation of the machine at operands (n,); POWER gets the parts of its base first."""
    n = len(operands)
    code = [Instruction(name, tuple(range(n)), (n,))]
    registers = n + 1
    if name == "POWER":
        code = [Instruction("LOG_PARTS", (0,), (3, 4)), Instruction(name, (0, 1, 3, 4), (2,))]
        registers = 5
    if name == "SINCOS":
        code, registers = [Instruction(name, (0,), (1, 2))], 3
    tape = Tape(n, 1, registers, 0, 0, (), (), tuple(code), ())
    X, out = np.ascontiguousarray(operands), np.empty((1, 1, operands[0].size))
    machine().evaluate(tape.at_level(level), np.empty((1, 0)), X, out)
    return np.asarray(out[0, 0])


def points(low: float, high: float, count: int, rng: np.random.Generator) -> Array:
    """A third of `count` points even in the range, the others even in the logarithm, signed."""
    even = rng.uniform(low, high, count // 3)
    sizes = np.exp(rng.uniform(np.log(1e-12), np.log(max(-low, high)), count - even.size))
    signed = sizes * rng.choice([-1.0, 1.0], sizes.size)
    return np.append(even, signed[(signed >= low) & (signed <= high)])


def errors(values: Array, exact: Callable[..., Any], *operands: Array) -> Array:
    """Distances of values (n,) from the exact ones, in units in the last place."""
    with mpmath.workprec(140):
        return np.array(
            [
                float(abs(mpmath.mpf(value) - exact(*map(mpmath.mpf, map(float, each)))))
                / np.spacing(abs(value))
                for value, *each in zip(values.tolist(), *operands, strict=True)
            ]
        )


@needs_machine
@pytest.mark.parametrize("count", [POINTS, pytest.param(MANY_POINTS, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_near_the_exact_value(name: str, count: int) -> None:
    exact, low, high, most = FUNCTIONS[name]
    x = points(low, high, count, np.random.default_rng(1))
    found = errors(evaluated(name, x), exact, x).max()
    assert found <= most, f"{name}: {found:.2f}"


@needs_machine
@pytest.mark.parametrize("size", [1e7, 1e22, 1.7e308])
def test_sines_of_large_angles_are_exact_to_the_last_bit(size: float) -> None:
    """Beyond what three doubles of pi reach; some are next to whole multiples of pi / 2."""
    rng = np.random.default_rng(2)
    x = rng.uniform(0.1, 1, 200) * size * rng.choice([-1.0, 1.0], 200)
    with mpmath.workprec(1200):
        near = [float(mpmath.pi / 2 * int(k)) for k in rng.integers(2**22, 2**60, 100)]
    x = np.append(x, near)
    with mpmath.workprec(1200):
        for name, exact in (("SIN", mpmath.sin), ("COS", mpmath.cos)):
            true = [exact(mpmath.mpf(value)) for value in x.tolist()]
            values = evaluated(name, x)
            off = [
                float(abs(mpmath.mpf(v) - t)) for v, t in zip(values.tolist(), true, strict=True)
            ]
            assert (np.array(off) <= 1.1 * np.spacing(np.abs(values))).all()
    pair = evaluated("SINCOS", x)
    assert pair.tobytes() == evaluated("SIN", x).tobytes()


@needs_machine
def test_an_angle_does_not_depend_on_its_neighbours() -> None:
    """A block that holds a large one goes another way."""
    x = np.random.default_rng(3).uniform(-100, 100, 200)
    for name in ("SIN", "COS", "TAN", "SINCOS"):
        together = evaluated(name, np.append(x, 1e30))
        assert together[:-1].tobytes() == evaluated(name, x).tobytes()


@needs_machine
def test_powers_are_near_the_exact_value() -> None:
    rng = np.random.default_rng(4)
    x = np.exp(rng.uniform(-300, 300, POINTS))
    y = rng.uniform(-600, 600, POINTS) / np.abs(np.log(x))
    near = rng.uniform(0.5, 2, POINTS)
    for base, exponent in ((x, y), (near, rng.uniform(-900, 900, POINTS))):
        assert errors(evaluated("POWER", base, exponent), mpmath.power, base, exponent).max() <= 1.1


@needs_machine
def test_functions_of_two_arguments_are_near_the_exact_value() -> None:
    rng = np.random.default_rng(5)
    a, b = np.exp(rng.uniform(-300, 300, (2, POINTS))) * rng.choice([-1.0, 1.0], (2, POINTS))
    c, d = rng.uniform(-2, 2, (2, POINTS))
    for x, y in ((a, b), (c, d)):
        assert errors(evaluated("HYPOT", x, y), mpmath.hypot, x, y).max() <= 1.5
        values = evaluated("ATAN2", x, y)
        normal = np.abs(values) > 1e-300
        x, y, values = x[normal], y[normal], values[normal]
        assert errors(values, mpmath.atan2, x, y).max() <= 2.5


EDGES = [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, -2.0, 3.0, -3.0, 2.5, 1e-310, -5e-324, 1e300, -1e300]
EDGES += [710.0, -746.0, np.inf, -np.inf, np.nan]
LARGE = [2.0**51 + 0.5, 2.0**51 + 1, 2.0**52 + 1, 2.0**53 - 1, 2.0**53, 1e308, 1.7e308]
"""Odd ones are the largest, and the sum of the last two is none."""


@needs_machine
@pytest.mark.parametrize("name", [*FUNCTIONS, "SQRT", "ABS", "SIGN", "BOUND", "NEG"])
def test_zeros_infinities_and_what_is_no_number_are_numpys(name: str) -> None:
    x = np.array(EDGES)
    with np.errstate(all="ignore"):
        expected = OPERATIONS[name](x)
    expected = expected[0] if isinstance(expected, tuple) else expected
    np.testing.assert_allclose(evaluated(name, x), expected, rtol=1e-14, atol=5e-324)
    zero = x[:2]
    with np.errstate(all="ignore"):
        sign = np.signbit(OPERATIONS[name](zero)[0] if name == "SINCOS" else OPERATIONS[name](zero))
    assert (np.signbit(evaluated(name, zero)) == sign).all() or name == "ACOSH"  # NaN


@needs_machine
@pytest.mark.parametrize("name", ["POWER", "ATAN2", "HYPOT", "MIN", "MAX"])
def test_pairs_of_zeros_infinities_and_what_is_no_number_are_numpys(name: str) -> None:
    edges = [*EDGES, *LARGE, *np.negative(LARGE)]
    x, y = (each.ravel().copy() for each in np.meshgrid(edges, edges))
    with np.errstate(all="ignore"):
        expected = np.power(x, y) if name == "POWER" else OPERATIONS[name](x, y)
    values = evaluated(name, x, y)
    np.testing.assert_allclose(values, expected, rtol=1e-14, atol=5e-324)
    signed = ~np.isnan(expected) & (name != "MIN") & (name != "MAX")
    assert (np.signbit(values) == np.signbit(expected))[signed].all()


@needs_machine
def test_every_level_gives_the_same_bits() -> None:
    """Of all functions, on as many levels as the processor has."""
    rng = np.random.default_rng(6)
    x = np.concatenate([points(-1e3, 1e3, POINTS, rng), points(-1, 1, POINTS, rng), EDGES])
    y = rng.permutation(x)
    for name in [*FUNCTIONS, "POWER", "ATAN2", "HYPOT"]:
        operands = (x, y) if name in ("POWER", "ATAN2", "HYPOT") else (x,)
        found = [evaluated(name, *operands, level=k) for k in range(len(machine().levels()))]
        for other in found[1:]:
            np.testing.assert_array_equal(found[0], other, err_msg=name)


BITS = "377854f621c882796b45391edb95af712b839f8a28c265a17a0779fc260af56f"
"""Of results, by gcc and clang alike; it changes with any function or constant."""


@needs_machine
def test_every_processor_gives_these_bits() -> None:
    """Also one of another kind: what is hashed is made by exact arithmetic alone."""
    rng = np.random.default_rng(7)
    x = np.ldexp(rng.uniform(-1, 1, 3000), rng.integers(-40, 40, 3000))
    y, digest = rng.permutation(x), hashlib.sha256()
    for name in [*FUNCTIONS, "POWER", "ATAN2", "HYPOT"]:
        values = evaluated(name, *((x, y) if name in ("POWER", "ATAN2", "HYPOT") else (x,)))
        digest.update(np.where(np.isnan(values), 0.0, values).astype("<f8").tobytes())
    assert digest.hexdigest() == BITS


def test_the_constants_are_those_that_the_script_writes() -> None:
    assert FILE.read_text(encoding="ascii") == text()
