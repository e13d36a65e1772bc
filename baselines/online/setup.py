"""The task of peers: outputs row by row, prior knowledge, and the sizes of changes.

Arrays have a first axis of S runs, which advance in lockstep; a single run has S = 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.data import Dataset
from miho.online.method import Problems, Rows, numbers_of
from miho.online.motion import StepRows, is_motion, one_step
from miho.online.outputs import TIME, System, system_of
from miho.online.prior import start_of
from miho.online.slopes import RowFormula, TapedFormula, row_formula
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification.report import Report

CHANGE = 0.35
"""Share of its value by which a parameter may change, if it is not given."""
TEACHING = 0.4
"""A row teaches a parameter if its derivative is at least this share of the largest one offline."""


class Predicted(NamedTuple):
    """Predictions of a row.

    Attributes
    ----------
    outputs : ndarray of shape (..., m)
        Outputs.
    slopes : ndarray of shape (..., m, d)
        Derivatives by the parameters.
    variances : ndarray of shape (..., m)
        Variances of the noise of outputs and inputs.
    """

    outputs: Array
    slopes: Array
    variances: Array


@dataclass(frozen=True, eq=False)
class Setup:
    """The outputs, and the knowledge before the first row, of S runs.

    Parameters
    ----------
    system : System
        Models, noise and bounds, the same in all runs.
    formula : RowFormula
        Outputs and derivatives of a row.
    columns : tuple of str
        The input columns; those with noise come first.
    input_noise : ndarray of shape (q,)
        Standard deviations of the first inputs.
    theta : ndarray of shape (S, d)
        Offline estimates.
    covariance : ndarray of shape (S, d, d)
        Their covariances.
    changes : ndarray of shape (S, d)
        Sizes of possible jumps, 0 for a parameter that does not jump.
    largest_slopes : ndarray of shape (S, m, d)
        Largest derivative of each output by each parameter in the offline data.
    example : ndarray of shape (S, p)
        Inputs of a row of the offline data.
    period : float
        Time between rows without a column "time" [s].
    steps : StepRows or None
        The steps between rows of a differential equation.
    """

    system: System
    formula: RowFormula
    columns: tuple[str, ...]
    input_noise: Array
    theta: Array
    covariance: Array
    changes: Array
    largest_slopes: Array
    example: Array
    period: float
    steps: StepRows | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.system.names

    @property
    def low(self) -> Array:
        """Lower bounds (d,)."""
        return self.system.space.low

    @property
    def high(self) -> Array:
        """Upper bounds (d,)."""
        return self.system.space.high

    @cached_property
    def deviations(self) -> Array:
        """Standard deviations of the offline estimates (S, d)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))

    @cached_property
    def watched(self) -> NDArray[np.intp]:
        """Places of the parameters that may jump."""
        return np.flatnonzero(self.changes[0])

    @cached_property
    def sizes(self) -> Array:
        """Unit of the drift of each parameter (S, d): its value if it may jump, or its deviation.

        All peers use it, so that a setting in these units suits every model.
        """
        return np.where(self.changes > 0, np.abs(self.theta), self.deviations)

    def rows(self, rows: Rows) -> Iterator[tuple[float, Array, Array]]:
        """Yield time (NaN without it), inputs (p,) and outputs (m,) of each row; NaN is missing."""
        columns: Mapping[str, Any] = rows.columns if isinstance(rows, Dataset) else rows
        names = (TIME, *self.columns, *(output.column for output in self.system.outputs))
        values = [columns.get(name, np.nan) for name in names]
        p = 1 + len(self.columns)
        if all(isinstance(value, float) for value in values):
            table = np.array([values])
        else:
            each = [numbers_of(name, value) for name, value in zip(names, values, strict=True)]
            table = np.stack(np.broadcast_arrays(*each), 1)
        for row in table:
            yield float(row[0]), row[1:p], row[p:]

    def predicted(self, thetas: Array, x: Array) -> Predicted:
        """Return the predictions of configurations (..., d), each for its own inputs (..., p).

        The variance includes the noise of the inputs, to first order.
        """
        shape, m = thetas.shape[:-1], len(self.system.outputs)
        flat, rows = thetas.reshape(-1, thetas.shape[-1]), x.reshape(-1, x.shape[-1])
        d, q = flat.shape[1], self.input_noise.size
        if isinstance(self.formula, TapedFormula):
            X = np.concatenate([rows.T, flat.T])
            results = self.formula.tape.evaluate(np.empty((1, 0)), X)[0]
            each = results.T.reshape(*shape, m, 1 + d + q)
        else:
            each = np.empty((len(flat), m, 1 + d + q))
            for k, (theta, row) in enumerate(zip(flat, rows, strict=True)):
                slopes = self.formula.at(theta[None], row[None])
                each[k, :, 0], each[k, :, 1 : 1 + d] = slopes.values[:, 0], slopes.parameters[:, 0]
                each[k, :, 1 + d :] = slopes.inputs[:, 0]
            each = each.reshape(*shape, m, 1 + d + q)
        variances = self.system.sigma**2 + each[..., 1 + d :] ** 2 @ self.input_noise**2
        return Predicted(each[..., 0], each[..., 1 : 1 + d], variances)

    def outputs(self, thetas: Array, x: Array) -> Array:
        """Return the outputs (S, m, n) of configurations (S, n, d) at inputs (S, p)."""
        values = np.empty((len(x), len(self.system.outputs), thetas.shape[1]))
        for o, output in enumerate(self.system.outputs):
            own = [self.names.index(name) for name in output.parameters]
            inputs = [self.columns.index(name) for name in output.model.inputs]
            for k, row in enumerate(x):
                values[k, o] = output.model.predict(thetas[k][:, own], *row[inputs][:, None])[:, 0]
        return values


