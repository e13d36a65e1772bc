"""Quantities that a model derives from its parameters, with their signs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from miho.quantities import Array


@dataclass(frozen=True)
class Derived:
    """A quantity computed from parameter rows (n, d).

    Parameters
    ----------
    name, unit : str
        Name and unit of the quantity.
    evaluate : callable
        Gives values (n,) at parameter rows (n, d); NaN if there is no value.
    tied : str
        The name of the tied or fixed parameter, if the quantity is one.
    sign : int
        The sign that the quantity always has; 0 if there is no such sign.
    remark : str
        The report's words on a value of the opposite sign, after the name and "has".
    """

    name: str
    unit: str
    evaluate: Callable[[Array], Array]
    tied: str = ""
    sign: int = 0
    remark: str = "the wrong sign."
