"""Levenberg-Marquardt descents of many datasets at once, each within the bounds of the space."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.fitting.datasets import Datasets
from miho.identification.inverse_root import INVOLVED, SINGULAR, SMALLEST
from miho.models.expression import Expression
from miho.models.model import ROOT, Model, rows_of
from miho.optim import Space
from miho.quantities import Array

NUMBERS = 2_000_000
"""Largest number of model values and derivatives per chunk."""
STEPS = 200
"""Largest number of steps of a descent."""
DAMPING, EASED, HARDENED, MOST_DAMPED = 1e-3, 0.1, 4.0, 1e10
"""Initial damping, its factors after an accepted and a rejected step, and the largest damping:
above it no step decreases the loss."""
STANDSTILL = 1e-13
"""A step that decreases the sum of squares by less than this share is the last."""
LEAST = 1e-300
LEAST_DAMPED = 1e-12
"""Less damping would leave the equations singular where derivatives depend on each other."""
SMALL = 1e-6
"""Smallest size of a parameter for finite differences, as a share of its range."""

Indices = NDArray[np.intp]


class Ends(NamedTuple):
    """Ends of descents: configurations (M, d), sums of squares (M,), and which converged."""

    thetas: Array
    squares: Array
    converged: NDArray[np.bool_]

    def better_of(self, other: Ends) -> Ends:
        """The lower of two ends of each dataset."""
        lower = other.squares < self.squares
        return Ends(
            np.where(lower[:, None], other.thetas, self.thetas),
            *(np.where(lower, new, own) for own, new in zip(self[1:], other[1:], strict=True)),
        )


@dataclass(frozen=True)
class Batch:
    """Datasets of one model as arrays: columns (p, M, N), outputs (M, N) and row counts (M,).

    Shorter datasets are padded with their last row; `real` (M, N) is false there.
    """

    model: Model
    space: Space
    columns: Array
    outputs: Array
    rows: NDArray[np.intp]
    real: NDArray[np.bool_]

    @classmethod
    def of(cls, model: Model, space: Space, datasets: Datasets, which: Indices) -> Batch:
        """Batch of some of the datasets."""
        rows = datasets.rows[which]
        places = np.minimum(np.arange(rows.max()), rows[:, None] - 1)
        at = datasets.ends[which, None] + places
        columns = datasets.X[:, places] if datasets.shared else datasets.X[:, at]
        real = np.arange(rows.max()) < rows[:, None]
        return cls(model, space, columns, datasets.y[at], rows, real)

    def residuals(self, thetas: Array, which: Indices) -> Array:
        """Model minus data (n, N) of datasets `which` (n,) at configurations (n, d)."""
        inputs = self.columns[:, which]
        if isinstance(self.model, Expression):
            with np.errstate(all="ignore"):
                values = self.model.value(tuple(inputs), tuple(thetas.T[:, :, None]))
        elif self._alike:
            values = rows_of(self.model.predict, thetas, *self.columns[:, 0])
        else:
            values = self._padded(
                rows_of(self.model.predict, theta[None], *part)[0]
                for theta, part in self._own(thetas, which)
            )
        return np.where(self.real[which], values - self.outputs[which], 0.0)

    def screened(self, count: int, best: int, progress: Callable[[int], object]) -> Array:
        """The `best` of `count` common starting points for each dataset, (best, M, d).

        There are none if the datasets have different inputs, because each would need evaluations.
        """
        thetas = self.space.decode(self.space.initial(count))
        if not self._alike:
            return np.empty((0, len(self.rows), len(self.space)))
        values = np.empty((count, self.outputs.shape[1]))
        for k, theta in enumerate(thetas):
            values[k] = rows_of(self.model.predict, theta[None], *self.columns[:, 0])[0]
            progress(0)
        with np.errstate(over="ignore", invalid="ignore"):
            squares = [
                np.sum(values**2, axis=1) - 2 * self.outputs[chunk] @ values.T
                for chunk in self.chunks(np.arange(len(self.rows)))
            ]
        order = [np.argsort(np.nan_to_num(each, nan=np.inf), axis=1)[:, :best] for each in squares]
        return thetas[np.concatenate(order).T]

    def _jacobian(self, theta: Array, columns: Array) -> Array:
        """Derivatives (N, d) of the model; NaN if it raises ValueError nearby."""
        try:
            return self.model.jacobian(theta, *columns)
        except ValueError:
            return np.full((columns.shape[1], theta.size), np.nan)

    @cached_property
    def _alike(self) -> bool:
        """Whether all datasets have the same input columns."""
        same = (self.columns == self.columns[:, :1]).all() and (self.rows == self.rows[0]).all()
        return bool(same)

    def _own(self, thetas: Array, which: Indices) -> Iterator[tuple[Array, Array]]:
        """Yield each configuration (d,) with the columns (p, N) of its dataset, without padding."""
        for theta, k in zip(thetas, which, strict=True):
            yield theta, self.columns[:, k, : self.rows[k]]

    def _padded(self, parts: Iterable[Array]) -> Array:
        """Stack values (N, ...) of datasets, padded with zeros to one length."""
        N = self.outputs.shape[1]
        return np.stack(
            [np.pad(part, [(0, N - len(part)), *[(0, 0)] * (part.ndim - 1)]) for part in parts]
        )

    def slopes(self, thetas: Array, which: Indices) -> Array:
        """Derivatives of the residuals, (n, N, d)."""
        inputs = self.columns[:, which]
        if isinstance(self.model, Expression):
            with np.errstate(all="ignore"):
                slopes = self.model.derivatives(tuple(inputs), tuple(thetas.T[:, :, None]))
            shape = inputs.shape[1:]
            J = np.stack([np.broadcast_to(slope, shape) for slope in slopes], axis=-1)
        elif self._alike:
            J = self._differences(thetas)
        else:
            J = self._padded(self._jacobian(*own) for own in self._own(thetas, which))
        return np.where(self.real[which][..., None], J, 0.0)

    def _differences(self, thetas: Array) -> Array:
        """Central differences (n, N, d) of all datasets at once, which share their columns."""
        width = np.maximum(np.abs(thetas), SMALL * (self.space.high - self.space.low))
        slopes = []
        for k, step in enumerate((ROOT * width).T):
            moved = np.zeros_like(thetas)
            moved[:, k] = step
            ends = (
                rows_of(self.model.predict, thetas + s * moved, *self.columns[:, 0])
                for s in (1, -1)
            )
            slopes.append(np.subtract(*ends) / (2 * step)[:, None])
        return np.stack(slopes, axis=-1)

    @staticmethod
    def squares(residuals: Array) -> Array:
        """Sums of squares (n,), infinite if a residual is not finite."""
        with np.errstate(over="ignore", invalid="ignore"):
            sums = np.einsum("ij,ij->i", residuals, residuals)
        return np.where(np.isfinite(sums), sums, np.inf)

    def covariance(self, ends: Ends) -> Array:
        """Covariance (M, d, d) at the ends; NaN at a bound, and without a degree of freedom.

        A parameter that the data do not determine has an infinite variance.
        """
        low, high = self.space.low, self.space.high
        fixed = (ends.thetas <= low) | (ends.thetas >= high)
        freedom = self.rows - (~fixed).sum(axis=1)
        covariance = np.full((*fixed.shape, fixed.shape[1]), np.nan)
        for chunk in self.chunks(np.flatnonzero(freedom > 0)):
            J = self.slopes(ends.thetas[chunk], chunk)
            J = np.where(fixed[chunk][:, None, :], 0.0, J)
            squares = ends.squares[chunk]
            finite = np.isfinite(J).all(axis=(1, 2)) & np.isfinite(squares)
            unknown = fixed[chunk] | ~finite[:, None]
            inverse, free = inverses(np.where(np.isfinite(J), J, 0.0))
            inverse *= (np.where(finite, squares, 0.0) / freedom[chunk])[:, None, None]
            k, j = np.nonzero(free)
            inverse[k, j], inverse[k, :, j], inverse[k, j, j] = 0.0, 0.0, np.inf
            inverse[unknown[:, :, None] | unknown[:, None, :]] = np.nan
            covariance[chunk] = inverse
        return covariance

    def chunks(self, which: Indices) -> list[Indices]:
        """Datasets in chunks of about NUMBERS values and derivatives."""
        size = max(1, NUMBERS // (self.outputs.shape[1] * (len(self.space) + 1)))
        return [which[k : k + size] for k in range(0, which.size, size)]


def inverses(J: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The pseudo-inverse (n, d, d) of J.T J, and which parameters (n, d) J does not determine."""
    scale = np.linalg.norm(J, axis=1)
    scale[scale < SMALLEST] = np.inf
    _, s, V = np.linalg.svd(J / scale[:, None, :], full_matrices=False)
    determined = s > SINGULAR * s[:, :1]
    V = np.where(determined[..., None], V, 0.0)
    root = V / np.where(determined, s, 1.0)[..., None] / scale[:, None, :]
    return root.transpose(0, 2, 1) @ root, 1 - (V**2).sum(axis=1) > INVOLVED**2


