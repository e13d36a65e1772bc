"""Problems: a loss over a space, and the least-squares special case."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from miho.optim.space import Space
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.compiled import Kernel
    from miho.parallel import Evaluations


class Problem(ABC):
    """Abstract base class of a loss over a box of parameters.

    Subclasses implement `loss`, and set `name` and `space`; `miho.minimize` has an example. The
    loss of a configuration must not depend on the other configurations of a batch.

    Attributes
    ----------
    name : str
        Identifies the problem in seeds, stores and figures. Two problems with one name count as the
        same problem.
    space : Space
        The parameters and their bounds.
    kernel : Kernel, optional
        Fast forms of the loss, for methods that can use them.
    rounding : float
        Largest loss that is rounding and counts as 0.
    resolution : float
        Difference below which two losses count as equal. A method that sees only losses may end
        this far above a minimum of loss 0.
    noise : float
        Upper estimate of the loss that the noise of the data explains. A larger loss means a wrong
        model, or that a better optimum exists.
    row_inputs : sequence of ndarray
        Input columns, (N,) each. Methods look for structure in the residuals along them; noise has
        none. Without inputs there is no such test.
    row_parts : ndarray, optional
        Number of each row's part in a joint problem, (N,). Each part is also tested alone.
    rows : int, optional
        Number of rows of the data, if a fidelity of m / rows uses the first m rows in the order of
        the problem. None for a problem without cheaper approximations.
    called_as : sequence
        How the user's functions are called, for a problem that had to find out.
    """

    name: str
    space: Space
    if TYPE_CHECKING:  # read-only, so that a subclass may declare or compute them

        @property
        def kernel(self) -> Kernel | None: ...
        @property
        def rounding(self) -> float: ...
        @property
        def resolution(self) -> float: ...
        @property
        def noise(self) -> float: ...
        @property
        def row_inputs(self) -> Sequence[Array]: ...
        @property
        def row_parts(self) -> Array | None: ...
        @property
        def rows(self) -> int | None: ...
        @property
        def called_as(self) -> Sequence[Any]: ...
    else:
        kernel = rows = row_parts = None
        rounding, resolution, noise = 0.0, 0.0, math.inf
        row_inputs = called_as = ()

    @abstractmethod
    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Return the loss of each configuration.

        Parameters
        ----------
        thetas : ndarray of shape (n, d)
            Configurations in the units of the space.
        fidelity : float, optional
            Fraction of the data to use, in (0, 1]. Problems without cheaper approximations ignore
            it.

        Returns
        -------
        ndarray of shape (n,)
            Losses; the loss of a row is the same in any batch.
        """

    @property
    def description(self) -> str:
        """Text that identifies the problem in an evaluation log, so that problems do not mix."""
        return f"{self.name}: {', '.join(self.space.names)}"

    def spread(self, evaluations: Evaluations) -> Problem:
        """This problem with its evaluations on workers; itself if it is never expensive."""
        from miho.optim.spread import spread  # imports this module

        return self if self.kernel is not None else spread(self, evaluations)

    def cost(self, fidelity: float) -> float:
        """Cost of one evaluation at a fidelity, in full evaluations; 1 at fidelity 1.

        Override it if the problem uses another fraction of its data than the fidelity.
        """
        return fidelity

    def angles(self, thetas: Array) -> Array:
        """Ends of the range of each angle over the rows at thetas (n, d), in periods, (k, 2, n)."""
        return np.empty((0, 2, len(thetas)))


