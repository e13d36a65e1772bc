"""Time steps of a simulation that are small enough, for the precision of data and predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from miho.models.layout import OUTPUT
from miho.models.model import Model
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.models.fmu import FmuModel
    from miho.models.trajectory import Trajectory

NOTICEABLE = 0.25
"""Largest error of the solver that is not reported, in standard errors of a parameter."""
TOLERANCE = 1e-9
"""Relative rounding of the length of a step."""
ROUNDING = 1e-11
"""Noise below this fraction of the largest output is rounding: the model itself made the data."""

MOST = 1_000_000
"""Largest number of steps of a prediction."""


def finer(
    model: Model, measured: Sequence[Array], columns: Sequence[Array]
) -> tuple[Sequence[Array], NDArray[np.intp]]:
    """Insert rows into the columns (N,) of a simulation, so that its steps are as short as in data.

    The inserted rows have the inputs that the model assumes between two rows. With times alone, the
    motion starts at the first time of the `measured` columns. Returns the longer columns (M,) and
    the positions of the given rows in them (N,).
    """
    from miho.models.trajectory import Trajectory

    every = np.arange(columns[0].size)
    if not isinstance(model, Trajectory) or model.restart or model.segments > 1:
        return columns, every
    data, (t, earliest) = np.unique(measured[0]), np.unique(columns[0], return_index=True)
    if data.size < 2 or np.isnan(t[-1]):
        return columns, every
    alone = not {*model.inputs} - {model.time, OUTPUT}
    start = data[0] if alone else t[0]
    if t[0] < start:
        raise ValueError(f"{model.time} is {t[0]:g}, before the start of the motion at {start:g}")
    at = np.union1d(np.append(start, t), data[(data > start) & (data < t[-1])])
    parts = np.ceil(np.diff(at) / np.diff(data).max() * (1 - TOLERANCE))
    if not parts.sum() < MOST:
        raise ValueError(
            f"{model.time} reaches {t[-1]:g}, {parts.sum():g} steps of the longest in the data; "
            f"expected at most {MOST:,}"
        )
    ends = np.append(0, np.cumsum(parts))
    at = np.setdiff1d(np.interp(np.arange(ends[-1] + 1), ends, at), t)
    after = np.searchsorted(t, at)
    before = earliest[np.maximum(after - 1, 0)]
    places = before + (after > 0)  # times of each output still increase
    more = [np.insert(columns[0], places, at)]
    for name, u in zip([*model.inputs][1:], columns[1:], strict=True):
        linear = model.interpolation == "linear" and name != OUTPUT
        new = np.interp(at, t, u[earliest]) if linear else u[before]
        more.append(np.insert(u, places, new))
    return more, every + np.searchsorted(np.sort(places), every, side="right")


def time_step_remarks(
    model: Trajectory | FmuModel, order: int, theta: Array, noise: float | Array, *inputs: Array
) -> list[str]:
    """Return a sentence if a halved step would move the optimum by much of its standard errors.

    The change of the solution is divided by the standard deviation of the residuals, `noise`, and
    projected on the column space of the Jacobian. The result bounds the movement of the optimum
    `theta` (d,) in any direction, in standard errors. `order` is the order of the solver.
    """
    values = model.predict(theta[None], *inputs)[0]
    if np.min(noise) <= ROUNDING * np.abs(values).max():
        return []
    noise = np.broadcast_to(noise, inputs[0].shape)
    change = replace(model, substeps=2 * model.substeps).predict(theta[None], *inputs)[0] - values
    J = model.jacobian(theta, *inputs) / noise[:, None]
    moves = J[:, np.abs(J).max(axis=0) > 0]
    scaled = moves / np.linalg.norm(moves, axis=0)
    errors = float(np.linalg.norm(np.linalg.qr(scaled)[0].T @ (change / noise)))
    if errors <= NOTICEABLE:
        return []
    needed = 2 * model.substeps
    if np.isfinite(errors):
        needed = int(np.ceil(model.substeps * (errors / NOTICEABLE) ** (1 / order))) + 1
    return [
        f"half the time step moves the optimum by up to {errors:.2g} standard errors: increase "
        f"substeps to {needed}, from {model.substeps}."
    ]
