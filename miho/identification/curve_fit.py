"""The identification problem: a model, a dataset and a space (Eq. 1, 5, 9)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import InitVar, dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from miho.data.dataset import Dataset
from miho.identification.curve_fit_checks import (
    TRIALS,
    check_curve_fit,
    examined,
    model_of,
    with_defaults,
)
from miho.identification.residuals import Loss, Residuals, Square
from miho.identification.row_order import row_order
from miho.models.function_model import FunctionModel
from miho.models.model import Model, expensive_leaves
from miho.models.traced import Remade
from miho.optim.problem import LeastSquaresProblem, mean_square
from miho.optim.seeds import stream
from miho.optim.space import Parameter, Space
from miho.quantities import Array
from miho.validate import true_or_false

if TYPE_CHECKING:
    from miho.compiled.fit import FitKernel
    from miho.compiled.kernel import Rows
    from miho.identification.prior import PriorResiduals
    from miho.parallel import Evaluations

FRACTION = 1e-12
"""Tolerance for the rounding of a fidelity: m / N means m rows."""
EPSILON = float(np.finfo(float).eps)
ROUNDING = 100.0
"""An error of this number of EPSILON of the output is rounding (both as root mean squares). The
residual of a row is rounded by some EPSILON of the output, r, which changes a loss L by up to 2 r
sqrt(L). This never exceeds AGREEING L + (ROUNDING r)^2, within which two losses count as equal: 100
is 1 / sqrt(AGREEING) (`miho.optim.evidence`)."""
OF_THE_MODEL = "noise", "_residuals"
"""Cached attributes that depend on the form of the model."""


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
    compiled : bool, optional
        Whether the virtual machine of `miho.core` searches with models that are expressions. Other
        models, and all models if the machine was not built, are evaluated with NumPy.
    sigma : float or str, optional
        Standard deviation of the errors, in the unit of the output: a number or a column of the
        data.
    sigma_known : bool, optional
        Whether `sigma` is absolute. If false, the residuals estimate a common factor.
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
    compiled: bool = True
    sigma: str | float | None = None
    sigma_known: bool = True
    prior_scale: float | None = None
    tied_priors: tuple[Parameter, ...] = ()
    expensive: InitVar[bool] = False

    def __post_init__(self, expensive: bool) -> None:
        for part, kind in ((self.dataset, Dataset), (self.space, Space), (self.rho, Loss)):
            if not isinstance(part, kind):
                got = f"got a {type(part).__name__}; miho.fit takes other forms too"
                raise ValueError(f"a CurveFit needs a {kind.__name__}, {got}")
        true_or_false(self, ("compiled", "sigma_known"))
        model = model_of(self.model)
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

        Infinite if it is unknown, for example with priors, or with weights that differ within a
        part of a joint fit.
        """
        if not self._square or self.model.ordered or self.prior is not None:
            return math.inf
        from miho.identification.irreducible import irreducible_square, square_of_parts

        if self.weights is None:
            return irreducible_square(self.inputs, self._output)
        return square_of_parts(self.inputs, self._output, self.weights, self.row_parts)

    @property
    def row_inputs(self) -> tuple[Array, ...]:
        """Input columns along which noise has no structure; empty if errors of rows are not noise.

        This is the case for a system with memory, and for a robust loss.
        """
        return self.inputs if self._square and not self.model.ordered else ()

    @property
    def row_parts(self) -> Array | None:
        """Number of the part of a joint fit that a row belongs to, (N,)."""
        if self.weights is None:
            return None
        from miho.models.layout import PART

        return self.dataset[PART] if PART in self.model.inputs else None

    def angles(self, thetas: Array) -> Array:
        """Ends of the range of each angle over the rows at thetas (n, d), in periods, (k, 2, n)."""
        from miho.identification.periodic import angles

        return angles(self, thetas)

    @cached_property
    def rounding(self) -> float:
        """Largest loss that is rounding and counts as 0, in the output's unit squared."""
        return (ROUNDING * EPSILON) ** 2 * self._mean(self._output**2)

    @cached_property
    def variance(self) -> float:
        """Variance of the output, weighted as the loss."""
        return self._mean((self._output - self._mean(self._output)) ** 2)

    @property
    def resolution(self) -> float:
        """Difference below which two losses count as equal, in the output's unit squared.

        A fit that explains nothing has a loss as large as the variance of the output; at that size
        a difference below EPSILON of the variance is rounding.
        """
        return max(EPSILON * self.variance, self.rounding)

    def _mean(self, values: Array) -> float:
        """The mean of `values` (N,), weighted as the loss."""
        if self.weights is None:
            return float(values.mean())
        return float(np.average(values, weights=self.weights**2))

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

    @property
    def noise_known(self) -> bool:
        """Whether sigma is the deviation of all errors; a robust loss expects larger ones."""
        return self.scale is not None and self.sigma_known and self._square

    @cached_property
    def weights(self) -> Array | None:
        """Weights of the residuals, (N,), of mean square 1; None if all are equal."""
        if not isinstance(self.sigma, str) or self.scale is None:
            return None
        return np.asarray(self.scale / self.dataset[self.sigma])

    @cached_property
    def _residuals(self) -> Residuals:
        """The residuals of the weighted output."""
        model, columns, target = self.model, self.inputs, self._output
        if self.weights is not None:
            from miho.identification.residual_expressions import weighted

            model, columns = weighted(model), (*columns, self.weights)
            target = target * self.weights
        return Residuals(
            model=model,
            columns=columns,
            target=target,
            rho=self.rho,
            prior=self.prior,
            order=lambda: self._order,
            trials=lambda: self.space.decode(self.space.initial(TRIALS)),
            name=self.model.name or type(self.model).__name__,
            compiled=self.compiled,
        )

    @property
    def kernel(self) -> FitKernel | None:
        """Fast forms of the loss, None if the machine cannot run it."""
        return self._residuals.kernel

    @property
    def machine_rows(self) -> Rows | None:
        """Residuals and their derivatives by the machine, None without it."""
        taped = self._residuals.taped
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
        return (self._rows(fidelity) or len(self.dataset)) / len(self.dataset)

    @property
    def rows(self) -> int | None:
        """Number of rows of the data, None if a loss needs all of them."""
        return None if self._all_rows else len(self.dataset)

    def _rows(self, fidelity: float) -> int | None:
        """Number of rows that a fidelity uses, None for all."""
        N = len(self.dataset)
        rows = N if self._all_rows else math.ceil(fidelity * N * (1 - FRACTION))
        return rows if rows < N else None

    @property
    def jacobian_cost(self) -> int | None:
        """Cost of the model's Jacobian, in evaluations."""
        return self.model.jacobian_cost

    @property
    def description(self) -> str:
        """Digests of all data and models that determine the model's outputs.

        Bounds, ties, sigma, priors and the loss may change without a change of the outputs.
        """
        from miho.models.spread import description

        return description(self.model, (*self.inputs, self._output))

    @property
    def called_as(self) -> list[list[bool | None]]:
        """Results of the trial calls of the model's functions: how to call each of them."""
        from miho.models.spread import tried_calls

        return tried_calls(self.model)

    def called(self, calls: Sequence[Any]) -> CurveFit:
        """This problem with its functions called as in `called_as` of the same problem."""
        if not calls:
            return self
        from miho.models.spread import called

        return self._with(called(self.model, calls))

    def spread(self, evaluations: Evaluations) -> CurveFit:
        """This problem with its model evaluated by workers; itself if the model is arithmetic."""
        from miho.models.spread import spread

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
        """Mean squared errors (n,) of configurations (n, d), in the output's unit squared (Eq. 5).

        `fidelity` is the fraction of the rows to use, in (0, 1].
        """
        return self._residuals.losses(thetas, self._rows(fidelity))

    def losses_of(self, outputs: Array) -> Array:
        """Mean squared errors (n,) of model outputs (n, N), without priors."""
        residuals = outputs if self.weights is None else outputs * self.weights
        return mean_square(self.rho.transform(residuals - self._residuals.target))

    def errors(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Weighted difference of model and data, (m,), at one configuration (d,)."""
        return np.asarray(self._residuals.errors(theta[None], self._rows(fidelity))[0])

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Residuals (m,) at one configuration (d,), weighted and transformed, with priors last."""
        return np.asarray(self.residual_rows(theta[None], fidelity)[0])

    def residual_rows(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Residuals (n, m) of several configurations (n, d), evaluated together."""
        return self._residuals.values(thetas, self._rows(fidelity))

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals, (m, d), at one configuration (d,)."""
        return self._residuals.jacobian(theta, self._rows(fidelity))

    def error_slopes(self, theta: Array) -> Array:
        """Derivatives of the errors, (N, d)."""
        return self._residuals.model.jacobian(theta, *self._residuals.columns)
