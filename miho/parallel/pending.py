"""Values in progress: requested before they are needed, or being made by a worker."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from concurrent.futures import Future

    from miho.parallel.journal import Key
    from miho.parallel.remote import Answer


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