def setup_of(
    problem: Problems,
    prior: Report | Mapping[str, tuple[float, float]] | None,
    changes: Mapping[str, float] | None,
    input_noise: Mapping[str, float] | None,
    period: float,
) -> Setup:
    """Return the task of one run (S = 1), with the arguments of `OnlineMethod.start`."""
    steps = None
    if is_motion(problem):
        steps, problem = StepRows.of_problem(problem), one_step(problem)
    system = system_of(problem)
    if steps is not None and input_noise is None:
        input_noise = steps.noise(system.sigma)
    noise = {name: sigma for name, sigma in (input_noise or {}).items() if sigma > 0}
    columns = (*noise, *(name for name in system.inputs if name not in noise))
    theta, covariance = start_of(system, prior)
    shares = dict.fromkeys(system.names, CHANGE) if changes is None else changes
    sizes = np.array([shares.get(name, 0.0) for name in system.names]) * np.abs(theta)
    slopes = np.zeros((len(system.outputs), theta.size))
    example = np.zeros(len(columns))
    for o, output in enumerate(system.outputs):
        own = [system.names.index(name) for name in output.parameters]
        slopes[o, own] = np.abs(output.model.jacobian(theta[own], *output.examples())).max(axis=0)
        for name, column in zip(output.model.inputs, output.examples(), strict=True):
            example[columns.index(name)] = column[0]
    deviations = np.array(list(noise.values()), dtype=float)
    return Setup(
        system, row_formula(system, columns, deviations), columns, deviations, theta[None],
        covariance[None], sizes[None], slopes[None], example[None], float(period), steps,
    )  # fmt: skip


def abreast(setups: Sequence[Setup]) -> Setup:
    """Return the task of several runs of the same model, which advance in lockstep."""
    return replace(
        setups[0],
        theta=np.concatenate([setup.theta for setup in setups]),
        covariance=np.concatenate([setup.covariance for setup in setups]),
        changes=np.concatenate([setup.changes for setup in setups]),
        largest_slopes=np.concatenate([setup.largest_slopes for setup in setups]),
        example=np.concatenate([setup.example for setup in setups]),
    )
