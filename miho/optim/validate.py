"""Sentences for settings that cannot be used: which field, which value, what was expected."""

from __future__ import annotations

import math
from collections.abc import Sequence


def one_of(field: str, value: str, allowed: Sequence[str]) -> None:
    """Raise ValueError unless `value` is one of `allowed`."""
    if value not in allowed:
        raise ValueError(f"{field} is {value!r}; expected one of {', '.join(allowed)}")


def at_least(field: str, value: float, low: float, *, whole: bool = False) -> None:
    """Raise ValueError unless `value` is a finite number, `whole` an integer, of at least `low`."""
    number = isinstance(value, int) if whole else isinstance(value, int | float)
    if not number or isinstance(value, bool) or not math.isfinite(value) or value < low:
        kind = "a whole number" if whole else "a number"
        raise ValueError(f"{field} is {value!r}; expected {kind} of at least {low:g}")


def positive(field: str, value: float) -> None:
    """Raise ValueError unless `value` is a finite number above zero."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        raise ValueError(f"{field} is {value!r}; expected a number above zero")
