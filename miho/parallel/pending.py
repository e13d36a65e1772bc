"""Values that are under way: asked for before they are needed, or with a worker."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field

from miho.parallel.journal import Key
from miho.parallel.remote import Answer


class NoWorkersLeft(BaseException):
    """No value can be evaluated any more; one line says why. It is no error of a model, which is an
    Exception that methods may take for a rejected value."""


@dataclass
class Ahead:
    """Values that were asked for before they are needed: `again` asks for them.

    Workers have `begun` them where it was known that it is worth while. Those `left` may not have
    come yet; of the others the `latest` is known, by its place in the order of all.
    """

    keys: Sequence[Key]
    again: Callable[[], object]
    begun: bool = True
    left: list[Key] = field(init=False)
    latest: float = field(init=False, default=-1.0)

    def __post_init__(self) -> None:
        self.left = list(self.keys)

    def __add__(self, other: Ahead) -> Ahead:
        """Both together."""

        def again() -> None:
            self.again()
            other.again()

        return Ahead([*self.keys, *other.keys], again, self.begun and other.begun)


@dataclass
class Pending:
    """A chunk of rows that a worker evaluates; `ended` counts the ends of all, in their order."""

    future: Future[Answer]
    keys: Sequence[Key]
    ended: float = math.inf
    begun: float = field(default_factory=time.monotonic)
