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
    check_sigma,
    examined,
    ties_of,
    with_defaults,
)
from miho.identification.irreducible import irreducible_square
from miho.identification.loss import Loss, Square, slope
from miho.identification.prior import PriorResiduals
from miho.identification.row_order import row_order
from miho.models.expression import Expression
from miho.models.function_model import FunctionModel
from miho.models.leaves import called, dear_leaves, description, spread, tried_calls
from miho.models.model import Model
from miho.models.symbolic import arguments_of
from miho.models.tied import Tied, tie
from miho.models.traced import Remade, TracedExpression
from miho.models.weighted import weighted
from miho.optim.problem import LeastSquaresProblem, mean_square
from miho.optim.seeds import stream
from miho.optim.space import Parameter, Space
from miho.parallel import Evaluations
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.compiled.fit import FitKernel
    from miho.compiled.kernel import Rows
    from miho.compiled.taped import TapedLoss


FRACTION = 1e-12
"""A fidelity of m / N means m rows, whatever the rounding of the fraction."""
EPSILON = float(np.finfo(float).eps)
ROUNDING = 100.0
"""An error of so many EPSILON of the output is rounding (root mean squares of both). A row's
residual is rounded by some EPSILON of the output, r, which moves a loss L by up to 2 r sqrt(L).
That is never more than AGREEING L + (ROUNDING r)^2, within which two losses count as equal: 100 is
1 / sqrt(AGREEING) (`miho.optim.evidence`)."""
REMEMBERED = 1 << 20
"""Numbers of errors to remember for the derivatives of a robust loss at the same configurations."""
OF_THE_MODEL = ("noise", "_fitted", "_taped", "_of_thread")
"""What a problem remembers of its model."""
BLOCK = 50_000
"""Model values per block: the temporaries of one block stay in the cache of one core."""


