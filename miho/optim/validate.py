"""Sentences for settings that cannot be used: which field, which value, what was expected."""

from __future__ import annotations

import math
from collections.abc import Sequence


def one_of(field: str, value: str, allowed: Sequence[str]) -> None:
    """Raise ValueError unless `value` is one of `allowed`."""
    if value not in allowed:
        raise ValueError(f"{field} is {value!r}; expected one of {', '.join(allowed)}")


def at_least(field: str, value: float, low: float) -> None:
    """Raise ValueError unless `value` is a finite number of at least `low`."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not math.isfinite(value) or value < low:
        raise ValueError(f"{field} is {value!r}; expected a number of at least {low:g}")


def whole(field: str, value: int, low: int, high: int | None = None) -> None:
    """Raise ValueError unless `value` is an integer of at least `low` and at most `high`."""
    number = isinstance(value, int) and not isinstance(value, bool)
    if not number or value < low or (high is not None and value > high):
        top = "" if high is None else f" and at most {high:,}"
        raise ValueError(f"{field} is {value!r}; expected a whole number of at least {low}{top}")


def positive(field: str, value: float) -> None:
    """Raise ValueError unless `value` is a finite number above zero."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        raise ValueError(f"{field} is {value!r}; expected a number above zero")
