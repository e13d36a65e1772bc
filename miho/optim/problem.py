"""What is minimised: a loss over a space."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miho.compiled import Kernel
from miho.optim.space import Space
from miho.parallel import Evaluations
from miho.quantities import Array


class Problem(ABC):
    """A loss over a box of parameters; the loss of a row depends on that row alone.

    `name` identifies the problem in seeds, stores and figures: two problems with one name are the
    same problem. `kernel` holds fast forms of this very loss, for methods that know what to do
    with them. A loss up to `rounding` counts as 0: its digits are rounding. Losses that differ by
    less than `resolution` count as equal: a method that sees only losses may end so far above a
    minimum whose loss is 0. A loss above `noise` is more than the noise of the data explains, as
    far as the problem can tell: the model is wrong, or a better optimum exists. So it is where the
    residuals of rows have structure along `row_inputs`, (N,) each, that noise has not; without any,
    nobody looks. `rows` is the number of rows of data, where a fidelity of m / rows takes the first
    m of them in the problem's own order; it is None for a problem that has no cheaper versions of
    itself. `called_as` says how functions of the user's are called, for one that has to find it
    out.
    """

    name: str
    space: Space
    kernel: Kernel | None = None
    rounding: float = 0.0
    resolution: float = 0.0
    noise: float = math.inf
    row_inputs: Sequence[Array] = ()
    rows: int | None = None
    called_as: Sequence[Any] = ()

    @abstractmethod
    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,) of parameter rows (n, d) in units; a row's loss is the same in any batch.

        `fidelity` in (0, 1] is the fraction of the data that may be used; a problem without
        cheaper versions of itself ignores it.
        """

    @property
    def description(self) -> str:
        """What tells this problem from others whose evaluations must not be mixed with its own."""
        return f"{self.name}: {', '.join(self.space.names)}"

    def spread(self, evaluations: Evaluations) -> Problem:
        """This problem with its evaluations made by these; itself if it is never dear."""
        from miho.optim.spread import spread  # which knows what a problem is

        return self if self.kernel is not None else spread(self, evaluations)

    def cost(self, fidelity: float) -> float:
        """What one evaluation at a fidelity costs, in full evaluations; at 1 it is a full one.

        To be overridden by a problem that uses another fraction of its data than the fidelity.
        """
        return fidelity


class LeastSquaresProblem(Problem):
    """A problem whose loss is the mean of squared residuals, with derivatives of the residuals.

    Their number is `rows`, if the residuals of the first rows can be computed alone: a fidelity
    takes so many of them in the problem's own order. If `rows` is None, all are computed always.
    `order` (N,) gives the positions of the rows of all residuals in that order, None if they stand
    in it already.

    `jacobian_cost` is what one Jacobian costs in evaluations; if None, the number of parameters, as
    by forward differences. `linear` names parameters in which the residuals are jointly linear:
    with all others fixed, they are an offset plus a fixed combination of these. So a (x + b) is
    linear in a or in b, but not in both.
    """

    jacobian_cost: int | None = None
    linear: tuple[str, ...] = ()
    order: NDArray[np.intp] | None = None

    @abstractmethod
    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Model minus data, (m,), of one configuration (d,), over a fidelity of the rows."""

    def residual_rows(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Residuals (n, m) of several configurations (n, d), over a fidelity of the rows.

        For problems that are faster with several at once; others leave this, and `residuals` is
        called for each.
        """
        raise NotImplementedError

    @abstractmethod
    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals, (m, d), at one configuration (d,)."""


def mean_square(residuals: Array) -> Array:
    """Mean square over the last axis (Eq. 1), bit for bit the same for one row as in a batch."""
    squares = np.einsum("...i,...i->...", residuals, residuals)
    return np.asarray(squares / residuals.shape[-1])
