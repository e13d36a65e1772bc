"""What the machine of formulas can do for a problem, as its users see it."""

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
"""(inputs, theta) -> value: element by element, with the operators and NumPy's functions of
numbers."""


NAN, INFINITE = "loss is nan", "loss is inf"
"""Reasons for rejecting losses that were computed, but are not finite."""


class Block(NamedTuple):
    """What a block of evaluations did: the evaluations it spent, and its improvements.

    Improvement k came with evaluation `at[k]` of the block, at `thetas[k]` (d,) with `losses[k]`.
    `rejected` counts values that could not be used, by reason. `finished` unless it stopped before
    an evaluation that it was not allowed. `provisional`, for a run that has looked at nothing on
    all rows of data yet, are the arguments of `Meter.note`: the cost of a look, losses, thetas.
    """

    evaluations: float
    at: Array
    losses: Array
    thetas: Array
    rejected: Mapping[str, int]
    finished: bool = True
    provisional: tuple[float, Array, Array] | None = None


class Steps(NamedTuple):
    """Steps of mutation and acceptance: evaluate mutants of all rows of P, keep the better ones.

    P (n, d) and L (n,) are changed in place. The mutants of the first step are `first` (n, d),
    those of step k are P + sigma[k - 1] noise[k - 1] within the bounds, with noise (steps - 1, n,
    d) and sigma (steps - 1, d): bit for bit what `mutate` gives. With `early_stopping` a mutant is
    given up as soon as it cannot be better than its parent, which changes no decision.
    """

    first: Array
    P: Array
    L: Array
    noise: Array
    sigma: Array
    bounds: tuple[Array, Array]
    early_stopping: bool = True


Climb = Callable[[Steps, float, float], Block]
"""(steps, best, target) -> what they did, with their improvements of `best`; ends after the step
that reaches `target`. Each step counts one evaluation for each row, stopped early or not."""


class Rows(NamedTuple):
    """Residuals and derivatives of the rows of the data, which the machine can call.

    `calls` (4,) are addresses of two functions, of residuals and of derivatives, and of the tape
    that each is given; what is there is `kept`, and has to live as long. X (p, N) and y (N,) hold
    the data in the order of a fidelity.
    """

    calls: Integers
    X: Array
    y: Array
    kept: Any


class Kernel(Protocol):
    """Fast forms of a problem's loss, each None where there is none."""

    @property
    def climb(self) -> Climb | None:
        """Steps of mutation and acceptance, in units."""

    @property
    def rows(self) -> Rows | None:
        """Residuals and derivatives."""


class Formulas(Protocol):
    """What the machine needs of a model; `miho.models.expression.Expression` documents it."""

    @property
    def parameters(self) -> Mapping[str, str]:
        """Units by name, in the order of theta."""

    @property
    def value(self) -> Formula:
        """The formula of the output."""

    @property
    def derivatives(self) -> Formula:
        """The formula of its derivatives with respect to theta, a tuple."""

    @property
    def tapes(self) -> tuple[Tape, Tape] | None:
        """The formulas of the output and of its derivatives as tapes, None without."""

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) by NumPy."""

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Their derivatives (N, d) by NumPy."""


def kernel_for(taped: TapedLoss, model: Formulas, thetas: Array, *, name: str) -> FitKernel:
    """Fast forms of the mean square of a model minus data, checked against NumPy's.

    They are checked at `thetas` (n, d), at their first use; `name` is the model's in a warning.
    """
    from miho.compiled.fit import FitKernel

    return FitKernel(taped, model, thetas, name)


def taped_loss(
    model: Formulas,
    X: Array,
    y: Array,
    order: NDArray[np.intp] | Callable[[], NDArray[np.intp]],
    *,
    threads: int = 1,
) -> TapedLoss | None:
    """The mean square of a model minus data by the machine, None where it cannot run the model.

    X (p, N) holds the input columns, y (N,) the output, `order` (N,) the order in which a loss goes
    through them, or a function that returns it.
    """
    tapes = None if machine() is None else model.tapes
    if tapes is None:
        return None
    from miho.compiled.taped import TapedLoss

    return TapedLoss(*tapes, np.ascontiguousarray(X), y, order, threads)
