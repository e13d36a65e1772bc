"""Whether a journal of an earlier call is still right: some of its evaluations are made again."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from miho.parallel.journal import Journal, JournalError, Key, UncheckedJournalError
from miho.parallel.remote import Raised

Array = NDArray[np.float64]
Value = Array | Raised

FIRST, FURTHER = 3, 1
"""Evaluations that are made again of the first function that a run asks for, and of each other one:
another part of a joint problem, some of the rows, a Jacobian."""
CLOSE = 1e-9
"""Values agree within this share of the largest of them: threads that add in another order and the
mathematical functions of another machine differ by 1e-16 to 1e-15, and a simulation adds to it."""
EARLY = 10
"""First values of a function, whose typical size counts as well: residuals of a perfect fit are
rounding alone. The largest of all would not do: beside a single huge one, no change is large."""


class StaleJournalError(BaseException):
    """A journal whose values are not those of its functions any more, or cannot be compared.

    It is no error of a model, which is an Exception that methods may take for a rejected value. The
    `error`, a line, is for those who called the method.
    """

    def __init__(self, error: JournalError) -> None:
        super().__init__(str(error))
        self.error = error


class JournalCheck:
    """Compares values of an earlier call with those of today, for each function before its use."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._checked: set[str] = set()
        self._most = FIRST
        self._said: set[str] = set()

    def __call__(
        self,
        task: str,
        evaluate: Callable[[Sequence[Key]], Sequence[Value]],
        losses: Callable[[Array], Array] | None = None,
    ) -> None:
        """Check a task by some of its configurations, which `evaluate` evaluates.

        The best one by `losses` (n,) of values (n, ...) is among them. Raises StaleJournalError
        where a value differs, unless two evaluations of today differ as well.
        """
        if task in self._checked:
            return
        keys = self._samples(task, losses or _size)[: self._most]
        if keys:
            self._compare(keys, evaluate)
            self._most = FURTHER
        self._checked.add(task)

    def _samples(self, task: str, losses: Callable[[Array], Array]) -> list[Key]:
        """Keys of an earlier call, the most telling first.

        The best configuration, the latest without a value, the worst, and the first; without
        losses the last and the first.
        """
        loaded = islice(self._journal, self._journal.loaded)
        keys = [key for key in loaded if key[0] == task]
        finite = [key for key in keys if _is_finite(self._journal[key])]
        without = [key for key in keys if key not in set(finite)]
        telling = without[-1:]
        if finite:
            try:
                order = np.argsort(losses(np.array([self._journal[key] for key in finite])))
            except ValueError:  # losses of other rows than these are not known
                order = np.array([-1, 0])
            middle = finite[len(finite) // 2]
            telling = [finite[order[0]], *telling, finite[order[-1]], finite[0], middle]
        return list(dict.fromkeys([*telling, *without]))

    def _compare(
        self, keys: Sequence[Key], evaluate: Callable[[Sequence[Key]], Sequence[Value]]
    ) -> None:
        gaps, failures = list[float](), list[Raised]()
        gap_of = partial(_gap, typical=self._typical(keys[0][0]))
        for key, now in zip(keys, evaluate(keys), strict=True):
            gap = 0.0 if _passes(now) else gap_of(self._journal[key], now)
            again = evaluate([key])[0] if gap > CLOSE else now
            if _passes(again):
                failures.append(again)
            elif gap > CLOSE and gap_of(now, again) > CLOSE:
                self._say(
                    "two evaluations of one configuration differ, so that it cannot be compared "
                    "with its model; stored values are used as they are"
                )
                return
            elif gap > CLOSE:
                self._refuse(key, now)
            else:
                gaps.append(gap)
        if gaps and max(gaps) > 0:
            self._say(f"values differ by rounding, {max(gaps):.1g} of the largest")
        if not gaps:
            self._fail(failures)

    def _typical(self, task: str) -> float:
        """The median of the largest numbers of the first values of an earlier call."""
        loaded = islice(self._journal, self._journal.loaded)
        values = (self._journal[key] for key in loaded if key[0] == task)
        first = islice((v for v in values if not isinstance(v, Raised) and _is_finite(v)), EARLY)
        sizes = [float(np.abs(value).max(initial=0)) for value in first]
        return float(np.median(sizes)) if sizes else 0.0

    def _fail(self, failures: Sequence[Raised]) -> None:
        """Say what it means that no value could be compared."""
        failed = next((failure for failure in failures if not failure.overdue), None)
        if failed is None:
            self._say(
                "evaluations take longer than evaluation_limit now, so that the model is not "
                "checked; stored values are used as they are"
            )
            return
        raise StaleJournalError(
            UncheckedJournalError(
                f"journal {self._journal.path}: cannot be checked, the model fails now: "
                f"{failed.line}; mend that and try again"
            )
        )

    def _refuse(self, key: Key, now: Value) -> None:
        place = ", ".join(f"{x:.6g}" for x in np.frombuffer(key[1], dtype=float))
        before, after = _words(self._journal[key], now)
        raise StaleJournalError(
            JournalError(
                f"journal {self._journal.path}: its model has changed: at ({place}) it gave "
                f"{before}, now {after}; name another file, delete this one, or restore the model"
            )
        )

    def _say(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            sys.stderr.write(f"miho: journal {self._journal.path}: {text}\n")


def _passes(value: Value) -> TypeGuard[Raised]:
    """Whether this is a failure that may pass, which says nothing about the model."""
    return isinstance(value, Raised) and value.of_machine


def _is_finite(value: Value) -> bool:
    return not isinstance(value, Raised) and bool(np.isfinite(value).all())


def _size(values: Array) -> Array:
    """Losses as they are, the sum of squares of what has more than one number."""
    if values.ndim == 1:
        return values
    return np.asarray(np.square(values.reshape(len(values), -1)).sum(axis=1))


def _gap(one: Value, other: Value, typical: float = 0.0) -> float:
    """The largest difference of two values; 0 for the same bits.

    It is a share of the largest number of both, or of a `typical` one if that is larger.
    """
    if isinstance(one, Raised) or isinstance(other, Raised):
        same = isinstance(one, Raised) and isinstance(other, Raised) and one.name == other.name
        return 0.0 if same else math.inf
    if one.shape != other.shape:
        return math.inf
    different = _differ(one, other)
    if not different.any():
        return 0.0
    if not (np.isfinite(one) & np.isfinite(other))[different].all():
        return math.inf
    finite = np.concatenate([one[np.isfinite(one)], other[np.isfinite(other)]])
    size = np.abs(finite).max(initial=typical)
    return float((np.abs(one[different] - other[different]) / size).max())


def _differ(one: Array, other: Array) -> NDArray[np.bool_]:
    """Which numbers of two arrays differ: not those that are not a number in both."""
    return np.asarray((one != other) & ~(np.isnan(one) & np.isnan(other)))


def _words(before: Value, after: Value) -> tuple[str, str]:
    """Two values that differ in words: of arrays the numbers that differ most."""
    if isinstance(before, Raised) or isinstance(after, Raised) or before.shape != after.shape:
        return _word(before), _word(after)
    with np.errstate(invalid="ignore"):  # infinity less infinity
        gap = np.nan_to_num(np.abs(before - after), nan=math.inf, posinf=math.inf)
    place = np.unravel_index(np.argmax(np.where(_differ(before, after), gap, 0)), gap.shape)
    which = f" in row {place[0] + 1}" if gap.size > 1 else ""
    return f"{before[place]:.12g}{which}", f"{after[place]:.12g}"


def _word(value: Value) -> str:
    if isinstance(value, Raised):
        return value.line
    return f"{value.item():.12g}" if value.size == 1 else f"values of shape {value.shape}"