def descend(batch: Batch, which: Indices, starts: Array, progress: Callable[[int], object]) -> Ends:
    """Descend with the datasets `which`, each from the best of its starts.

    Starts are (s, d) for all datasets, or (s, M, d) for each of all M datasets.
    """
    ends = [
        _descend(batch, chunk, starts) for chunk in batch.chunks(which) if not progress(chunk[0])
    ]
    return Ends(*map(np.concatenate, zip(*ends, strict=True)))


def _descend(batch: Batch, which: Indices, starts: Array) -> Ends:
    """Descend with one chunk, in search coordinates (logarithms of log-scale parameters)."""
    space = batch.space
    low, high = space.bounds
    log = np.array([parameter.scale == "log" for parameter in space.parameters])
    n, d = which.size, low.size
    # The best start of each dataset.
    x, squares = np.full((n, d), np.nan), np.full(n, np.inf)
    for start in starts:
        own = np.tile(start, (n, 1)) if start.ndim == 1 else start[which]
        values = batch.squares(batch.residuals(own, which))
        won = values < squares
        x[won], squares[won] = space.encode(own[won]), values[won]
    damping, moving = np.full(n, DAMPING), np.isfinite(squares)
    converged = np.zeros(n, dtype=bool)
    for _ in range(STEPS):
        k = np.flatnonzero(moving)
        if not k.size:
            break
        # A step of each active dataset; parameters that would leave the box stay at their bound.
        thetas = space.decode(x[k])
        r = batch.residuals(thetas, which[k])
        J = batch.slopes(thetas, which[k]) * np.where(log, thetas, 1.0)[:, None, :]
        gradient = np.einsum("ijk,ij->ik", J, r)
        fixed = ((x[k] <= low) & (gradient > 0)) | ((x[k] >= high) & (gradient < 0))
        # The normal matrix, with unit rows for the parameters that stay.
        J = np.where(fixed[:, None, :], 0.0, J)
        A = J.transpose(0, 2, 1) @ J
        A[:, np.arange(d), np.arange(d)] += fixed
        usable = np.isfinite(A).all(axis=(1, 2)) & np.isfinite(gradient).all(axis=1)
        A[~usable], gradient[fixed] = np.eye(d), 0.0
        scale = np.sqrt(np.maximum(np.diagonal(A, axis1=1, axis2=2), LEAST))
        A /= scale[:, :, None] * scale[:, None, :]
        A[:, np.arange(d), np.arange(d)] += damping[k, None]
        step = np.linalg.solve(A, -(gradient / scale)[..., None])[..., 0] / scale
        trial = np.clip(x[k] + np.where(usable[:, None], step, 0.0), low, high)
        values = batch.squares(batch.residuals(space.decode(trial), which[k]))
        # Accept a decrease; stop after a negligible one, or if no step decreases the sum.
        gain = squares[k] - values
        taken = gain > 0
        x[k[taken]], squares[k[taken]] = trial[taken], values[taken]
        damping[k] = np.maximum(damping[k] * np.where(taken, EASED, HARDENED), LEAST_DAMPED)
        last = np.abs(gain) <= STANDSTILL * (squares[k] + LEAST)
        stuck = ~usable | (damping[k] > MOST_DAMPED)
        # Where the model has no value beyond, it may fall along the edge.
        converged[k] |= last | (stuck & usable & np.isfinite(values))
        moving[k] = ~(last | stuck)
    return Ends(np.clip(space.decode(x), space.low, space.high), squares, converged)
