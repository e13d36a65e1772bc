"""Thousands of small fits of a formula by the virtual machine of `miho.core`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.core import Tape, machine
from miho.fitting.datasets import Datasets
from miho.fitting.descents import Batch, Ends, Indices
from miho.models.expression import Expression
from miho.models.formula_tape import traced_together
from miho.models.model import Model
from miho.optim import Space
from miho.optim.brackets import draw_starts
from miho.quantities import Array

BRACKETS, FIRST = 32, 4
"""Largest number of brackets, and the number that suffices for nearly all datasets."""
SIZE, LARGEST = 16, 64
"""Starts of a bracket for each nonlinear parameter, and at most."""
FEW, MANY = 2, 7
"""This number of descents, plus one for each nonlinear parameter, is enough if all end in one
optimum; from MANY on the rule of evidence applies."""
NUMBERS = 2_000_000
"""Values and derivatives per call, at one configuration of each dataset: a fraction of a second."""
ROUNDING = 1e-12
"""Residuals below this share of the data are rounding."""
CONVERGED, EVIDENT, SINGULAR = 0, 1, 2


class Optima(NamedTuple):
    """`Ends`, their covariance (M, d, d), and flags (M, 3) of `miho/core/many.h`."""

    thetas: Array
    squares: Array
    converged: NDArray[np.bool_]
    covariance: Array
    flags: NDArray[np.bool_]

    @property
    def ends(self) -> Ends:
        """The ends alone."""
        return Ends(*self[:3])

    def some(self, at: Indices) -> Optima:
        """Results at given positions."""
        return Optima._make(values[at] for values in self)

    def put(self, at: Indices, other: Optima) -> None:
        """Replace the results at given positions."""
        for values, new in zip(self, other, strict=True):
            values[at] = new


@dataclass(frozen=True)
class MachineFits:
    """Fits of many datasets, each by descents from the best starts of its brackets.

    All datasets have the same brackets, drawn as in `MIHOGN`. Here all starts are evaluated on all
    rows, and one start of each bracket descends. A dataset is done when its first brackets have all
    ended in one optimum, or by the rule of `miho.optim.evidence`. So the result of a dataset does
    not depend on the other datasets.
    """

    model: Model
    space: Space
    datasets: Datasets
    tape: Tape
    level: int = -1

    @classmethod
    def of(cls, model: Model, space: Space, datasets: Datasets) -> MachineFits | None:
        """Fits of a formula; None without the machine, and for models that are not formulas."""
        if machine() is None or not isinstance(model, Expression):
            return None
        tape = traced_together(
            model.value, model.derivatives, len(model.inputs), len(model.parameters)
        )
        return None if tape is None else cls(model, space, datasets, tape)

    def search(
        self, which: Indices, seed: Sequence[int], progress: Callable[[int], object], few: int = 0
    ) -> Optima:
        """Optima of some datasets; `few` descents are enough if all of them end in one optimum."""
        few = few or min(MANY, FEW + self._nonlinear)
        optima = self._fit(which, self._brackets(seed, FIRST), few, False, progress)
        rest = np.flatnonzero(~optima.flags[:, EVIDENT])
        if rest.size:
            brackets = self._brackets(seed, BRACKETS)
            optima.put(rest, self._fit(which[rest], brackets, few, False, progress))
        return optima

    def descend(
        self, which: Indices, starts: Array, progress: Callable[[int], object] = lambda _: None
    ) -> Optima:
        """Best ends of descents from all starts: (M, s, d) for each dataset, or (1, s, d)."""
        return self._fit(which, starts, 1, True, progress)

    def covariance(self, optima: Optima) -> Array:
        """Covariance (M, d, d); computed with NumPy where derivatives are nearly dependent."""
        singular = np.flatnonzero(optima.flags[:, SINGULAR])
        if singular.size:
            batch = Batch.of(self.model, self.space, self.datasets, singular)
            optima.covariance[singular] = batch.covariance(optima.some(singular).ends)
        return optima.covariance

    def _brackets(self, seed: Sequence[int], count: int) -> Array:
        """Starts (count, size, d) of the first brackets, in units."""
        size = min(LARGEST, SIZE * self._nonlinear)
        drawn = [
            draw_starts(self.space, size, np.random.default_rng([*seed, k]), k)
            for k in range(1, count + 1)
        ]
        return np.ascontiguousarray(self.space.decode(np.concatenate(drawn))).reshape(
            count, size, -1
        )

    def _fit(
        self, which: Indices, starts: Array, few: int, own: bool, progress: Callable[[int], object]
    ) -> Optima:
        n, d = len(which), len(self.space)
        thetas, squares = np.empty((n, d)), np.empty(n)
        covariance, flags = np.empty((n, d, d)), np.zeros((n, 3), dtype=bool)
        each = own and len(starts) > 1
        size = max(1, int(NUMBERS // (self.datasets.rows.mean() * (d + 1))))
        for start in range(0, n, size):
            progress(start)
            part = slice(start, start + size)
            machine().fit_many(
                *self._given, (np.ascontiguousarray(starts[part] if each else starts), few, own),
                np.ascontiguousarray(which[part], dtype=np.int64),
                thetas[part], squares[part], covariance[part], flags[part],
            )  # fmt: skip
        return Optima(thetas, squares, flags[:, CONVERGED].copy(), covariance, flags)

    @cached_property
    def _given(self) -> tuple[Any, ...]:
        """Arguments that are the same in all calls."""
        data, space = self.datasets, self.space
        log = np.array([parameter.scale == "log" for parameter in space.parameters])
        box = tuple(np.array(end, dtype=float) for end in (space.low, space.high))
        linear = np.array(self._linear, dtype=np.int64)
        tape = self.tape.at_level(self.level)
        return tape, data.X, data.y, data.ends, data.shared, (*box, log, linear)

    @property
    def _nonlinear(self) -> int:
        """Number of nonlinear parameters, at least 1."""
        return max(1, len(self.space) - len(self._linear))

    @cached_property
    def _linear(self) -> list[int]:
        """Positions of the parameters in which the model is jointly linear."""
        names = self.model.linear
        return [k for k, name in enumerate(self.space.names) if name in names]


def checked(fits: MachineFits, optima: Optima, which: Indices, seed: int, better: float) -> Indices:
    """Search some datasets again with different brackets, until the rule of evidence is met.

    They also descend from the optima of the other checked datasets. Returns the datasets whose sum
    of squares decreased by more than the share `better`, after their results in `optima` are
    replaced.
    """
    again = fits.search(which, (seed, 1), lambda _: None, few=BRACKETS)
    ends = optima.thetas[which[np.isfinite(optima.squares[which])]]
    if len(ends):
        others = fits.descend(which, ends[None])
        lower = np.flatnonzero(others.squares < again.squares)
        again.put(lower, others.some(lower))
    zero = ROUNDING**2 * np.array([np.sum(fits.datasets.output(k) ** 2) for k in which])
    least = (1 - better) * optima.squares[which] - zero
    lower = np.flatnonzero(again.squares < least)
    optima.put(which[lower], again.some(lower))
    return which[lower]
