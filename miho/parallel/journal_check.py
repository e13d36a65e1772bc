"""Check the journal of an earlier call by repeating some of its evaluations."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from miho.parallel.errors import JournalError, StaleJournalError, UncheckedJournalError
from miho.parallel.journal import Journal, Key
from miho.parallel.remote import Raised
from miho.quantities import Array

Value = Array | Raised

FIRST, FURTHER = 3, 1
"""Evaluations that are repeated for the first function that a run requests, and for each further
one. Further functions are other parts of a joint problem, subsets of rows, and Jacobians."""
CLOSE = 1e-9
"""Relative tolerance of values, as a share of the largest number in them. Another order of
summation and the mathematical functions of another machine change values by 1e-16 to 1e-15, and a
simulation amplifies that."""
EARLY = 10
"""Number of first values of a function that give its typical size, which is a further scale for
differences: the residuals of a perfect fit are rounding errors. The largest value of all would not
do, because one huge value would hide every change."""


class JournalCheck:
    """Compare values of an earlier call with new evaluations, for each function before its use."""

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
        """Check a function at some of its configurations with `evaluate`.

        They include the best configuration by `losses`, which maps values (n, ...) to losses (n,).
        Raises StaleJournalError if a value differs, unless two new evaluations differ from each
        other as well.
        """
        if task in self._checked:
            return
        keys = self._samples(task, losses or _size)[: self._most]
        if keys:
            self._compare(keys, evaluate)
            self._most = FURTHER
        self._checked.add(task)

    def _samples(self, task: str, losses: Callable[[Array], Array]) -> list[Key]:
        """Keys of an earlier call, the most informative first.

        These are the best configuration, the latest without a value, the worst, and the first; if
        the losses are unknown, the last and the first.
        """
        loaded = islice(self._journal, self._journal.loaded)
        keys = [key for key in loaded if key[0] == task]
        finite = [key for key in keys if _is_finite(self._journal[key])]
        without = [key for key in keys if key not in set(finite)]
        telling = without[-1:]
        if finite:
            try:
                order = np.argsort(losses(np.array([self._journal[key] for key in finite])))
            except ValueError:  # the losses of other rows are not known
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
                    "two evaluations of one configuration differ, so stored values cannot be "
                    "checked; they are used as they are"
                )
                return
            elif gap > CLOSE:
                self._refuse(key, now)
            else:
                gaps.append(gap)
        if gaps and max(gaps) > 0:
            self._say(f"values differ by rounding errors, {max(gaps):.1g} of the largest")
        if not gaps:
            self._fail(failures)

    def _typical(self, task: str) -> float:
        """Typical size of a function's values: the median over the first of their maxima."""
        loaded = islice(self._journal, self._journal.loaded)
        values = (self._journal[key] for key in loaded if key[0] == task)
        first = islice((v for v in values if not isinstance(v, Raised) and _is_finite(v)), EARLY)
        sizes = [float(np.abs(value).max(initial=0)) for value in first]
        return float(np.median(sizes)) if sizes else 0.0

    def _fail(self, failures: Sequence[Raised]) -> None:
        """Report that no value could be compared."""
        failed = next((failure for failure in failures if not failure.overdue), None)
        if failed is None:
            self._say(
                "evaluations now take longer than evaluation_limit, so stored values cannot be "
                "checked; they are used as they are"
            )
            return
        raise StaleJournalError(
            UncheckedJournalError(
                f"journal {self._journal.path}: cannot be checked, because the model now fails: "
                f"{failed.line}; correct that and try again"
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
    """Return whether a value is a transient failure, which says nothing about the model."""
    return isinstance(value, Raised) and value.of_machine


def _is_finite(value: Value) -> bool:
    return not isinstance(value, Raised) and bool(np.isfinite(value).all())


def _size(values: Array) -> Array:
    """Losses of values (n, ...): the values themselves, or sums of squares of arrays."""
    if values.ndim == 1:
        return values
    return np.asarray(np.square(values.reshape(len(values), -1)).sum(axis=1))


def _gap(value: Value, other: Value, typical: float = 0.0) -> float:
    """Largest difference of two values, relative to the largest number in them; 0 if equal.

    The scale is at least `typical`.
    """
    if isinstance(value, Raised) or isinstance(other, Raised):
        same = isinstance(value, Raised) and isinstance(other, Raised) and value.name == other.name
        return 0.0 if same else math.inf
    if value.shape != other.shape:
        return math.inf
    different = _differ(value, other)
    if not different.any():
        return 0.0
    if not (np.isfinite(value) & np.isfinite(other))[different].all():
        return math.inf
    finite = np.concatenate([value[np.isfinite(value)], other[np.isfinite(other)]])
    size = np.abs(finite).max(initial=typical)
    return float((np.abs(value[different] - other[different]) / size).max())


def _differ(values: Array, other: Array) -> NDArray[np.bool_]:
    """Mask of the numbers that differ between two arrays; two NaN are equal."""
    return np.asarray((values != other) & ~(np.isnan(values) & np.isnan(other)))


def _words(before: Value, after: Value) -> tuple[str, str]:
    """Two different values as text; for arrays, the numbers that differ most."""
    if isinstance(before, Raised) or isinstance(after, Raised) or before.shape != after.shape:
        return _word(before), _word(after)
    with np.errstate(invalid="ignore"):  # infinity minus infinity
        gap = np.nan_to_num(np.abs(before - after), nan=math.inf, posinf=math.inf)
    place = np.unravel_index(np.argmax(np.where(_differ(before, after), gap, 0)), gap.shape)
    which = f" in row {place[0] + 1}" if gap.size > 1 else ""
    return f"{before[place]:.12g}{which}", f"{after[place]:.12g}"


def _word(value: Value) -> str:
    if isinstance(value, Raised):
        return value.line
    return f"{value.item():.12g}" if value.size == 1 else f"values of shape {value.shape}"
