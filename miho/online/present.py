"""The model of an output with the present parameters of a tracker."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from miho.identification.curve_fit import CurveFit
from miho.models.identified import Identified, Value
from miho.models.tied import Tied
from miho.online.outputs import Output, System
from miho.online.state import SMALLEST, Change, TrackerState
from miho.quantities import Array


def present_parameters(
    system: System,
    output: Output,
    state: TrackerState,
    level: float,
    motion: CurveFit | None = None,
) -> Identified:
    """Return the content of `parameters.json` for an output: all parameters at a state.

    The model of a `motion` is its `Trajectory`, or one step if this has further parameters.
    """
    places = [system.names.index(name) for name in output.parameters]
    theta, ends = state.theta[places], state.intervals(level)[places]
    covariance = state.covariance[np.ix_(places, places)]
    model, columns = output.model.whole, output.columns
    if motion is not None and [*motion.model.whole.parameters] == [*model.parameters]:
        model, columns = motion.model.whole, motion.dataset.columns
    if isinstance(output.model, Tied):
        theta, covariance, ends = _tied(output.model, theta, covariance, ends)
    errors = np.sqrt(np.diag(covariance))
    usable = np.where(errors > 0, errors, np.nan)
    return Identified(
        model=model,
        parameters={
            name: Value(float(theta[k]), unit, float(errors[k]), *map(float, ends[k]))
            for k, (name, unit) in enumerate(model.parameters.items())
        },
        correlation=covariance / np.outer(usable, usable),
        ranges={
            name: (float(columns[name].min()), float(columns[name].max())) for name in model.inputs
        },
        derived={},
        provenance={"interval": "tracked", "rows": state.rows, "time": state.time},
        level=level,
    )


def reported_state(system: System, state: TrackerState) -> TrackerState:
    """Return a state in the reported parameters."""
    space, mixture = system.reported, state.mixture
    if space.names == state.names or mixture is None:
        return state
    theta, slopes = system.reported_at(state.theta)
    covariance = slopes @ state.covariance @ slopes.T
    wider = np.sqrt(np.diag(covariance) / np.maximum(np.diag(state.covariance), SMALLEST))
    mixture = mixture._replace(
        means=theta + (mixture.means - state.theta) @ slopes.T,
        deviations=mixture.deviations * wider,
    )
    ends = space.low, space.high
    return replace(
        state, names=space.names, theta=theta, covariance=covariance, mixture=mixture, bounds=ends
    )


def reported_change(system: System, change: Change) -> Change:
    """Return a change of the reported parameters."""
    (before, a), (after, b) = system.reported_at(change.before), system.reported_at(change.after)
    errors = np.sqrt(a**2 @ change.before_errors**2), np.sqrt(b**2 @ change.after_errors**2)
    return Change(before, after, *errors)


def _tied(model: Tied, theta: Array, covariance: Array, ends: Array) -> tuple[Array, Array, Array]:
    """Values, covariance and intervals of all parameters; tied ones have linearised intervals."""
    ties = model.ties
    count = len(ties.parameters)
    values = ties.values(theta[None])[0, :count]
    slopes = ties.value_slopes(theta[None])[0, :count]
    whole = slopes @ covariance @ slopes.T
    errors = np.sqrt(np.diag(covariance))
    halves = np.where(errors > 0, np.diff(ends)[:, 0] / 2 / np.where(errors > 0, errors, 1.0), 0.0)
    reach = float(halves.max(initial=0.0)) * np.sqrt(np.diag(whole))
    intervals = np.stack([values - reach, values + reach], axis=1)
    free = list(ties.free)
    for k, name in enumerate(ties.parameters):
        if name in free:
            intervals[k] = ends[free.index(name)]
    return values, whole, intervals