class LeastSquaresProblem(Problem):
    """Abstract base class of a problem whose loss is the mean square of residuals (Eq. 1).

    Subclasses implement `loss`, `residuals` and `jacobian`; `miho.MIHOGN` has an example. With
    `rows`, the residuals of the first m rows can be computed alone, and a fidelity uses the first
    rows in the order of the problem. If `rows` is None, every evaluation computes all residuals.

    Attributes
    ----------
    jacobian_cost : int, optional
        Cost of one Jacobian in evaluations; by default the number of parameters, as for forward
        differences.
    linear : tuple of str
        Parameters in which the residuals are jointly linear: with all others fixed, residuals are a
        constant plus a linear combination of them. For example, a (x + b) is linear in a or in b,
        but not in both.
    order : ndarray of shape (N,), optional
        Positions of the rows of all residuals in the order of the problem; None if they are in this
        order.
    """

    if TYPE_CHECKING:

        @property
        def jacobian_cost(self) -> int | None: ...
        @property
        def linear(self) -> tuple[str, ...]: ...
        @property
        def order(self) -> NDArray[np.intp] | None: ...
    else:
        jacobian_cost, linear, order = None, (), None

    @abstractmethod
    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Residuals (m,), model minus data, at one configuration (d,), of a share of the rows."""

    def residual_rows(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Residuals (n, m) at several configurations (n, d), of a share `fidelity` of the rows.

        Implement it if several configurations at once are faster; otherwise MIHO calls `residuals`
        for each of them.
        """
        raise NotImplementedError

    @abstractmethod
    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals, (m, d), at one configuration (d,)."""


def least_squares(problem: Problem) -> LeastSquaresProblem:
    """The problem; raises TypeError if it has no residuals."""
    if not isinstance(problem, LeastSquaresProblem):
        raise TypeError(
            f"problem {problem.name} has no residuals; choose a method that needs "
            "only losses (optimizer=miho_qn), or make it a LeastSquaresProblem"
        )
    return problem


class Traits:
    """Properties of a problem that methods may use, `Oracle.traits`.

    `linear`, `order` and `jacobian_cost` raise TypeError if the problem has no residuals.

    Parameters
    ----------
    problem : Problem
        The problem.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem

    @property
    def rows(self) -> int | None:
        """Number of rows of data if a fidelity uses the first of them, else None."""
        return self._problem.rows

    @property
    def kernel(self) -> Kernel | None:
        """Fast forms of the problem's loss, for blocks of evaluations (`Oracle.spend`)."""
        return self._problem.kernel

    @property
    def linear(self) -> tuple[str, ...]:
        """Parameters in which the residuals are jointly linear, as declared by the problem."""
        return least_squares(self._problem).linear

    @property
    def order(self) -> NDArray[np.intp] | None:
        """Positions of all residuals in the order of a fidelity, None if they are in this order."""
        return least_squares(self._problem).order

    @property
    def jacobian_cost(self) -> int:
        """Cost of the derivatives of the residuals, in evaluations of the same rows."""
        cost = least_squares(self._problem).jacobian_cost
        return len(self._problem.space) if cost is None else cost

    @property
    def rounding(self) -> float:
        """Largest loss that is rounding and counts as 0."""
        return self._problem.rounding

    @cached_property
    def resolution(self) -> float:
        """Difference up to which two losses count as equal."""
        return max(self._problem.rounding, self._problem.resolution)

    @property
    def noise(self) -> float:
        """Upper estimate of the loss that the noise of the data explains."""
        return self._problem.noise

    @property
    def row_inputs(self) -> Sequence[Array]:
        """Input columns, along which the residuals of noise have no structure."""
        return self._problem.row_inputs

    @property
    def row_parts(self) -> Array | None:
        """Number of the part of each row, None without parts."""
        return self._problem.row_parts

    def cost(self, fidelity: float) -> float:
        """Cost of one evaluation at a fidelity, in full evaluations."""
        return self._problem.cost(fidelity)

    def angles(self, thetas: Array) -> Array:
        """Ends of the range of each angle over the rows at thetas (n, d), in periods, (k, 2, n).

        The k angles are of a formula's sines, cosines and tangents that follow an input.
        """
        return self._problem.angles(thetas)


def part_of(fidelity: float) -> tuple[float, ...]:
    """Arguments for a fidelity; none for all rows, as a problem need not have that argument."""
    return () if fidelity == 1.0 else (fidelity,)


def mean_square(residuals: Array) -> Array:
    """Mean square over the last axis (Eq. 1); a row has the same bits alone as in a batch."""
    residuals = np.ascontiguousarray(residuals)  # the order in memory would change the sum
    squares = np.einsum("...i,...i->...", residuals, residuals)
    return np.asarray(squares / residuals.shape[-1])
