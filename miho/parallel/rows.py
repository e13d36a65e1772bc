"""Functions of parameter rows, and their values in progress.

A row that raises does not affect the other rows.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from miho.parallel.remote import Answer, Raised
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.parallel.evaluations import Evaluations
    from miho.parallel.journal import Key

Rows = Callable[[Array], Array]
"""Maps parameter rows (n, d) to values (n, ...); the value of a row does not depend on other
rows."""
Send = Callable[[Array], Future[Answer]]


@dataclass(frozen=True)
class ByRows:
    """Call a function of rows at once, and row by row if it raises."""

    function: Rows

    def __call__(self, thetas: Array) -> list[Array | Raised]:
        """The value of each row, or the exception that it raised."""
        try:
            values = np.asarray(self.function(thetas))
            if values.dtype.kind not in "fiu":
                raise TypeError(f"not real numbers: {values.dtype} of shape {values.shape}")
            if values.shape[:1] != (len(thetas),):
                raise ValueError(f"values of shape {values.shape} for {len(thetas)} rows")
            return list(values)
        except Exception as error:  # noqa: BLE001 -- any exception counts as the row's value
            if len(thetas) == 1:
                return [Raised.of(error)]
        return [value for theta in thetas for value in self(theta[None])]


def as_array(value: Any) -> Array | Raised:
    """A value in the precision of the journal."""
    return value if isinstance(value, Raised) else np.asarray(value, dtype=float)


@dataclass(frozen=True)
class Evaluated:
    """A function of parameter rows that workers may evaluate.

    Parameters
    ----------
    name : str
        Key of the function in the journal.
    function : callable
        Maps parameter rows (n, d) to values (n, ...).
    shape : tuple of int
        Shape of the values of one row.
    evaluations : Evaluations
        Makes the evaluations.
    send : callable, optional
        Submits rows to the workers.
    losses : callable, optional
        Maps values (n, ...) to losses (n,), to rank the values.
    """

    name: str
    function: Rows
    shape: tuple[int, ...]
    evaluations: Evaluations = field(repr=False)
    send: Send | None = field(default=None, repr=False)
    losses: Callable[[Array], Array] | None = field(default=None, repr=False)

    def __call__(self, thetas: Array) -> Array:
        """Values (n, ...) of rows (n, d); an exception of the function becomes a ValueError."""
        if self.evaluations.resting():
            return self.evaluations.worth.brief(self.function, thetas)
        return self.evaluations.values(self, thetas)


@dataclass
class Ahead:
    """Values that were requested before they are needed (futures).

    Attributes
    ----------
    keys : sequence of Key
        The values.
    again : callable
        Requests the values again.
    begun : bool
        Whether workers have begun them, because that is known to save time.
    left : list of Key
        Values that may not be complete yet.
    latest : float
        Position of the last complete value in the order of completion.
    """

    keys: Sequence[Key]
    again: Callable[[], object]
    begun: bool = True
    left: list[Key] = field(init=False)
    latest: float = field(init=False, default=-1.0)

    def __post_init__(self) -> None:
        self.left = list(self.keys)

    def __add__(self, other: Ahead) -> Ahead:
        """The values of both."""

        def again() -> None:
            self.again()
            other.again()

        return Ahead([*self.keys, *other.keys], again, self.begun and other.begun)


@dataclass
class Pending:
    """A chunk of rows that a worker evaluates; `ended` is its place in the order of completion."""

    future: Future[Answer]
    keys: Sequence[Key]
    ended: float = math.inf
    begun: float = field(default_factory=time.monotonic)
