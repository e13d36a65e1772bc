"""Trajectories and their sensitivities by the classical Runge-Kutta method, compiled by numba.

This is what runs without the machine of `miho.core`, whose trajectories take the same steps.

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


def trajectories(equations: FlatEquations, states: int, outputs: int, d: int) -> Trajectories:
    """The compiled solution for so many states, outputs and parameters, cached on disk."""
    shape = states, outputs, d
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
def _compile_values(
    formulas: Signed, S: int, K: int, d: int
) -> Callable[[Array, Course, Array], None]:
    sign = signing(formulas.signature)

    @register_jitable
    @sign
    def begin(course: Course, m: int, lanes: int, p: Array, x: Array) -> None:
        for s in range(S):
            k = course.parameters[m, s]
            for i in range(lanes):
                x[s * LANES + i] = course.values[m, s] if k < 0 else p[k * LANES + i]

    simulate = _simulation(formulas, begin, S * LANES, K * LANES, (0, LANES))

    @njit(cache=True, nogil=True, error_model="numpy")
    @sign
    def solve(thetas: Array, course: Course, out: Array) -> None:
        p = np.empty(d * LANES)
        for block in range(0, len(thetas), LANES):
            lanes = min(LANES, len(thetas) - block)
            for k in range(d):
                for i in range(lanes):
                    p[k * LANES + i] = thetas[block + i, k]
            simulate(p, course, lanes, out[block : block + lanes])

    return solve  # type: ignore[no-any-return]


@cache
def _compile_sensitivities(
    formulas: Signed, S: int, K: int, d: int
) -> Callable[[Array, Course, Array], None]:
    """Behind the state x (S,) stand its derivatives with respect to the parameters, (S, d).

    Each stage of each step is differentiated, so these are the derivatives of what is computed, to
    rounding, and not those of the motion that it approximates.
    """
    sign = signing(formulas.signature)

    @register_jitable
    @sign
    def begin(course: Course, m: int, _: int, p: Array, x: Array) -> None:
        for s in range(S):
            start = course.parameters[m, s]
            x[s] = course.values[m, s] if start < 0 else p[start]
            for k in range(d):
                x[S + s * d + k] = 1.0 if k == start else 0.0

    simulate = _simulation(formulas, begin, S + S * d, K + K * d, (K, d))

    @njit(cache=True, nogil=True, error_model="numpy")
    @sign
    def derive(theta: Array, course: Course, out: Array) -> None:
        simulate(theta, course, d, out.T)

    return derive  # type: ignore[no-any-return]


def _simulation(
    formulas: Signed, begin: Any, size: int, results: int, place: tuple[int, int]
) -> Callable[[Array, Course, int, Array], None]:
    """The motion of `size` numbers by Runge-Kutta steps, `results` of which are asked for at a row.

    Those of output k stand from place[0] + k place[1] on.
    """
    rates, outputs = map(register_jitable, formulas.copies())
    sign, (first, apart) = signing(formulas.signature), place

    @register_jitable
    @sign
    def advance(course: Course, j: int, columns: int, p: Array, u: Array, work: Any) -> None:
        """From row j to row j + 1, in place."""
        x, at, after, dx = work
        h = (course.t[j + 1] - course.t[j]) / course.substeps
        for substep in range(course.substeps):
            for i in range(size):  # a length that the compiler knows, so unused columns too
                at[i] = after[i] = x[i]
            for stage in range(4):  # at 0, 1/2, 1/2 and 1 of the step
                ahead = ((stage + 1) // 2) / 2
                weight = h / 3 if stage in (1, 2) else h / 6
                if stage:
                    for i in range(size):
                        at[i] = x[i] + ahead * h * dx[i]
                _between(course, j, (substep + ahead) / course.substeps, u)
                rates(course.t[j] + (substep + ahead) * h, u, at, p, dx, columns)
                for i in range(size):
                    after[i] += weight * dx[i]
            for i in range(size):
                x[i] = after[i]

    @register_jitable
    @sign
    def simulate(p: Array, course: Course, columns: int, out: Array) -> None:
        """Write out (columns, R) of parameter rows side by side, or of one row's derivatives."""
        u, x, y = np.empty(course.u.shape[1]), np.zeros(size), np.empty(results)
        work = (x, np.zeros(size), np.zeros(size), np.zeros(size))
        for j in range(course.t.size):
            if j:
                advance(course, j - 1, columns, p, u, work)
            m = course.reset[j]
            # Segments begin before their first row is written; a restart follows the row, which is
            # still predicted.
            if m >= 0 and (j == 0 or not course.restart):
                begin(course, m, columns, p, x)
            _between(course, j, 0.0, u)
            outputs(course.t[j], u, x, p, y, columns)
            for r in range(course.first[j], course.first[j + 1]):
                row = course.rows[r]
                for i in range(columns):
                    out[i, row] = y[first + course.output[row] * apart + i]
            if m >= 0 and j and course.restart:
                begin(course, m, columns, p, x)

    return simulate  # type: ignore[no-any-return]
