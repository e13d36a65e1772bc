"""How exact the machine's elementary functions are, against mpmath.

    python -m experiments.check.elementary --points 100000    # some 2 minutes

Prints the largest error of each function in units in the last place, and NumPy's at the same
points. `tests/core/test_elementary.py` keeps the limits with fewer points.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import mpmath
import numpy as np

from miho.core import OPERATIONS, Instruction, Tape, machine
from miho.quantities import Array


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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=10_000, help="of each function")
    count = parser.parse_args().points
    if machine() is None:
        raise SystemExit("error: the library was installed without a C compiler")
    print(f"{'function':10}{'machine':>9}{'limit':>8}{'NumPy':>8}   largest error [ulp]")
    for name, (exact, low, high, ulps) in FUNCTIONS.items():
        x = points(low, high, count, np.random.default_rng(1))
        by_numpy = OPERATIONS[name](x)
        by_numpy = by_numpy[0] if isinstance(by_numpy, tuple) else by_numpy
        ours, numpys = (errors(y, exact, x).max() for y in (evaluated(name, x), by_numpy))
        print(f"{name:10}{ours:9.2f}{ulps:8.1f}{numpys:8.2f}", flush=True)
    rng = np.random.default_rng(4)
    x = np.exp(rng.uniform(-300, 300, count))
    y = rng.uniform(-600, 600, count) / np.abs(np.log(x))
    ours, numpys = (errors(z, mpmath.power, x, y).max() for z in (evaluated("POWER", x, y), x**y))
    print(f"{'POWER':10}{ours:9.2f}{1.1:8.1f}{numpys:8.2f}")


if __name__ == "__main__":
    main()
