"""The identification problem: a model, a dataset and a space (Eq. 1, 5, 9)."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import InitVar, dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from miho.compiled import kernel_for, taped_loss
from miho.data.dataset import Dataset
from miho.identification.curve_fit_checks import (
    TRIALS,
    check_curve_fit,
    examined,
    with_defaults,
)
from miho.identification.loss import Loss, Square
from miho.identification.row_order import row_order
from miho.models.expression import Expression
from miho.models.function_model import FunctionModel
from miho.models.model import Model, expensive_leaves
from miho.models.traced import Remade, TracedExpression, is_formula
from miho.optim.problem import LeastSquaresProblem, mean_square
from miho.optim.seeds import stream
from miho.optim.space import Parameter, Space
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.compiled.fit import FitKernel
    from miho.compiled.kernel import Rows
    from miho.compiled.taped import TapedLoss
    from miho.identification.prior import PriorResiduals
    from miho.identification.residual_formula import ResidualFormula
    from miho.parallel import Evaluations

FRACTION = 1e-12
"""Tolerance for the rounding of a fidelity: m / N means m rows."""
EPSILON = float(np.finfo(float).eps)
ROUNDING = 100.0
"""An error of this number of EPSILON of the output is rounding (both as root mean squares). The
residual of a row is rounded by some EPSILON of the output, r, which changes a loss L by up to 2 r
sqrt(L). This never exceeds AGREEING L + (ROUNDING r)^2, within which two losses count as equal: 100
is 1 / sqrt(AGREEING) (`miho.optim.evidence`)."""
REMEMBERED = 1 << 20
"""Errors to remember, as numbers, for the derivatives of a robust loss at the same
configurations."""
OF_THE_MODEL = (
    "noise", "_fitted", "_taped", "_formula", "_residual_formula", "_taped_residuals", "_of_thread",
)  # fmt: skip
"""Cached attributes that depend on the form of the model."""
BLOCK = 50_000
"""Model values per block; the temporaries of one block stay in the cache of one core."""


@dataclass(frozen=True, eq=False)
class CurveFit(Remade, LeastSquaresProblem):
    """A least-squares problem: the mean squared difference of model and data (Eq. 5).

    The loss has the squared unit of the output. Residuals are weighted by `scale` / sigma, so that
    residuals, errors and loss keep the unit of the output. With a robust `rho`, `residuals` and
    `jacobian` refer to the transformed residuals, whose mean square is the loss; `errors` are the
    weighted differences themselves.

    Parameters
    ----------
    model : Model or callable
        The model. A function has the annotations of `miho.models.FunctionModel`; if it consists of
        arithmetic and NumPy's functions of numbers, it gets exact derivatives.
    dataset : Dataset
        The data, with the model's inputs and output as columns of the same units.
    space : Space
        The model's parameters in the model's order, in the same units. If it fixes or ties some of
        them, `model` and `space` become the model and the space of the free parameters
        (`miho.models.tied`).
    rho : Loss, optional
        Loss of one residual: its square (Eq. 5), or a robust loss.
    label : str, optional
        Name of the problem. The same data in two spaces are two problems and need two labels.
    threads : int, optional
        Threads for batches of the square loss of a model that is an `Expression`.
    compiled : bool, optional
        Whether the virtual machine of `miho.core` searches with models that are expressions. Other
        models, and all models if the machine was not built, are evaluated with NumPy.
    sigma : float or str, optional
        Standard deviation of the errors, in the unit of the output: a number or a column of the
        data.
    sigma_known : bool, optional
        Whether `sigma` is absolute; if false, it is known up to a common factor, which the
        residuals estimate.
    prior_scale : float, optional
        Estimate of sigma that weighs the priors, in place of `scale`, if sigma is unknown.
    tied_priors : tuple of Parameter
        Tied parameters with a prior; set from `space`.
    expensive : bool, optional
        Whether the model is known to be expensive; it is then not evaluated to check it.

    Raises
    ------
    ValueError
        If model, data and space do not fit together.

    Examples
    --------
    >>> import numpy as np
    >>> import miho
    >>> t = np.linspace(0, 2, 5)
    >>> data = miho.Dataset("decay", {"t": t, "y": np.exp(-t)}, {"t": "s", "y": "V"}, "y")
    >>> def decay(t: "s", *, a: "V", b: "1/s") -> "V":
    ...     return a * np.exp(-b * t)
    >>> space = miho.Space((miho.Parameter("a", "V", 0, 5), miho.Parameter("b", "1/s", 0, 10)))
    >>> problem = miho.CurveFit(decay, data, space)
    >>> problem.loss(np.array([[1.0, 1.0]]))
    array([0.])
    """

    model: Model
    dataset: Dataset
    space: Space
    rho: Loss = field(default_factory=Square)
    label: str | None = None
    threads: int = 1
    compiled: bool = True
    sigma: str | float | None = None
    sigma_known: bool = True
    prior_scale: float | None = None
    tied_priors: tuple[Parameter, ...] = ()
    expensive: InitVar[bool] = False

    def __post_init__(self, expensive: bool) -> None:
        model = _model(self.model)
        object.__setattr__(self, "space", with_defaults(self.space, model))
        if isinstance(model, FunctionModel):
            model = examined(model, self.dataset, self.space, expensive)
        if self.space.free is not self.space:
            from miho.identification.ties import ties_of
            from miho.models.tied import tie

            model = tie(model, ties_of(model, self.space))
            tied = tuple(p for p in self.space.parameters if p.tied and p.prior is not None)
            object.__setattr__(self, "tied_priors", tied)
        object.__setattr__(self, "model", model)
        object.__setattr__(self, "space", self.space.free)
        check_curve_fit(self, expensive)
        if self.sigma is not None or self.prior is not None:
            from miho.identification.sigma_checks import check_sigma

            check_sigma(self)

    @property
    def name(self) -> str:  # type: ignore[override]  # settable in other problems
        """The label; by default the names of model and dataset, once if they are the same."""
        if self.label is not None:
            return self.label
        names = self.model.name or type(self.model).__name__.lower(), self.dataset.name
        name = "-".join(dict.fromkeys(names))
        return name if self._square else f"{name}-{type(self.rho).__name__.lower()}"

    @property
    def _square(self) -> bool:
        return isinstance(self.rho, Square)

    @property
    def linear(self) -> tuple[str, ...]:
        """Parameters in which the residuals are jointly linear."""
        if not self._square:
            return ()
        bent = {p.name for p in self.space.parameters if p.prior and p.scale == "log"}
        if self.tied_priors and self.prior is not None:  # parameters that tied priors depend on
            from miho.models.symbolic import arguments_of

            places = arguments_of(self.prior.tied_graphs)
            bent |= {name for k, name in enumerate(self.space.names) if f"p{k}" in places}
        return tuple(name for name in self.model.linear if name not in bent)

    @property
    def unit(self) -> str:
        """Unit of the residuals."""
        return self.dataset.units[self.dataset.output]

    @cached_property
    def noise(self) -> float:
        """Upper estimate of the mean square of the noise, from the scatter of neighbouring points.

        Infinite if it is unknown, for example with priors or weights.
        """
        if not self._square or self.model.ordered:
            return math.inf
        if self.weights is not None or self.prior is not None:
            return math.inf  # the scatter of neighbouring rows differs, or priors add to the loss
        from miho.identification.irreducible import irreducible_square

        return irreducible_square(self.inputs, self._output)

    @property
    def row_inputs(self) -> tuple[Array, ...]:
        """Input columns along which noise has no structure; empty if errors of rows are not noise.

        This is the case for a system with memory, and for a robust loss.
        """
        return self.inputs if self._square and not self.model.ordered else ()

    @cached_property
    def rounding(self) -> float:
        """Largest loss that is rounding and counts as 0, in the output's unit squared."""
        return (ROUNDING * EPSILON) ** 2 * float(np.mean(self._output**2))

    @cached_property
    def resolution(self) -> float:
        """Difference below which two losses count as equal, in the output's unit squared.

        A fit that explains nothing has a loss as large as the variance of the output; at that size
        a difference below EPSILON of the variance is rounding.
        """
        return max(EPSILON * float(np.var(self._output)), self.rounding)

    @cached_property
    def inputs(self) -> tuple[Array, ...]:
        """The model's input columns, (N,) each."""
        return tuple(self.dataset[column] for column in self.model.inputs)

    @property
    def _output(self) -> Array:
        return self.dataset[self.dataset.output]

    @cached_property
    def scale(self) -> float | None:
        """Root of the harmonic mean of sigma squared, in the output's unit; None without sigma."""
        if self.sigma is None:
            return None
        sigma = self.dataset[self.sigma] if isinstance(self.sigma, str) else np.array([self.sigma])
        return float(1 / np.sqrt(np.mean(1 / sigma**2)))

    @cached_property
    def weights(self) -> Array | None:
        """Weights of the residuals, (N,), of mean square 1; None if all are equal."""
        if not isinstance(self.sigma, str) or self.scale is None:
            return None
        return np.asarray(self.scale / self.dataset[self.sigma])

    @cached_property
    def _fitted(self) -> Model:
        """The model of the weighted output `_target`, a function of `_columns`."""
        if self.weights is None:
            return self.model
        from miho.models.weighted import weighted

        return weighted(self.model)

    @cached_property
    def _columns(self) -> tuple[Array, ...]:
        return self.inputs if self.weights is None else (*self.inputs, self.weights)

    @cached_property
    def _target(self) -> Array:
        return self._output if self.weights is None else self._output * self.weights

    @cached_property
    def kernel(self) -> FitKernel | None:
        """Fast forms of the loss, None if the machine cannot run it."""
        formula = self._formula if self.compiled else None
        taped = None if formula is None else self._taped_residuals
        if formula is None or taped is None:
            return None
        thetas = self.space.decode(self.space.initial(TRIALS))
        name = self.model.name or type(self.model).__name__
        return kernel_for(taped, formula, thetas, name=name)

    @property
    def _plain(self) -> bool:
        """Whether the residuals are the errors."""
        return self._square and self.prior is None

    @cached_property
    def _formula(self) -> Expression | None:
        """Formula of the residuals plus a target, None if the model is no formula."""
        if self._plain:
            fitted = self._fitted
            return fitted if isinstance(fitted, Expression) and is_formula(fitted) else None
        return None if self._residual_formula is None else self._residual_formula.model

    @cached_property
    def _residual_formula(self) -> ResidualFormula | None:
        """All residuals as a formula, or None if the model is no formula."""
        from miho.identification.residual_formula import residual_formula

        return residual_formula(self._fitted, self._columns, self._target, self.rho, self.prior)

    @cached_property
    def _taped_residuals(self) -> TapedLoss | None:
        """All residuals on the machine, None if it cannot run them."""
        formula = None if self._plain else self._residual_formula
        if formula is None:
            return self._taped
        model, columns, target = formula

        def order() -> NDArray[np.intp]:
            return np.arange(target.size) if self._all_rows else self._order

        return taped_loss(model, np.array(columns), target, order, threads=self.threads)

    @cached_property
    def _taped(self) -> TapedLoss | None:
        """The model on the machine, None if the machine cannot run it."""
        if not isinstance(self._fitted, Expression):
            return None
        columns, target = np.array(self._columns), self._target
        return taped_loss(self._fitted, columns, target, lambda: self._order, threads=self.threads)

    @property
    def _of_graph(self) -> TapedLoss | None:
        """The model on the machine if it is a traced function; it needs no check against NumPy."""
        return self._taped if isinstance(self._fitted, TracedExpression) else None

    @property
    def machine_rows(self) -> Rows | None:
        """Residuals and their derivatives by the machine, None without it."""
        taped = self._taped_residuals if self.compiled else None
        return None if taped is None else taped.rows_of(taped.X, taped.y)

    @cached_property
    def prior(self) -> PriorResiduals | None:
        """Residuals of the parameters that have a prior, None if none has."""
        if not self.space.has_priors and not self.tied_priors:
            return None
        from miho.identification.prior import PriorResiduals

        scale = self.prior_scale or self.scale or 1.0
        return PriorResiduals(self.space, scale, self.tied_priors, self.model.ties)

    @property
    def residual_count(self) -> int:
        """Number of residuals: the rows of the data and the residuals of priors."""
        return len(self.dataset) + (0 if self.prior is None else len(self.prior.parameters))

    @property
    def _all_rows(self) -> bool:
        """Whether a loss needs every row, as for a model with memory, and with priors."""
        return self.model.ordered or self.prior is not None

    @cached_property
    def _order(self) -> NDArray[np.intp]:
        """Fixed order of the rows; a fidelity takes the first of them."""
        return row_order(self.inputs, stream("fidelity", self.dataset.digest))

    @property
    def order(self) -> NDArray[np.intp] | None:
        """Order in which a fidelity takes the rows, None if it takes all."""
        return None if self._all_rows else self._order

    def cost(self, fidelity: float) -> float:
        """Fraction of the rows that a fidelity uses; 1 if the model needs all rows."""
        return self._rows(fidelity) / len(self.dataset)

    @property
    def rows(self) -> int | None:
        """Number of rows of the data, None if a loss needs all of them."""
        return None if self._all_rows else len(self.dataset)

    def _rows(self, fidelity: float) -> int:
        N = len(self.dataset)
        return N if self._all_rows else min(N, math.ceil(fidelity * N * (1 - FRACTION)))

    def _part(self, fidelity: float) -> NDArray[np.intp] | None:
        """Rows that a fidelity uses, None for all."""
        rows = self._rows(fidelity)
        return None if rows == len(self.dataset) else self._order[:rows]

    @property
    def jacobian_cost(self) -> int | None:
        """Cost of the model's Jacobian, in evaluations."""
        return self.model.jacobian_cost

    @property
    def description(self) -> str:
        """Digests of all data and models that determine the model's outputs.

        Bounds, ties, sigma, priors and the loss may change without a change of the outputs.
        """
        from miho.models.leaves import description

        return description(self.model, (*self.inputs, self._output))

    @property
    def called_as(self) -> list[list[bool | None]]:
        """How trial calls have shown that the model's functions are to be called."""
        from miho.models.leaves import tried_calls

        return tried_calls(self.model)

    def called(self, calls: Sequence[Any]) -> CurveFit:
        """This problem with its functions called as in `called_as` of the same problem."""
        if not calls:
            return self
        from miho.models.leaves import called

        return self._with(called(self.model, calls))

    def spread(self, evaluations: Evaluations) -> CurveFit:
        """This problem with its model evaluated by workers; itself if the model is arithmetic."""
        from miho.models.leaves import spread

        return self._with(spread(self.model, evaluations, self.losses_of))

    def _with(self, model: Model) -> CurveFit:
        """This problem with another form of its model; itself if the model is arithmetic."""
        if not expensive_leaves(self.model):
            return self
        problem = object.__new__(CurveFit)  # all other attributes and caches stay valid
        known = {key: value for key, value in vars(self).items() if key not in OF_THE_MODEL}
        vars(problem).update(known, model=model)
        return problem

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Mean squared error of each configuration (Eq. 5).

        Parameters
        ----------
        thetas : ndarray of shape (n, d)
            Configurations, in the units of the space.
        fidelity : float, optional
            Fraction of the rows to use, in (0, 1].

        Returns
        -------
        ndarray of shape (n,)
            Losses, in the output's unit squared.
        """
        columns, output, rows = self._columns, self._target, self._rows(fidelity)
        if self._of_graph is not None and self._plain:
            return self._of_graph.losses(thetas, rows)
        if self.kernel is not None:
            losses = self.kernel.losses(thetas, None if self._all_rows else rows)
            if losses is not None:
                return losses
        if rows < output.size:
            part = self._order[:rows]
            columns, output = tuple(column[part] for column in columns), output[part]
        block = max(1, BLOCK // output.size)
        if len(thetas) <= block:
            return self._block_loss(thetas, columns, output)
        losses = np.empty(len(thetas))
        for start in range(0, len(thetas), block):
            batch = slice(start, start + block)
            losses[batch] = self._block_loss(thetas[batch], columns, output)
        return losses

    def _block_loss(self, thetas: Array, columns: tuple[Array, ...], output: Array) -> Array:
        residuals = self._fitted.predict(thetas, *columns)
        residuals -= output
        return mean_square(self._with_prior(thetas, self.rho.transform(residuals)))

    def losses_of(self, outputs: Array) -> Array:
        """Mean squared errors (n,) of model outputs (n, N), without priors."""
        residuals = outputs if self.weights is None else outputs * self.weights
        return mean_square(self.rho.transform(residuals - self._target))

    def _with_prior(self, thetas: Array, residuals: Array) -> Array:
        """Residuals (n, N), followed by the residuals of priors."""
        if self.prior is None:
            return residuals
        return np.hstack([residuals, self.prior.residuals(thetas)])

    def errors(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Weighted difference of model and data, (m,), at one configuration (d,)."""
        return np.asarray(self._errors(theta[None], fidelity)[0])

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Residuals (m,) at one configuration (d,), weighted and transformed, with priors last."""
        return np.asarray(self.residual_rows(theta[None], fidelity)[0])

    def residual_rows(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Residuals (n, m) of several configurations (n, d), evaluated together."""
        errors = self._errors(thetas, fidelity)
        if self._square:
            return self._with_prior(thetas, errors)
        for theta, row in zip(thetas, errors, strict=True):
            if not np.isfinite(row).all():  # no derivatives, or still at a worker
                continue
            while len(self._latest_errors) >= max(1, REMEMBERED // row.size):
                del self._latest_errors[next(iter(self._latest_errors))]
            self._latest_errors[theta.tobytes(), row.size] = row.copy()
        return self.rho.transform(errors)

    def _errors(self, thetas: Array, fidelity: float) -> Array:
        part = self._part(fidelity)
        if self._of_graph is not None:
            return self._of_graph.residuals(thetas, None if part is None else part.size)
        if part is None and self._plain and self.kernel is not None:
            residuals = self.kernel.residuals(thetas)
            if residuals is not None:
                return residuals
        errors = self._fitted.predict(thetas, *self._columns_of(part))
        errors -= self._target if part is None else self._target[part]
        return np.asarray(errors)

    @property
    def _latest_errors(self) -> dict[tuple[bytes, int], Array]:
        """Latest errors of this thread by configuration and row count, for robust derivatives."""
        errors: dict[tuple[bytes, int], Array] = vars(self._of_thread).setdefault("errors", {})
        return errors

    @cached_property
    def _of_thread(self) -> threading.local:
        return threading.local()

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals, (m, d), at one configuration (d,)."""
        part = self._part(fidelity)
        if self._of_graph is None and part is None and self._plain and self.kernel is not None:
            derivatives = self.kernel.jacobian(theta)
            if derivatives is not None:
                return derivatives
        if self._of_graph is not None:
            derivatives = self._of_graph.jacobian(theta, None if part is None else part.size)
        else:
            derivatives = self._fitted.jacobian(theta, *self._columns_of(part))
        if self.prior is not None:
            return np.vstack([derivatives, self.prior.slopes(theta)])
        if self._square:
            return derivatives
        from miho.identification.robust_loss import slope

        errors = self._latest_errors.get((theta.tobytes(), len(derivatives)))
        if errors is None:
            errors = self.errors(theta, fidelity)
        return np.asarray(slope(self.rho, errors)[:, None] * derivatives)

    def error_slopes(self, theta: Array) -> Array:
        """Derivatives of the errors, (N, d)."""
        return self._fitted.jacobian(theta, *self._columns)

    def _columns_of(self, part: NDArray[np.intp] | None) -> tuple[Array, ...]:
        if part is None:
            return self._columns
        return tuple(column[part] for column in self._columns)


def _model(model: object) -> Model:
    """Return a model unchanged, and a function as a model."""
    if callable(model) and not isinstance(model, type | Model):
        model = FunctionModel(model)
    if isinstance(model, Model):
        return model
    raise ValueError(
        f"the model is {model!r}; expected an instance of a model class, for example Pacejka(), or "
        'a function, for example: def decay(t: "s", *, a: "V", b: "1/s") -> "V"'
    )
