"""Variable projection: least squares that solves for the linear parameters in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.methods.descent import descend
from miho.methods.least_squares import LeastSquares, SolverStarts
from miho.optim import Oracle, Space
from miho.optim.linear_part import LinearPart, solve_linear_part
from miho.quantities import Array


@dataclass(frozen=True)
class VariableProjection(SolverStarts):
    """Multistart least squares over the nonlinear parameters only (Golub and Pereyra, 1973).

    At every evaluation the linear parameters have their best values in the box. Derivatives are
    Kaufman's (1975), which give the exact gradient; linear parameters with an active bound are
    fixed. Starting points, rounds and solvers are as in `LeastSquares`. If the problem is linear in
    all parameters, the method is one linear solve without screening. If it is linear in none, for
    example with a robust loss, the method is `LeastSquares`.

    With p linear parameters of d, an evaluation costs p + 2 evaluations of the model, and its
    derivatives cost d. Requires a least-squares problem.

    Parameters
    ----------
    screen, starts, rounds, tolerance, method
        See `LeastSquares`.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Screen and solve, `rounds` times."""
        space = oracle.space
        if not oracle.traits.linear:
            settings = self.screen, self.starts, self.rounds, self.tolerance, self.method
            LeastSquares(*settings).run(oracle, rng)
            return
        linear = [space.names.index(name) for name in oracle.traits.linear]
        nonlinear = [k for k in range(len(space)) if k not in linear]
        if not nonlinear:
            start = space.decode(space.initial(1))[0]
            part = solve_linear_part(oracle.residuals, start, linear, space)
            if part is not None:
                oracle.residuals(part.theta)
            return
        subspace = Space(tuple(space.parameters[k] for k in nonlinear))

        def solve(theta: Array) -> bool:
            reduced = _Reduced(oracle, linear, nonlinear, theta)
            start = theta[nonlinear]
            look, slopes = reduced.residuals, reduced.jacobian
            return descend(look, slopes, start, subspace, self.tolerance, self.method)

        self.descend_from_best(oracle, rng, solve)


class _Reduced:
    """The residuals as a function of the nonlinear parameters alone."""

    def __init__(
        self, oracle: Oracle, linear: list[int], nonlinear: list[int], theta: Array
    ) -> None:
        self._oracle = oracle
        self._linear = linear
        self._nonlinear = nonlinear
        self._theta = theta.copy()
        self._part: LinearPart | None = None
        self._rows = 1

    def residuals(self, nonlinear: Array) -> Array:
        """Residuals (m,) of the reduced problem, with the best linear parameters for `nonlinear`.

        Infinite if the linear parameters cannot be solved for, so that the solver steps back.
        """
        self._theta[self._nonlinear] = nonlinear
        oracle = self._oracle
        self._part = solve_linear_part(oracle.residuals, self._theta, self._linear, oracle.space)
        if self._part is None:
            return np.full(self._rows, np.inf)
        self._theta = self._part.theta
        self._rows = self._part.basis.shape[0]
        return self._part.residuals

    def jacobian(self, nonlinear: Array) -> Array:
        """Kaufman's derivatives (m, d - p): the part orthogonal to the basis of the linear part."""
        if not np.array_equal(self._theta[self._nonlinear], nonlinear):
            self.residuals(nonlinear)
        if self._part is None:
            raise ValueError("no derivatives where the linear parameters cannot be solved for")
        jacobian = self._oracle.jacobian(self._theta)
        return self._part.outside(jacobian[:, self._nonlinear])
