"""Trajectories without the machine: Runge-Kutta in NumPy, and SciPy's stiff solvers."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from miho.models.equations import Equations
from miho.models.layout import Course
from miho.quantities import Array

ABSOLUTE = 1e-4
"""Absolute tolerance of states, as a fraction of the relative tolerance."""
MOST_CALLS = 100_000
"""Largest number of rate evaluations of a stiff solver, after which the solution is given up."""

Path = Callable[[Array, int, int], Array]
"""(z (S, w) at row i, i, j) -> z at rows i to j, (j - i + 1, S, w)."""


@dataclass(frozen=True)
class Values:
    """States z (S, n) of n parameter rows p (d, n)."""

    equations: Equations
    p: Array

    def begin(self, course: Course, m: int) -> Array:
        """Return z at start number m."""
        fixed = np.repeat(course.values[m][:, None], self.p.shape[1], axis=1)
        starts = np.where(course.parameters[m][:, None] < 0, fixed, self.p[course.parameters[m]])
        return np.asarray(starts)

    def rates(self, t: float, u: Array, z: Array) -> Array:
        """dz / dt."""
        return self.equations.rates(t, u, z, self.p)

    def observed(self, t: float, u: Array, z: Array) -> Array:
        """The outputs, (K, n)."""
        return self.equations.observed(t, u, z, self.p)


@dataclass(frozen=True)
class Sensitivities:
    """State of one parameter row p (d,) with its sensitivities: z = [x, x_p w] (S, 1 + d).

    `scale` w (d,) gives sensitivities the size of the states, so one tolerance suits both.
    """

    equations: Equations
    p: Array
    scale: Array

    def begin(self, course: Course, m: int) -> Array:
        """Return z at start number m."""
        k = course.parameters[m]
        x = np.where(k < 0, course.values[m], self.p[k])
        return np.column_stack([x, (k[:, None] == np.arange(self.p.size)) * self.scale])

    def rates(self, t: float, u: Array, z: Array) -> Array:
        """dz / dt."""
        by_state, by_parameter = self.equations.rate_slopes(t, u, z[:, 0], self.p)
        rates = self.equations.rates(t, u, z[:, 0], self.p)
        return np.column_stack([rates, by_state @ z[:, 1:] + by_parameter * self.scale])

    def observed(self, t: float, u: Array, z: Array) -> Array:
        """The derivatives of the outputs by the parameters, (K, d)."""
        by_state, by_parameter = self.equations.output_slopes(t, u, z[:, 0], self.p)
        return np.asarray(by_state @ (z[:, 1:] / self.scale) + by_parameter)


Motion = Values | Sensitivities


def along(course: Course, motion: Motion, path: Path) -> Array:
    """Return the `observed` values of a motion at the rows of data, (R, w), NaN without a value."""
    results: Array | None = None
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for m, first, start, end in _stretches(course):
            states = path(motion.begin(course, m), start, end)
            for j in range(first, end + 1):
                y = motion.observed(course.t[j], course.u[j], states[j - start])
                if results is None:
                    results = np.full((course.output.size, y.shape[1]), np.nan)
                rows = course.rows[course.first[j] : course.first[j + 1]]
                results[rows] = y[course.output[rows]]
    if results is None:
        raise ValueError("expected at least one row of data, got none")
    return results


def _stretches(course: Course) -> Iterator[tuple[int, int, int, int]]:
    """Yield (start number, first observed row, start row, last row) of each stretch."""
    starts = np.flatnonzero(course.reset >= 0)
    ends = [*(starts[1:] - (not course.restart)), course.t.size - 1]
    for start, end in zip(starts, ends, strict=True):
        first = start + (course.restart and start > 0)
        yield int(course.reset[start]), int(first), int(start), int(end)


def input_at(course: Course, j: int, share: float) -> Array:
    """Return the inputs at a fraction of the way from row j to row j + 1."""
    if course.held:
        return np.asarray(course.u[j])
    return np.asarray(course.u[j] + share * (course.u[j + 1] - course.u[j]))


def runge_kutta(course: Course, motion: Motion) -> Path:
    """Return paths by the classical fourth-order method, with the same steps as the machine."""

    def step(z: Array, j: int, substep: int, h: float) -> Array:
        after, dz = z, np.zeros_like(z)
        for stage in range(4):
            ahead = ((stage + 1) // 2) / 2
            u = input_at(course, j, (substep + ahead) / course.substeps)
            dz = motion.rates(course.t[j] + (substep + ahead) * h, u, z + ahead * h * dz)
            after = after + (h / 3 if stage in (1, 2) else h / 6) * dz
        return after

    def path(z: Array, start: int, end: int) -> Array:
        states = [z]
        for j in range(start, end):
            for substep in range(course.substeps):
                z = step(z, j, substep, (course.t[j + 1] - course.t[j]) / course.substeps)
            states.append(z)
        return np.array(states)

    return path


def stiff(course: Course, motion: Motion, method: str, tolerance: float) -> Path:
    """Return paths by a method of `scipy.integrate.solve_ivp`, NaN from the point of a failure.

    Inputs with the interpolation "hold" jump at the rows, so the solver restarts at each row. With
    linear inputs, the largest step is the largest distance of rows, so that no input is skipped.
    """
    from scipy.integrate import solve_ivp  # the import takes a second

    calls = 0

    def at(t: float, j: int, end: int) -> Array:
        j = min(max(int(np.searchsorted(course.t, t, "right")) - 1, j), end - 1)
        return input_at(course, j, (t - course.t[j]) / (course.t[j + 1] - course.t[j]))

    p = motion.p if motion.p.ndim == 1 else motion.p[:, 0]

    def span(z: Array, start: int, end: int) -> Array:
        t, shape = course.t[start : end + 1], z.shape
        states = np.full((t.size, *shape), np.nan)
        if end == start or not np.isfinite(z).all():
            states[0] = z
            return states

        def rates(now: float, flat: Array) -> Array:
            nonlocal calls
            calls += 1
            if calls > MOST_CALLS:
                raise ArithmeticError("too many steps")
            return motion.rates(now, at(now, start, end), flat.reshape(shape)).ravel()

        def slope(now: float, flat: Array) -> Array:
            # Without second derivatives of the rates, which Newton's iterations of a step need not.
            u, x = at(now, start, end), flat.reshape(shape)[:, 0]
            by_state = motion.equations.rate_slopes(now, u, x, p)[0]
            return np.asarray(np.kron(by_state, np.eye(shape[1])), dtype=float)

        motion.rates(t[0], at(t[0], start, end), z)  # raises errors of the function
        longest = float(np.diff(t).max()) if course.u.shape[1] else np.inf
        try:
            solution: Any = solve_ivp(  # type: ignore[call-overload]
                rates, (t[0], t[-1]), z.ravel(), method, t, jac=slope, max_step=longest,
                rtol=tolerance, atol=ABSOLUTE * tolerance,
            )  # fmt: skip
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):  # diverges
            states[0] = z
            return states
        states[: solution.t.size] = solution.y.T.reshape(-1, *shape)
        return states

    def path(z: Array, start: int, end: int) -> Array:
        if not (course.held and course.u.shape[1]):
            return span(z, start, end)
        states = [z]
        for j in range(start, end):
            states.append(span(states[-1], j, j + 1)[1])
        return np.array(states)

    return path
