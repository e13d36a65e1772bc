"""What is minimised: a loss over a space."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from miho.compiled import Kernel
from miho.optim.space import Space
from miho.quantities import Array


class Problem(ABC):
    """A loss over a box of parameters; the loss of a row depends on that row alone.

    `name` identifies the problem in seeds, stores and figures: two problems with one name are the
    same problem. `kernel` holds compiled forms of this very loss, for methods that know what to do
    with them. A loss up to `rounding` is 0: its digits are rounding. Losses closer than
    `resolution` are not told apart: whoever sees only losses ends so far above a minimum at 0. A
    loss above `noise` is more than the noise of the data explains, as far as a problem can tell:
    its model is another one than that of the data, or a better optimum exists. `rows` is the number
    of rows of data, and says that a fidelity of m / rows takes the first m of them, in the
    problem's own order; a problem without it has no cheaper versions of itself.
    """

    name: str
    space: Space
    kernel: Kernel | None = None
    rounding: float = 0.0
    resolution: float = 0.0
    noise: float = math.inf
    rows: int | None = None

    @abstractmethod
    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,) of parameter rows (n, d) in units; a row's loss is the same in any batch.

        `fidelity` in (0, 1] is the fraction of the data that may be used; a problem without
        cheaper versions of itself ignores it.
        """

    def cost(self, fidelity: float) -> float:
        """What one evaluation at a fidelity costs, in full evaluations; 1 means it is one.

        A problem that does not use just this fraction of its data says what it uses.
        """
        return fidelity


class LeastSquaresProblem(Problem):
    """A problem whose loss is the mean of squared residuals, with derivatives of the residuals.

    Their number is `rows`, if those of the first rows can be had: a fidelity takes so many of them
    in the problem's own order. A problem without it is asked for all of them only. `order` numbers
    the rows of all residuals in that order, None if they stand in it.

    `jacobian_cost` is what one Jacobian costs in evaluations; a problem without it pays the
    number of parameters, as forward differences would. `linear` names parameters in which the
    residuals are jointly linear: with all others held, they are an offset plus a fixed
    combination of these, a (x + b) thus in a or in b but not in both.
    """

    jacobian_cost: int | None = None
    linear: tuple[str, ...] = ()
    order: NDArray[np.intp] | None = None

    @abstractmethod
    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Model minus data, (m,), of one configuration (d,), over a fidelity of the rows."""

    def residual_rows(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Those of each of some configurations (n, d), (n, m).

        For problems that are quicker with several at once; others are asked one at a time.
        """
        raise NotImplementedError

    @abstractmethod
    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals, (m, d), at one configuration (d,)."""


def mean_square(residuals: Array) -> Array:
    """Mean square over the last axis (Eq. 1), bit for bit the same for one row as in a batch."""
    squares = np.einsum("...i,...i->...", residuals, residuals)
    return np.asarray(squares / residuals.shape[-1])
