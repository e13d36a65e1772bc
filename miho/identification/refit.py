"""A least-squares optimum from nearby: the step that profiles, bootstraps and validation repeat."""

from __future__ import annotations

import math
import time
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second

from miho.identification.curve_fit import CurveFit
from miho.quantities import Array

EVALUATIONS = 200
"""Enough from nearby, for what is repeated many times."""
STANDSTILL = 1e-8
"""A descent whose second half gains less than this fraction of the sum of squares is at its end."""


class OutOfTimeError(Exception):
    """The seconds that a report may take are over."""


@dataclass
class Deadline:
    """When a report has to end, in seconds of `time.perf_counter`; `check` raises after that."""

    at: float = math.inf

    def check(self) -> None:
        """Raise OutOfTimeError if the time is over."""
        if self.over:
            raise OutOfTimeError

    @property
    def over(self) -> bool:
        """Whether the time is over."""
        return time.perf_counter() > self.at


class Refit(NamedTuple):
    """Where a descent ended: parameters (d,), and the sum of squared (transformed) residuals.

    It is a local optimum if `converged`; else the descent was still moving after `evaluations`, ran
    out of time, or met derivatives that are not finite.
    """

    theta: Array
    cost: float
    converged: bool = True
    evaluations: int = 1


class _NoDerivatives(Exception):  # noqa: N818 -- ends a descent, no error
    """The derivatives are not all finite numbers."""


class _Stationary(Exception):  # noqa: N818 -- ends a descent, no error
    """Nothing depends on the free parameters here."""


def refit(
    problem: CurveFit,
    start: Array,
    weights: Array | None = None,
    fixed: Collection[int] = (),
    tolerance: float = 1e-10,
    evaluations: int = EVALUATIONS,
    deadline: Deadline | None = None,
) -> Refit:
    """The optimum of the problem near `start` (d,), within the box.

    `weights` (N,) multiply the squared residuals; the parameters at the positions `fixed` stay at
    their start. Residuals that are not finite are a wall. After `evaluations` of the residuals, and
    after the deadline, the best so far is returned.
    """
    space = problem.space
    low, high = space.bounds
    theta = space.clip(start)
    free = np.array([i for i in range(theta.size) if i not in fixed], dtype=int)
    root = None if weights is None else np.sqrt(weights)
    logs = np.array([p.scale == "log" for p in space.parameters])

    # From 0 to 1 across the box and without an absolute tolerance: no unit is too small.
    first = np.clip(((space.encode(theta) - low) / (high - low))[free], 0.0, 1.0)

    def complete(part: Array) -> Array:
        if np.array_equal(part, first):  # unrounded by the scale
            return theta
        whole = space.encode(theta).copy()
        whole[free] = low[free] + (high - low)[free] * part
        moved = space.decode(whole)
        moved[list(fixed)] = theta[list(fixed)]
        return np.asarray(space.clip(moved))

    best = theta
    costs = [math.inf]  # the smallest so far, of each evaluation

    def residuals(part: Array) -> Array:
        nonlocal best
        if deadline is not None and costs[-1] < math.inf:
            deadline.check()
        moved = complete(part)
        try:
            values = problem.residuals(moved)
        except ValueError:  # a model may fail on a part of the box
            values = np.full(len(problem.dataset), np.nan)
        values = values if root is None else values * root
        with np.errstate(over="ignore", invalid="ignore"):
            cost = float(values @ values)
        if cost < costs[-1]:
            best = moved
        costs.append(min(costs[-1], cost) if math.isfinite(cost) else costs[-1])
        return values

    def jacobian(part: Array) -> Array:
        moved = complete(part)
        stretch = (high - low) * np.where(logs, moved, 1.0)
        derivatives = problem.jacobian(moved)[:, free] * stretch[free]
        if not np.isfinite(derivatives).all():
            raise _NoDerivatives
        if not derivatives.any():
            raise _Stationary  # SciPy would divide by them
        return np.asarray(derivatives if root is None else derivatives * root[:, None])

    at_start = residuals(first)
    if not math.isfinite(costs[-1]):
        return Refit(theta, math.inf, converged=False)
    if not free.size or costs[-1] == 0:
        return Refit(theta, costs[-1])

    def known_or_new(part: Array) -> Array:
        return at_start if np.array_equal(part, first) else residuals(part)

    try:
        solution = scipy.optimize.least_squares(
            known_or_new,
            first,
            jac=jacobian,
            bounds=(0.0, 1.0),
            x_scale="jac",
            ftol=tolerance,
            xtol=tolerance,
            gtol=None,
            max_nfev=evaluations,
        )
        # Along directions that the data do not see SciPy goes on, and gains nothing.
        late = costs[(len(costs) + 1) // 2]
        converged = solution.status > 0 or costs[-1] >= (1 - STANDSTILL) * late
    except _Stationary:
        converged = True
    except (_NoDerivatives, OutOfTimeError):
        converged = False
    return Refit(best, costs[-1], bool(converged), len(costs) - 1)
