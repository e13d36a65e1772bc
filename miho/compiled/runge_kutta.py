"""Trajectories and their sensitivities by the classical Runge-Kutta method, compiled.

A right-hand side and the outputs come as generated functions of flat arrays (`FlatEquations`). One
parameter row after the other would leave the processor's vector units idle: the values of several
rows go side by side, in `LANES` of them; of sensitivities, which are asked for one row, the
parameters do. A row is the same bits in any batch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable

import miho.compiled.polynomials  # noqa: F401 -- registers the elementary functions
from miho.compiled.course import LANES, Course, FlatEquations
from miho.compiled.signature import Signed, signed_formulas, signing
from miho.quantities import Array


@dataclass(frozen=True)
class Trajectories:
    """`solve(thetas (n, d), course, out (n, R))` and `derive(theta (d,), course, out (R, d))`."""

    solve: Callable[[Array, Course, Array], None]
    derive: Callable[[Array, Course, Array], None]


def trajectories(equations: FlatEquations, states: int, outputs: int) -> Trajectories:
    """The compiled solution of equations with so many states and outputs, cached on disk."""
    shape = states, outputs
    values = signed_formulas((equations.rates, equations.outputs), shape)
    varied = signed_formulas((equations.varied_rates, equations.varied_outputs), shape)
    return Trajectories(_compile_values(values, *shape), _compile_sensitivities(varied, *shape))


@register_jitable
def _between(course: Course, j: int, share: float, u: Array) -> None:
    """The inputs at a share of the way from row j to row j + 1."""
    for k in range(u.size):
        u[k] = course.u[j, k]
        if share > 0 and not course.held:
            u[k] += share * (course.u[j + 1, k] - course.u[j, k])


@cache
def _compile_values(formulas: Signed, S: int, K: int) -> Callable[[Array, Course, Array], None]:
    rates, outputs = map(register_jitable, formulas.copies())
    sign = signing(formulas.signature)

    @register_jitable
    @sign
    def begin(course: Course, m: int, lanes: int, p: Array, x: Array) -> None:
        for s in range(S):
            k = course.parameters[m, s]
            for i in range(lanes):
                x[s * LANES + i] = course.values[m, s] if k < 0 else p[k * LANES + i]

    @register_jitable
    @sign
    def advance(course: Course, j: int, lanes: int, p: Array, u: Array, work: Any) -> None:
        """From row j to row j + 1, in place."""
        x, at, after, dx = work
        h = (course.t[j + 1] - course.t[j]) / course.substeps
        for substep in range(course.substeps):
            for i in range(S * LANES):  # a length that the compiler knows, so unused lanes too
                at[i] = after[i] = x[i]
            for stage in range(4):
                ahead = ((stage + 1) // 2) / 2
                weight = h / 3 if stage in (1, 2) else h / 6
                if stage:
                    for i in range(S * LANES):
                        at[i] = x[i] + ahead * h * dx[i]
                _between(course, j, (substep + ahead) / course.substeps, u)
                rates(course.t[j] + (substep + ahead) * h, u, at, p, dx, lanes)
                for i in range(S * LANES):
                    after[i] += weight * dx[i]
            for i in range(S * LANES):
                x[i] = after[i]

    @njit(cache=True, nogil=True, error_model="numpy")
    @sign
    def solve(thetas: Array, course: Course, out: Array) -> None:
        u, p = np.empty(course.u.shape[1]), np.empty(thetas.shape[1] * LANES)
        x, y = np.zeros(S * LANES), np.empty(K * LANES)
        work = (x, np.zeros(S * LANES), np.zeros(S * LANES), np.zeros(S * LANES))
        for block in range(0, len(thetas), LANES):
            lanes = min(LANES, len(thetas) - block)
            for k in range(thetas.shape[1]):
                for i in range(lanes):
                    p[k * LANES + i] = thetas[block + i, k]
            for j in range(course.t.size):
                if j:
                    advance(course, j - 1, lanes, p, u, work)
                m = course.reset[j]
                if m >= 0 and (j == 0 or not course.restart):
                    begin(course, m, lanes, p, x)
                _between(course, j, 0.0, u)
                outputs(course.t[j], u, x, p, y, lanes)
                for r in range(course.first[j], course.first[j + 1]):
                    row = course.rows[r]
                    for i in range(lanes):
                        out[block + i, row] = y[course.output[row] * LANES + i]
                if m >= 0 and j and course.restart:
                    begin(course, m, lanes, p, x)

    return solve  # type: ignore[no-any-return]


@cache
def _compile_sensitivities(
    formulas: Signed, S: int, K: int
) -> Callable[[Array, Course, Array], None]:
    """x_p (S, d) is the derivative of the state with respect to the parameters.

    Each stage of each step is differentiated, so these are the derivatives of what is computed, to
    rounding, and not those of the motion that it approximates.
    """
    varied_rates, varied_outputs = map(register_jitable, formulas.copies())
    sign = signing(formulas.signature)

    @register_jitable
    @sign
    def begin(course: Course, m: int, p: Array, x: Array, x_p: Array) -> None:
        for s in range(S):
            start = course.parameters[m, s]
            x[s] = course.values[m, s] if start < 0 else p[start]
            for k in range(p.size):
                x_p[s, k] = 1.0 if k == start else 0.0

    @register_jitable
    @sign
    def advance(course: Course, j: int, p: Array, u: Array, work: Any) -> None:
        """From row j to row j + 1, in place."""
        x, at, after, dx, x_p, at_p, after_p, dx_p = work
        h = (course.t[j + 1] - course.t[j]) / course.substeps
        for substep in range(course.substeps):
            for s in range(S):
                at[s] = after[s] = x[s]
                for k in range(p.size):
                    at_p[s, k] = after_p[s, k] = x_p[s, k]
            for stage in range(4):
                ahead = ((stage + 1) // 2) / 2
                weight = h / 3 if stage in (1, 2) else h / 6
                if stage:
                    for s in range(S):
                        at[s] = x[s] + ahead * h * dx[s]
                        for k in range(p.size):
                            at_p[s, k] = x_p[s, k] + ahead * h * dx_p[s, k]
                _between(course, j, (substep + ahead) / course.substeps, u)
                varied_rates(course.t[j] + (substep + ahead) * h, u, at, p, at_p, dx, dx_p)
                for s in range(S):
                    after[s] += weight * dx[s]
                    for k in range(p.size):
                        after_p[s, k] += weight * dx_p[s, k]
            for s in range(S):
                x[s] = after[s]
                for k in range(p.size):
                    x_p[s, k] = after_p[s, k]

    @njit(cache=True, nogil=True, error_model="numpy")
    @sign
    def derive(p: Array, course: Course, out: Array) -> None:
        u, x, x_p = np.empty(course.u.shape[1]), np.empty(S), np.empty((S, p.size))
        y, y_p = np.empty(K), np.empty((K, p.size))
        work = (
            x, np.empty(S), np.empty(S), np.empty(S),
            x_p, np.empty(x_p.shape), np.empty(x_p.shape), np.empty(x_p.shape),
        )  # fmt: skip
        for j in range(course.t.size):
            if j:
                advance(course, j - 1, p, u, work)
            m = course.reset[j]
            if m >= 0 and (j == 0 or not course.restart):
                begin(course, m, p, x, x_p)
            _between(course, j, 0.0, u)
            varied_outputs(course.t[j], u, x, p, x_p, y, y_p)
            for r in range(course.first[j], course.first[j + 1]):
                row = course.rows[r]
                for k in range(p.size):
                    out[row, k] = y_p[course.output[row], k]
            if m >= 0 and j and course.restart:
                begin(course, m, p, x, x_p)

    return derive  # type: ignore[no-any-return]
