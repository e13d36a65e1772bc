"""Numbers as a reader wants them: as many digits as their uncertainty leaves, in a handy unit."""

from __future__ import annotations

import math
from types import MappingProxyType

KILO = 1e4
"""Values from here on are written in thousands of their unit."""
PLACES = 6
"""Numbers that need more decimals than this are written with a power of ten."""
USUAL = MappingProxyType({"rad": (180 / math.pi, "deg"), "rad/s": (30 / math.pi, "rpm")})
PREFIXED = ("N", "Pa")


def scaled(value: float, unit: str) -> tuple[float, str]:
    """The factor to multiply by and the unit it gives.

    rad becomes deg, rad/s becomes rpm, and N/rad becomes kN/rad for large values.
    """
    if unit in USUAL:
        return USUAL[unit]
    if unit.startswith(PREFIXED) and math.isfinite(value) and abs(value) >= KILO:
        return 1e-3, f"k{unit}"
    return 1.0, unit


def digits(error: float) -> int:
    """Decimals that show two significant digits of an error; 6 if it is 0 or not finite."""
    if not math.isfinite(error) or error <= 0:
        return 6
    return max(0, 1 - math.floor(math.log10(error)))


def written(value: float, error: float) -> str:
    """A value rounded to what its error leaves, "-" for NaN."""
    if math.isnan(value):
        return "-"
    if not math.isfinite(error) or error <= 0 or math.isinf(value):
        return f"{value:.6g}"
    places = digits(error)
    if places > PLACES:
        exponent = math.floor(math.log10(max(abs(value), error)))
        return f"{value:.{max(0, places + exponent)}e}"
    return f"{value:.{places}f}"


def with_error(value: float, error: float) -> str:
    """ "value ± error", both with the digits the error leaves."""
    return f"{written(value, error)} ± {written(error, error)}"


def interval(low: float, high: float, error: float) -> str:
    """ "[low, high]" with the digits of the error; "-" if both ends are unknown."""
    if math.isnan(low) and math.isnan(high):
        return "-"
    return f"[{written(low, error)}, {written(high, error)}]"
