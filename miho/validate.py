"""Checks of settings, with errors that name the field, the value and the expected values."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from numbers import Integral, Real
from typing import TypeGuard

import numpy as np


def is_number(value: object) -> TypeGuard[float]:
    """Return whether `value` is a real number, which may be infinite or NaN, and not a bool."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_finite(value: object) -> TypeGuard[float]:
    """Return whether `value` is a finite real number, and not a bool."""
    return is_number(value) and math.isfinite(value)


def one_of(field: str, value: str, allowed: Collection[str]) -> None:
    """Raise ValueError unless `value` is one of `allowed`."""
    if value not in allowed:
        raise ValueError(f"{field} is {value!r}; expected one of {', '.join(allowed)}")


def at_least(field: str, value: float, low: float) -> None:
    """Raise ValueError unless `value` is a finite number of at least `low`."""
    if not is_finite(value) or value < low:
        raise ValueError(f"{field} is {value!r}; expected a number of at least {low:g}")


def number_or_infinity(field: str, value: float) -> None:
    """Raise ValueError unless `value` is a finite number or positive infinity."""
    if not is_finite(value) and value != math.inf:
        raise ValueError(f"{field} is {value!r}; expected a number, or inf for never")


def whole(
    field: str, value: int | None, low: int, high: int | None = None, *, none: bool = False
) -> None:
    """Raise ValueError unless `value` is an integer from `low` to `high`, or None if `none`."""
    if none and value is None:
        return
    if not _is_whole(value) or value < low or (high is not None and value > high):
        top = "" if high is None else f" and at most {high:,}"
        raise ValueError(f"{field} is {value!r}; expected a whole number of at least {low}{top}")


def positive(field: str, value: float, unit: str = "") -> None:
    """Raise ValueError unless `value` is a finite number above 0; the message ends with `unit`."""
    if not is_finite(value) or value <= 0:
        raise ValueError(f"{field} is {value!r}; expected a positive number{unit and f' {unit}'}")


def between_0_and_1(field: str, value: float) -> None:
    """Raise ValueError unless `value` is a number above 0 and below 1."""
    if not is_finite(value) or not 0 < value < 1:
        raise ValueError(f"{field} is {value!r}; expected a number between 0 and 1")


def true_or_false(settings: object, names: Iterable[str], none: bool = False) -> None:
    """Raise ValueError unless the attributes with these names are bools, or None if `none`."""
    for name in names:
        value = getattr(settings, name)
        if not (isinstance(value, bool | np.bool) or (none and value is None)):
            raise ValueError(f"{name} is {value!r}; expected True or False{', or None' * none}")


def settings_at_least(settings: object, names: Iterable[str], low: float) -> None:
    """Apply `at_least` to the attributes with these names."""
    for name in names:
        at_least(name, getattr(settings, name), low)


def whole_settings(
    settings: object, names: Iterable[str], low: int, high: int | None = None
) -> None:
    """Apply `whole` to the attributes with these names."""
    for name in names:
        whole(name, getattr(settings, name), low, high)


def positive_settings(settings: object, names: Iterable[str], unit: str = "") -> None:
    """Apply `positive` to the attributes with these names."""
    for name in names:
        positive(name, getattr(settings, name), unit)


def _is_whole(value: object) -> TypeGuard[int]:
    return isinstance(value, Integral) and not isinstance(value, bool)
