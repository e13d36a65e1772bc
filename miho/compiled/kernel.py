"""Interface of the machine of formulas for problems and methods."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from miho.core import Tape, machine
from miho.quantities import Array, Integers

if TYPE_CHECKING:
    from miho.compiled.fit import FitKernel
    from miho.compiled.taped import TapedLoss


Formula = Callable[[tuple[Any, ...], tuple[Any, ...]], Any]
"""(inputs, theta) -> value: element by element, with operators and NumPy's functions of numbers."""


NAN, INFINITE = "loss is nan", "loss is inf"
"""Reasons for rejecting losses that were computed, but are not finite."""


class Block(NamedTuple):
    """Result of a block of evaluations: their number and the improvements.

    Attributes
    ----------
    evaluations : float
        Evaluations made.
    at, losses, thetas : ndarray of shape (k,), (k,) and (k, d)
        Evaluation within the block, loss and configuration of each improvement.
    rejected : mapping of str to int
        Unusable values by reason.
    finished : bool
        False if the next evaluation was not allowed.
    provisional : tuple, optional
        Arguments of `Meter.note` (cost, losses, thetas), for a run without an evaluation on all
        rows.
    """

    evaluations: float
    at: Array
    losses: Array
    thetas: Array
    rejected: Mapping[str, int]
    finished: bool = True
    provisional: tuple[float, Array, Array] | None = None


class Steps(NamedTuple):
    """Mutation steps: evaluate mutants of all rows of P, and keep the better of each pair.

    P (n, d) and L (n,) are changed in place. The mutants of the first step are `first` (n, d), of
    step k they are P + sigma[k - 1] noise[k - 1] within the bounds, with noise (steps - 1, n, d)
    and sigma (steps - 1, d), to the same bits as `mutate`. With `early_stopping` the loss of a
    mutant stops as soon as it cannot be better than its parent, which changes no decision.
    """

    first: Array
    P: Array
    L: Array
    noise: Array
    sigma: Array
    bounds: tuple[Array, Array]
    early_stopping: bool = True


Climb = Callable[[Steps, float, float], Block]
"""(steps, best, target) -> block with the improvements of `best`; ends after the step that reaches
`target`. Each step counts as one evaluation for each row, stopped early or not."""


class Rows(NamedTuple):
    """Residuals and derivatives of the rows of the data, for the machine.

    `calls` (4,) are the addresses of two functions, for residuals and derivatives, and of the tapes
    that they receive; `tapes` owns these and must live as long. X (p, N) and y (N,) are the data
    in the order of a fidelity.
    """

    calls: Integers
    X: Array
    y: Array
    tapes: Any


class Kernel(Protocol):
    """Fast forms of a problem's loss, each None if unavailable."""

    @property
    def climb(self) -> Climb | None:
        """Mutation steps, in units."""

    @property
    def rows(self) -> Rows | None:
        """Residuals and derivatives."""


class Formulas(Protocol):
    """Interface of a model for the machine; see `miho.models.expression.Expression`."""

    @property
    def parameters(self) -> Mapping[str, str]:
        """Units by name, in the order of theta."""

    @property
    def value(self) -> Formula:
        """Formula of the output."""

    @property
    def derivatives(self) -> Formula:
        """Formula of its derivatives with respect to theta, a tuple."""

    @property
    def tapes(self) -> tuple[Tape, Tape] | None:
        """Formulas of the output and its derivatives as tapes, None without them."""

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) by NumPy."""

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives (N, d) by NumPy."""


def kernel_for(taped: TapedLoss, model: Formulas, thetas: Array, *, name: str) -> FitKernel:
    """Fast forms of the mean square of a model minus data, compared with NumPy.

    The comparison takes place at `thetas` (n, d), at the first use; `name` identifies the model in
    a warning.
    """
    from miho.compiled.fit import FitKernel

    return FitKernel(taped, model, thetas, name)


def taped_loss(
    model: Formulas, X: Array, y: Array, order: NDArray[np.intp] | Callable[[], NDArray[np.intp]]
) -> TapedLoss | None:
    """Mean square of a model minus data on the machine, None if it cannot run the model.

    X (p, N) has the input columns, y (N,) the output. `order` (N,), or a function that returns it,
    is the order of the rows in a loss.
    """
    tapes = None if machine() is None else model.tapes
    if tapes is None:
        return None
    from miho.compiled.taped import TapedLoss

    return TapedLoss(*tapes, np.ascontiguousarray(X), y, order)
