"""Writes the constants of the elementary functions, `miho/core/coefficients.h`.

Near-minimax polynomials, which interpolate at Chebyshev nodes, and constants as sums of doubles, by
mpmath with 60 digits (2 seconds):

    python -m experiments.check.coefficients
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpmath import atan, cos, exp, log, mp, mpf, pi, sin, sqrt, tan

FILE = Path(__file__).parents[2] / "miho/core/coefficients.h"
DIGITS = 60
WORDS = 40
"""Words of 2 / pi, of 32 bits each: the largest double is below 2^1024, and 256 bits are read."""


def near_zero(function: Callable[[Any], Any], limit: Any, below: str) -> Callable[[Any], Any]:
    """The function, replaced by its limit near zero, where cancellation would spoil it."""
    return lambda x: limit if abs(x) < mpf(below) else function(x)


def log_ratio(z: Any) -> Any:
    """(log((1 + s) / (1 - s)) / s - 2) / s^2 of z = s^2."""
    s = sqrt(z)
    return (log((1 + s) / (1 - s)) / s - 2) / z


def polynomials() -> dict[str, tuple[Callable[[Any], Any], Any, Any, int]]:
    """Functions to approximate, their intervals, and the numbers of coefficients."""
    third, half_log, eighth = mpf(2) / 3, log(2) / 2, (pi / 4) ** 2
    log_end = ((sqrt(2) - 1) / (sqrt(2) + 1)) ** 2
    wider = 1 + mpf("1e-4")  # reductions are rounded
    return {
        "EXP": (
            near_zero(lambda r: (exp(r) - 1 - r) / r**2, mpf(1) / 2, "1e-15"),
            -half_log * wider, half_log * wider, 10,
        ),
        "LOG": (near_zero(log_ratio, third, "1e-20"), mpf(0), log_end * wider, 7),
        "LOG_MORE": (
            near_zero(lambda z: (log_ratio(z) - third) / z, mpf(2) / 5, "1e-16"),
            mpf(0), log_end * wider, 7,
        ),
        "SIN": (
            near_zero(lambda z: (sin(sqrt(z)) / sqrt(z) - 1) / z, mpf(-1) / 6, "1e-20"),
            mpf(0), eighth * wider, 6,
        ),
        "COS": (
            near_zero(lambda z: (cos(sqrt(z)) - 1 + z / 2) / z**2, mpf(1) / 24, "1e-14"),
            mpf(0), eighth * wider, 6,
        ),
        "ATAN": (
            near_zero(lambda z: (atan(sqrt(z)) / sqrt(z) - 1) / z, mpf(-1) / 3, "1e-20"),
            mpf(0), tan(pi / 8) ** 2 * wider, 11,
        ),
    }  # fmt: skip


def interpolated(function: Callable[[Any], Any], low: Any, high: Any, count: int) -> list[float]:
    """Coefficients of the polynomial that interpolates the function at `count` Chebyshev nodes."""
    middle, half = (low + high) / 2, (high - low) / 2
    nodes = [middle + half * cos(pi * (2 * k + 1) / (2 * count)) for k in range(count)]
    powers = mp.matrix([[node**j for j in range(count)] for node in nodes])
    return [float(c) for c in mp.lu_solve(powers, mp.matrix([function(node) for node in nodes]))]


def as_sum(value: Any, bits: tuple[int, ...]) -> list[float]:
    """Split a constant into a sum of doubles; all but the last are rounded down to `bits` bits."""
    terms: list[float] = []
    for count in bits:
        if count:
            mantissa, exponent = mp.frexp(value)
            terms.append(float(mp.ldexp(mp.floor(mp.ldexp(mantissa, count)), exponent - count)))
        else:
            terms.append(float(value))
        value -= mpf(terms[-1])
    return terms


def constants() -> dict[str, list[float]]:
    """Constants as sums of doubles; the product of integers of 20 and 33 bits is exact."""
    return {
        "LN2": as_sum(log(2), (32, 0)),
        "LN10_INVERSE": as_sum(1 / log(10), (0, 0)),
        "LOG10_OF_2": as_sum(log(2) / log(10), (32, 0)),
        "LN2_INVERSE": as_sum(1 / log(2), (0, 0)),
        "LOG_TINY": as_sum(log(mpf(1e-100)), (0, 0)),
        "PI_HALF": as_sum(pi / 2, (0, 0)),
        "PI_QUARTER": as_sum(pi / 4, (0, 0)),
        "PI_HALF_SHORT": as_sum(pi / 2, (33, 33, 0)),
    }


def words_of_two_over_pi() -> list[str]:
    """The first fractional bits of 2 / pi, after two words of zeros."""
    with mp.workdps(32 * WORDS // 3):
        whole = int(mp.floor(mp.ldexp(2 / pi, 32 * WORDS)))
    return ["0u", "0u"] + [f"{whole >> 32 * k & 0xFFFFFFFF:#010x}u" for k in reversed(range(WORDS))]


def text() -> str:
    """The file."""
    with mp.workdps(DIGITS):
        lines = ["/* Written by experiments/check/coefficients.py. */"]
        for name, (function, low, high, count) in polynomials().items():
            fitted = interpolated(function, low, high, count)
            lines += [f"#define {name}_{k} {c.hex()}" for k, c in enumerate(fitted)]
        for name, terms in constants().items():
            lines += [f"#define {name}_{k} {term.hex()}" for k, term in enumerate(terms)]
    words = words_of_two_over_pi()
    lines.append(f"#define TWO_OVER_PI_WORDS {len(words)}")
    lines.append("#define TWO_OVER_PI \\")
    rows = [", ".join(words[k : k + 6]) for k in range(0, len(words), 6)]
    return "\n".join(lines) + "\n    " + ", \\\n    ".join(rows) + "\n"


if __name__ == "__main__":
    FILE.write_text(text(), encoding="ascii")
    print(f"written: {FILE}")
