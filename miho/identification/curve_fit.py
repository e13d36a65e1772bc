"""The identification problem: a model, a dataset and a space (Eq. 1, 5, 9)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from miho.compiled import kernel_for
from miho.data.dataset import Dataset
from miho.identification.irreducible import irreducible_interval, irreducible_limit
from miho.identification.loss import Loss, Square, slope
from miho.identification.row_order import row_order
from miho.models.expression import Expression
from miho.models.function_model import FunctionModel
from miho.models.model import Model
from miho.optim.problem import LeastSquaresProblem, mean_square
from miho.optim.seeds import stream
from miho.optim.space import Space
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.compiled.fit import FitKernel


TRIALS = 5
"""Configurations at which a new problem is tried out."""
LINEAR = 1e-9
FRACTION = 1e-12
"""A fidelity of m / N means m rows, whatever the rounding of the fraction."""
FAR = 2.0
"""A nominal value this factor beyond the data is far from them."""
EPSILON = float(np.finfo(float).eps)
ROUNDING = 100.0
"""Of EPSILON: a root-mean-square error of this share of the output's is rounding. A row's residual
is rounded by some EPSILON of the output, r, which moves a loss L by up to 2 r sqrt(L). That is
never more than AGREEING L + (ROUNDING r)^2, within which two losses are one: 100 is
1 / sqrt(AGREEING) (`miho.optim.evidence`)."""
FEWEST = 3
"""Rows that tell of any."""
SCATTER, SCATTERED = 100_000, 20_000
"""Rows that tell how far points scatter, of one input; of several, where looking for neighbours
takes longer the more inputs there are."""
REMEMBERED = 1 << 20
"""Errors that are kept for the derivatives of a robust loss at the same configurations."""
SMALLEST, LARGEST = 1e-140, 1e150
"""The largest output has a square that neither its rounding nor a sum over all rows takes out of
double precision, 1e-308 to 1e308."""
BLOCK = 50_000
"""Model values per block: the temporaries of one block stay in the cache of one core."""


@dataclass(frozen=True, eq=False)
class CurveFit(LeastSquaresProblem):
    """Mean squared difference between model and data, in the output's unit squared.

    `rho` is the loss of one residual: the square of the paper's Eq. 5, or one that outliers cannot
    dominate; `residuals` and `jacobian` are then of the transformed residuals, whose mean square
    is the loss, and `errors` are the differences themselves. The space must name the model's
    parameters in the model's order, and the units of space, data and model must agree. `label`
    names the problem: the same data in two spaces are two problems. The square loss of a model
    that is an `Expression` is compiled, and evaluates batches on `threads` threads. `compressed`
    takes it, to 1e-9 of itself, from far fewer values than points, if the model has one input and
    a `bound`; residuals, derivatives and lower fidelities stay those of the points. So neither
    changes a run of a method that works with residuals, such as `MIHOGN`, the default.

    A plain function may stand for the model, with annotations as `miho.models.FunctionModel`
    describes them; its `linear` parameters are then declared by giving that class itself.
    """

    model: Model
    dataset: Dataset
    space: Space
    rho: Loss = field(default_factory=Square)
    label: str | None = None
    threads: int = 1
    compressed: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", _model(self.model))
        model, dataset = self.model, self.dataset
        called = model.name or type(model).__name__
        if self.space.names != tuple(model.parameters):
            raise ValueError(_difference(called, list(model.parameters), self.space.names))
        if model.ordered and dataset.held_out is not None:
            raise ValueError(f"{called} needs every row in order: no rows can be held out")
        _ = self.inputs
        found = {f"parameter {p.name!r} of the space": p.unit for p in self.space.parameters}
        found |= {
            f"column {name!r} of {dataset.name}": dataset.units[name] for name in model.inputs
        }
        found |= {f"output {dataset.output!r} of {dataset.name}": self.unit}
        needed = (*model.parameters.values(), *model.inputs.values(), model.output)
        for (what, unit), need in zip(found.items(), needed, strict=True):
            if unit != need:
                raise ValueError(f"{what} has unit {unit!r}; model {called} needs {need!r}")
        thetas, rows = self.space.decode(self.space.initial(2)), len(dataset)
        shapes = {
            "predict": (model.predict(thetas, *self.inputs).shape, (2, rows)),
            "jacobian": (model.jacobian(thetas[0], *self.inputs).shape, (rows, len(self.space))),
        }
        for method, (found_shape, shape) in shapes.items():
            if found_shape != shape:
                raise ValueError(f"{called}.{method} gives shape {found_shape}; expected {shape}")

        self._check_values(called)
        self._check_nominal(called)
        if self.compressed and (self.kernel is None or self.kernel.few_nodes is None):
            raise ValueError(
                f"compressed is true for {called} with {len(model.inputs)} inputs and the loss "
                f"{type(self.rho).__name__}; expected an Expression of one input that has a bound, "
                "and the loss Square; set compressed to false"
            )

    def _check_nominal(self, called: str) -> None:
        """Warn where parameters refer to conditions far from those of the data."""
        for name, (nominal, value) in self.model.nominal.items():
            column = self.dataset[name]
            low, high = float(column.min()), float(column.max())
            if not low / FAR <= value <= FAR * high:
                unit = self.dataset.units[name]
                warnings.warn(
                    f"{called}: {nominal} is {value:g} {unit}, but {name} is {low:g} to {high:g} "
                    f"{unit} in {self.dataset.name}: the coefficients refer to what was not "
                    f"measured, and their usual ranges need not hold; choose {nominal} near "
                    f"{float(np.median(column)):.4g}",
                    UserWarning,
                    stacklevel=2,
                )

    def _check_values(self, called: str) -> None:
        """Refuse rows that the model predicts nowhere, and a linearity that is not so.

        And an output whose squares overflow, or are 0 beside their rounding.
        """
        model, names = self.model, self.space.names
        largest = float(np.abs(self._output).max(initial=0.0))
        if largest and not SMALLEST < largest < LARGEST:
            raise ValueError(
                f"column {self.dataset.output!r} of {self.dataset.name} reaches {largest:.3g} "
                f"{self.unit}, whose square is beyond double precision; give it in a unit in "
                f"which it reaches {SMALLEST:g} to {LARGEST:g}"
            )
        thetas = self.space.decode(self.space.initial(TRIALS))
        try:
            values = model.predict(thetas, *self.inputs)
        except ValueError:  # a model may fail on a part of the box; the run counts how often
            return
        never = np.flatnonzero(~np.isfinite(values).any(axis=0))
        if never.size and np.isfinite(values).any():
            at = ", ".join(
                f"{name} = {column[never[0]]:g}"
                for name, column in zip(model.inputs, self.inputs, strict=True)
            )
            raise ValueError(
                f"{called} is not finite at {at} (row {never[0] + 1} of {self.dataset.name}), "
                "whatever its parameters; remove the row or correct the model"
            )
        if not model.linear:
            return
        other = thetas[0].copy()
        for name in model.linear:
            other[names.index(name)] = thetas[1, names.index(name)]
        one, two, middle = model.predict(
            np.stack([thetas[0], other, (thetas[0] + other) / 2]), *self.inputs
        )
        valued = np.isfinite(one) & np.isfinite(two) & np.isfinite(middle)
        one, two, middle = one[valued], two[valued], middle[valued]
        with np.errstate(over="ignore", invalid="ignore"):
            size = np.abs(one) + np.abs(two)
            bent = np.abs(one + two - 2 * middle) > LINEAR * (size + size.max(initial=0.0))
        if bent.any():
            raise ValueError(
                f"{called} is not linear in {', '.join(model.linear)} as it declares; correct "
                "`linear`"
            )

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
        return self.model.linear if self._square else ()

    @property
    def unit(self) -> str:
        """Unit of the residuals."""
        return self.dataset.units[self.dataset.output]

    @cached_property
    def noise(self) -> float:  # type: ignore[override]
        """The mean square that is not the model's: how far neighbouring points scatter at most.

        The upper end of an interval for it, see `irreducible_interval` for one input and
        `irreducible_limit` for several; of long data some rows tell it.
        """
        if not self._square or self.model.ordered or len(self.dataset) < FEWEST:
            return math.inf
        most = SCATTER if len(self.inputs) == 1 else SCATTERED
        every = slice(None, None, -(-len(self.dataset) // most))
        X, y = np.array(self.inputs)[:, every], self._output[every]
        if len(X) == 1:
            return float(irreducible_interval(X[0], y).high) ** 2
        return irreducible_limit(X, y) ** 2

    @cached_property
    def rounding(self) -> float:  # type: ignore[override]
        """The loss, in the output's unit squared, up to which a loss is 0."""
        return (ROUNDING * EPSILON) ** 2 * float(np.mean(self._output**2))

    @cached_property
    def resolution(self) -> float:  # type: ignore[override]
        """How close losses may be, in the output's unit squared, without being told apart.

        Of losses as large as the output's variance, which are those of a fit that explains nothing,
        a difference below EPSILON of that is rounding.
        """
        return max(EPSILON * float(np.var(self._output)), self.rounding)

    @cached_property
    def inputs(self) -> tuple[Array, ...]:
        """The model's input columns, (N,) each."""
        return tuple(self.dataset[column] for column in self.model.inputs)

    @cached_property
    def _output(self) -> Array:
        return self.dataset[self.dataset.output]

    @cached_property
    def kernel(self) -> FitKernel | None:  # type: ignore[override]
        """Compiled forms of the square loss of a model that is an expression."""
        if not (isinstance(self.model, Expression) and self._square):
            return None
        thetas = self.space.decode(self.space.initial(TRIALS))
        name = self.model.name or type(self.model).__name__
        return kernel_for(
            self.model, np.array(self.inputs), self._output, self._order, thetas,
            name=name, threads=self.threads, compressed=self.compressed,
        )  # fmt: skip

    @cached_property
    def _order(self) -> NDArray[np.intp]:
        """The fixed order of the rows of which a fidelity takes the first ones."""
        return row_order(self.inputs, stream("fidelity", self.dataset.digest))

    @property
    def order(self) -> NDArray[np.intp] | None:  # type: ignore[override]
        """The order in which a fidelity takes the rows."""
        return None if self.model.ordered else self._order

    def cost(self, fidelity: float) -> float:
        """The fraction of rows that a fidelity uses; all of them where their order matters."""
        return self._rows(fidelity) / len(self.dataset)

    @property
    def rows(self) -> int | None:  # type: ignore[override]
        """Rows of the data, if a model may be asked for some of them."""
        return None if self.model.ordered else len(self.dataset)

    def _rows(self, fidelity: float) -> int:
        N = len(self.dataset)
        return N if self.model.ordered else min(N, math.ceil(fidelity * N * (1 - FRACTION)))

    def _part(self, fidelity: float) -> NDArray[np.intp] | None:
        """The rows that a fidelity uses, None for all."""
        rows = self._rows(fidelity)
        return None if rows == len(self.dataset) else self._order[:rows]

    @property
    def jacobian_cost(self) -> int | None:  # type: ignore[override]
        """What the model's Jacobian costs, in evaluations."""
        return self.model.jacobian_cost

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Mean squared error (n,) of parameter rows (n, d), over a fidelity of the data rows."""
        inputs, output, rows = self.inputs, self._output, self._rows(fidelity)
        if self.kernel is not None:
            losses = self.kernel.losses(thetas, rows)
            if losses is not None:
                return losses
        if rows < output.size:
            part = self._order[:rows]
            inputs, output = tuple(column[part] for column in inputs), output[part]
        block = max(1, BLOCK // output.size)
        if len(thetas) <= block:
            return self._block_loss(thetas, inputs, output)
        losses = np.empty(len(thetas))
        for start in range(0, len(thetas), block):
            some = slice(start, start + block)
            losses[some] = self._block_loss(thetas[some], inputs, output)
        return losses

    def _block_loss(self, thetas: Array, inputs: tuple[Array, ...], output: Array) -> Array:
        residuals = self.model.predict(thetas, *inputs)
        residuals -= output
        return mean_square(self.rho.transform(residuals))

    def errors(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Model minus data, (m,)."""
        return np.asarray(self._errors(theta[None], fidelity)[0])

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Model minus data, transformed by rho, (m,)."""
        return np.asarray(self.residual_rows(theta[None], fidelity)[0])

    def residual_rows(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Residuals (n, m) of parameter rows (n, d), evaluated side by side."""
        errors = self._errors(thetas, fidelity)
        if self._square:
            return errors
        for theta, row in zip(thetas, errors, strict=True):
            while len(self._known_errors) >= max(1, REMEMBERED // row.size):
                del self._known_errors[next(iter(self._known_errors))]
            self._known_errors[theta.tobytes(), row.size] = row.copy()
        return self.rho.transform(errors)

    def _errors(self, thetas: Array, fidelity: float) -> Array:
        part = self._part(fidelity)
        if part is None and self.kernel is not None:
            residuals = self.kernel.residuals(thetas)
            if residuals is not None:
                return residuals
        errors = self.model.predict(thetas, *self._inputs_of(part))
        errors -= self._output if part is None else self._output[part]
        return np.asarray(errors)

    @cached_property
    def _known_errors(self) -> dict[tuple[bytes, int], Array]:
        """The latest errors, by configuration and rows: what robust derivatives need as well."""
        return {}

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals, (m, d)."""
        part = self._part(fidelity)
        if part is None and self.kernel is not None:
            derivatives = self.kernel.jacobian(theta)
            if derivatives is not None:
                return derivatives
        derivatives = self.model.jacobian(theta, *self._inputs_of(part))
        if self._square:
            return derivatives
        errors = self._known_errors.get((theta.tobytes(), len(derivatives)))
        if errors is None:
            errors = self.errors(theta, fidelity)
        return np.asarray(slope(self.rho, errors)[:, None] * derivatives)

    def _inputs_of(self, part: NDArray[np.intp] | None) -> tuple[Array, ...]:
        if part is None:
            return self.inputs
        return tuple(column[part] for column in self.inputs)


def _model(given: object) -> Model:
    """A model as it is, and a function made into one."""
    if isinstance(given, Model):
        return given
    if callable(given) and not isinstance(given, type):
        return FunctionModel(given)
    raise ValueError(
        f"the model is {given!r}; expected an object of a model class, such as Pacejka(), or a "
        'function such as: def decay(t: "s", *, a: "V", b: "1/s") -> "V"'
    )


def _difference(called: str, needed: Sequence[str], given: Sequence[str]) -> str:
    """What a space lacks or has too much for a model."""
    lacking = [name for name in needed if name not in given]
    besides = [name for name in given if name not in needed]
    told = [f"lacks {', '.join(lacking)}"] * bool(lacking)
    told += [f"has {', '.join(besides)} besides"] * bool(besides)
    if not told:
        told = [f"has them in the order {', '.join(given)}"]
    return (
        f"model {called} needs the parameters {', '.join(needed)}; the space {' and '.join(told)}; "
        "choose the model's own space"
    )
