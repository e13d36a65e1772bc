"""The loss of a model of one input from a few nodes instead of all points, to a stated accuracy.

The mean square over panels (`panel_sums`) with an error E that is a fixed small part of the root of
the loss, or of the scatter that no smooth curve explains. A loss below that scatter is summed point
by point, as are all losses of data without scatter: the accuracy holds in every case.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

import miho.compiled.polynomials  # noqa: F401 -- registers the elementary functions
from miho.compiled.arrays import as_tuple, read_only
from miho.compiled.kernel import Formulas
from miho.compiled.panel_sums import (
    ROUNDING,
    WITHIN,
    PanelTerms,
    Scratch,
    panel_sums,
    panel_terms,
    scratch_for,
)
from miho.compiled.panels import panels
from miho.compiled.signature import Signed, signed_formulas, signing
from miho.compiled.taped import equal_parts
from miho.compiled.threads import threads_of
from miho.quantities import Array

TRUNCATION = 0.15
"""E as a share of the tolerance times the root of the loss: 2 WITHIN times this is 0.7 of that."""
ROUGH = 3
"""E in units of the scatter for a first sum, which tells how large the loss is."""
SCATTER = 0.5
"""A loss is expected to have at least this share of the scatter that is left on the leaves."""
SHARE = 100
"""A batch of so many candidates is worth a further thread."""


@dataclass(frozen=True, eq=False)
class CompressedLoss:
    """Mean square of model minus data within the relative `tolerance` of that over all points.

    x (N,) is the only input of the model, which has a `bound`; y (N,) the output.
    """

    model: Formulas
    x: Array
    y: Array
    tolerance: float = 1e-9
    threads: int = 1

    @cached_property
    def _compiled(self) -> _Compiled:
        model = self.model
        if model.bound is None:
            raise ValueError(
                f"{type(model).__name__} has no bound; only a model that has one can be compressed"
            )
        d = len(model.parameters)
        return _compile(signed_formulas((model.value, model.bound), (1, d)), d)

    @cached_property
    def _data(self) -> _Data:
        tree = panels(self.x, self.y)
        N = self.y.size
        size = math.sqrt(float(np.mean(self.y**2)))
        scatter = SCATTER * math.sqrt(tree.unexplained / N)
        accurate = 2 * ROUNDING * (scatter + 2 * size) <= 0.2 * self.tolerance * scatter
        goal = math.log(TRUNCATION * self.tolerance) if accurate else -math.inf
        return _Data(panel_terms(tree, N, size), goal, scatter)

    def _room(self) -> Scratch:
        return scratch_for(self._data.terms)

    def losses(self, thetas: Array) -> Array:
        """Losses (n,) of parameter rows (n, d)."""
        return self.counted(thetas, np.full(len(thetas), np.inf))[0]

    def counted(self, thetas: Array, limits: Array) -> tuple[Array, NDArray[np.int64]]:
        """Losses (n,) of rows (n, d), and how often each evaluated the model (n,).

        A loss is given up, and any number not below it given, once it is known not to be below its
        limit, `limits` (n,).
        """
        losses, counts = np.empty(len(thetas)), np.empty(len(thetas), np.int64)
        thetas, limits = read_only(thetas), read_only(limits)

        def part(rows: slice) -> None:
            self._compiled.losses(
                thetas[rows], limits[rows], self._data, self._room(), losses[rows], counts[rows]
            )

        parts = min(self.threads, len(thetas) // SHARE)
        if parts <= 1:
            part(slice(None))
        else:
            list(threads_of(self.threads).map(part, equal_parts(len(thetas), parts)))
        return losses, counts


class _Data(NamedTuple):
    """The terms, the logarithm of E relative to the root of a loss, and the expected scatter."""

    terms: PanelTerms
    goal: float
    scatter: float


@dataclass(frozen=True)
class _Compiled:
    losses: Callable[[Array, Array, _Data, Scratch, Array, NDArray[np.int64]], None]


@cache
def _compile(formulas: Signed, d: int) -> _Compiled:
    sign = signing(formulas.signature)
    value, bound = map(register_jitable, formulas.copies())
    over_panels, beaten = panel_sums(value, bound, sign)

    @register_jitable(error_model="numpy", forceinline=True)
    @sign
    def counted(theta: Array, limit: float, data: _Data, scratch: Scratch) -> tuple[float, int]:
        """The loss, or a number not below `limit` once it is known not to be, and model values."""
        # Coarse sums show whether it is beaten.
        parameters, terms, scatter = as_tuple(theta, d), data.terms, data.scatter
        is_beaten, count = beaten(parameters, limit, scratch, terms)
        if is_beaten:
            return limit, count
        # A rough sum tells the size of the loss, and so how accurate the next has to be.
        if data.goal > -np.inf:
            rough = ROUGH * scatter
            square, more = over_panels(parameters, math.log(rough), np.inf, scratch, terms)
            count += more
            least = max(math.sqrt(square) - WITHIN * rough, scatter)
            goal = data.goal + math.log(least)
            square, more = over_panels(parameters, goal, limit, scratch, terms)
            count += more
            if square >= min(limit, scatter**2):
                return square, count
        # Below the scatter only a sum over all points is accurate.
        square, more = over_panels(parameters, -np.inf, limit, scratch, terms)
        return square, count + more

    @njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
    @sign
    def losses(
        thetas: Array, limits: Array, data: _Data, scratch: Scratch, out: Array,
        counts: NDArray[np.int64],
    ) -> None:  # fmt: skip
        for i in range(len(thetas)):
            out[i], counts[i] = counted(thetas[i], limits[i], data, scratch)

    return _Compiled(losses)