@dataclass(frozen=True, eq=False)
class CurveFit(Remade, LeastSquaresProblem):
    """Mean squared difference between model and data, in the output's unit squared.

    `rho` is the loss of one residual: the square of the paper's Eq. 5, or one that outliers cannot
    dominate; `residuals` and `jacobian` are then of the transformed residuals, whose mean square
    is the loss, and `errors` are the differences themselves. The space must name the model's
    parameters in the model's order, and the units of space, data and model must agree; where it
    fixes or ties some, `model` and `space` become those of the free ones (`miho.models.tied`),
    and everything else follows. `label`
    names the problem: the same data in two spaces are two problems. The square loss of a model
    that is an `Expression` is a fast kernel, and takes batches on `threads` threads.

    A plain function may stand for the model, with annotations as `miho.models.FunctionModel`
    describes them. One of arithmetic and NumPy's functions of numbers gets exact derivatives. Like
    any expression it is searched by the machine of `miho.core`, unless `compiled` is false. Any
    other model is evaluated as it is, and so are all where the machine was not built.

    `sigma` is the standard deviation of the errors, a number or a column of the data, in the
    output's unit: known as it is, or if not `sigma_known` up to one factor for all rows, which the
    residuals then tell. Residuals and errors are weighted by `scale` / sigma, so that they and the
    loss keep the output's unit. `prior_scale` takes the place of `scale` for priors where sigma is
    not known: what it is estimated as. `tied_priors` are the tied parameters that have a prior. A
    model that is known to be `dear` is not evaluated here to see whether it can be.
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
    dear: InitVar[bool] = False

    def __post_init__(self, dear: bool) -> None:
        model = _model(self.model)
        object.__setattr__(self, "space", with_defaults(self.space, model))
        if isinstance(model, FunctionModel):
            model = examined(model, self.dataset, self.space, dear)
        if self.space.free is not self.space:
            model = tie(model, ties_of(model, self.space))
            tied = tuple(p for p in self.space.parameters if p.tied and p.prior is not None)
            object.__setattr__(self, "tied_priors", tied)
        object.__setattr__(self, "model", model)
        object.__setattr__(self, "space", self.space.free)
        check_curve_fit(self, dear)
        check_sigma(self)

    @property
    def name(self) -> str:  # type: ignore[override]
        """The label, else model and dataset."""
        if self.label is not None:
            return self.label
        name = f"{self.model.name or type(self.model).__name__.lower()}-{self.dataset.name}"
        return name if self._square else f"{name}-{type(self.rho).__name__.lower()}"

    @property
    def _square(self) -> bool:
        return isinstance(self.rho, Square)

    @property
    def linear(self) -> tuple[str, ...]:  # type: ignore[override]
        """The parameters in which the residuals are linear."""
        if not self._square:
            return ()
        bent = {p.name for p in self.space.parameters if p.prior and p.scale == "log"}
        if self.tied_priors and self.prior is not None:  # as far as they may depend on any
            places = arguments_of(self.prior.tied_graphs)
            bent |= {name for k, name in enumerate(self.space.names) if f"p{k}" in places}
        return tuple(name for name in self.model.linear if name not in bent)

    @property
    def unit(self) -> str:
        """Unit of the residuals."""
        return self.dataset.units[self.dataset.output]

    @cached_property
    def noise(self) -> float:  # type: ignore[override]
        """The mean square that is not the model's: how far neighbouring points scatter at most.

        Infinite where that is not known, as beside priors.
        """
        if not self._square or self.model.ordered:
            return math.inf
        if self.weights is not None or self.prior is not None:
            return math.inf  # neighbouring rows do not scatter alike, or are not all
        return irreducible_square(self.inputs, self._output)

    @property
    def row_inputs(self) -> tuple[Array, ...]:  # type: ignore[override]
        """The inputs along which noise has no structure: none where errors of rows are not noise.

        They are not where a model is a system with a past, or where losses count outliers less.
        """
        return self.inputs if self._square and not self.model.ordered else ()

    @cached_property
    def rounding(self) -> float:  # type: ignore[override]
        """Losses up to this, in the output's unit squared, are rounding and count as 0."""
        return (ROUNDING * EPSILON) ** 2 * float(np.mean(self._output**2))

    @cached_property
    def resolution(self) -> float:  # type: ignore[override]
        """Losses that differ by less than this, in the output's unit squared, count as equal.

        Of losses as large as the output's variance, which are those of a fit that explains nothing,
        a difference below EPSILON of that is rounding.
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
        """The root of the harmonic mean of sigma^2, in the output's unit; None without sigma."""
        if self.sigma is None:
            return None
        sigma = self.dataset[self.sigma] if isinstance(self.sigma, str) else np.array([self.sigma])
        return float(1 / np.sqrt(np.mean(1 / sigma**2)))

    @cached_property
    def weights(self) -> Array | None:
        """What residuals are multiplied by, (N,), of mean square 1; None where all count alike."""
        if not isinstance(self.sigma, str) or self.scale is None:
            return None
        return np.asarray(self.scale / self.dataset[self.sigma])

    @cached_property
    def _fitted(self) -> Model:
        """The model of `_target` over `_columns`, the weighted output."""
        return self.model if self.weights is None else weighted(self.model)

    @cached_property
    def _columns(self) -> tuple[Array, ...]:
        return self.inputs if self.weights is None else (*self.inputs, self.weights)

    @cached_property
    def _target(self) -> Array:
        return self._output if self.weights is None else self._output * self.weights

    @cached_property
    def kernel(self) -> FitKernel | None:  # type: ignore[override]
        """Fast forms of the square loss of a model that the machine runs."""
        model = self._fitted
        plain = self._square and self.prior is None
        if not (self.compiled and plain and isinstance(model, Expression)) or self._taped is None:
            return None
        thetas = self.space.decode(self.space.initial(TRIALS))
        name = self.model.name or type(self.model).__name__
        return kernel_for(self._taped, model, thetas, name=name)

    @cached_property
    def _taped(self) -> TapedLoss | None:
        """The model by the machine, None where that cannot run it."""
        if not isinstance(self._fitted, Expression):
            return None
        columns, target = np.array(self._columns), self._target
        return taped_loss(self._fitted, columns, target, lambda: self._order, threads=self.threads)

    @property
    def _of_graph(self) -> TapedLoss | None:
        """The model that is known as a graph, by the machine: there is nothing to compare."""
        return self._taped if isinstance(self._fitted, TracedExpression) else None

    @property
    def machine_rows(self) -> Rows | None:
        """Residuals of the square loss and their derivatives by the machine, None without."""
        plain = self.compiled and self._square and self.prior is None
        taped = self._taped if plain else None
        return None if taped is None else taped.rows_of(taped.X, taped.y)

    @cached_property
    def prior(self) -> PriorResiduals | None:
        """The residuals of the parameters that have a prior, None without any."""
        free = any(parameter.prior is not None for parameter in self.space.parameters)
        if not free and not self.tied_priors:
            return None
        ties = self.model.ties if isinstance(self.model, Tied) else None
        scale = self.prior_scale or self.scale or 1.0
        return PriorResiduals(self.space, scale, self.tied_priors, ties)

    @property
    def residual_count(self) -> int:
        """How many residuals there are: the rows of data, and those of priors."""
        return len(self.dataset) + (0 if self.prior is None else len(self.prior.parameters))

    @property
    def _all_rows(self) -> bool:
        """Whether a loss needs every row: of a model with a memory, and beside priors."""
        return self.model.ordered or self.prior is not None

    @cached_property
    def _order(self) -> NDArray[np.intp]:
        """The fixed order of the rows of which a fidelity takes the first ones."""
        return row_order(self.inputs, stream("fidelity", self.dataset.digest))

    @property
    def order(self) -> NDArray[np.intp] | None:  # type: ignore[override]
        """The order in which a fidelity takes the rows."""
        return None if self._all_rows else self._order

    def cost(self, fidelity: float) -> float:
        """The fraction of rows that a fidelity uses; all of them where their order matters."""
        return self._rows(fidelity) / len(self.dataset)

    @property
    def rows(self) -> int | None:  # type: ignore[override]
        """Rows of the data, if a model may be asked for some of them."""
        return None if self._all_rows else len(self.dataset)

    def _rows(self, fidelity: float) -> int:
        N = len(self.dataset)
        return N if self._all_rows else min(N, math.ceil(fidelity * N * (1 - FRACTION)))

    def _part(self, fidelity: float) -> NDArray[np.intp] | None:
        """The rows that a fidelity uses, None for all."""
        rows = self._rows(fidelity)
        return None if rows == len(self.dataset) else self._order[:rows]

    @property
    def jacobian_cost(self) -> int | None:  # type: ignore[override]
        """The cost of the model's Jacobian, in evaluations."""
        return self.model.jacobian_cost

    @property
    def description(self) -> str:
        """Digests of what the outputs of its models depend on: columns of the data and the models.

        Bounds, ties, sigma, priors and the loss may change without another output.
        """
        return description(self.model, (*self.inputs, self._output))

    @property
    def called_as(self) -> list[list[bool | None]]:  # type: ignore[override]
        """What trial calls have shown of its functions."""
        return tried_calls(self.model)

    def called(self, calls: Sequence[Any]) -> CurveFit:
        """This problem, whose functions are called as `called_as` of the same problem says."""
        return self._with(called(self.model, calls)) if calls else self

    def spread(self, evaluations: Evaluations) -> CurveFit:
        """This problem with its model's outputs evaluated by these; itself if it is arithmetic."""
        return self._with(spread(self.model, evaluations, self.losses_of))

    def _with(self, model: Model) -> CurveFit:
        """This problem with another form of its model, where that is more than arithmetic."""
        if not dear_leaves(self.model):
            return self
        problem = object.__new__(CurveFit)  # all else that is known of this one stays so
        known = {key: value for key, value in vars(self).items() if key not in OF_THE_MODEL}
        vars(problem).update(known, model=model)
        return problem

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Mean squared error (n,) of parameter rows (n, d), over a fidelity of the data rows."""
        columns, output, rows = self._columns, self._target, self._rows(fidelity)
        if self._of_graph is not None and self._square and self.prior is None:
            return self._of_graph.losses(thetas, rows)
        if self.kernel is not None:
            losses = self.kernel.losses(thetas, rows)
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
        """Mean squared error (n,) of the model's outputs (n, N), priors left out."""
        residuals = outputs if self.weights is None else outputs * self.weights
        return mean_square(self.rho.transform(residuals - self._target))

    def _with_prior(self, thetas: Array, residuals: Array) -> Array:
        """Residuals (n, N) and behind them those of priors."""
        if self.prior is None:
            return residuals
        return np.hstack([residuals, self.prior.residuals(thetas)])

    def errors(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Model minus data, weighted, (m,)."""
        return np.asarray(self._errors(theta[None], fidelity)[0])

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Model minus data, weighted and transformed by rho, and those of priors, (m,)."""
        return np.asarray(self.residual_rows(theta[None], fidelity)[0])

    def residual_rows(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Residuals (n, m) of parameter rows (n, d), evaluated side by side."""
        errors = self._errors(thetas, fidelity)
        if self._square:
            return self._with_prior(thetas, errors)
        for theta, row in zip(thetas, errors, strict=True):
            if not np.isfinite(row).all():  # it has no derivatives, or is only begun by workers
                continue
            while len(self._latest_errors) >= max(1, REMEMBERED // row.size):
                del self._latest_errors[next(iter(self._latest_errors))]
            self._latest_errors[theta.tobytes(), row.size] = row.copy()
        return self.rho.transform(errors)

    def _errors(self, thetas: Array, fidelity: float) -> Array:
        part = self._part(fidelity)
        if self._of_graph is not None:
            return self._of_graph.residuals(thetas, None if part is None else part.size)
        if part is None and self.kernel is not None:
            residuals = self.kernel.residuals(thetas)
            if residuals is not None:
                return residuals
        errors = self._fitted.predict(thetas, *self._columns_of(part))
        errors -= self._target if part is None else self._target[part]
        return np.asarray(errors)

    @property
    def _latest_errors(self) -> dict[tuple[bytes, int], Array]:
        """The latest errors by configuration and number of rows, of each thread on its own; robust
        derivatives need them."""
        errors: dict[tuple[bytes, int], Array] = vars(self._of_thread).setdefault("errors", {})
        return errors

    @cached_property
    def _of_thread(self) -> threading.local:
        return threading.local()

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals, (m, d)."""
        part = self._part(fidelity)
        if self._of_graph is None and part is None and self.kernel is not None:
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
    """A model as it is, and a function made into one."""
    if callable(model) and not isinstance(model, type | Model):
        model = FunctionModel(model)
    if isinstance(model, Model):
        return model
    raise ValueError(
        f"the model is {model!r}; expected an object of a model class, such as Pacejka(), or a "
        'function such as: def decay(t: "s", *, a: "V", b: "1/s") -> "V"'
    )
