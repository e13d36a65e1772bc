"""Check that the time step of a simulation is small enough for the precision of the data."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from miho.quantities import Array

if TYPE_CHECKING:
    from miho.models.fmu import FmuModel
    from miho.models.trajectory import Trajectory

NOTICEABLE = 0.25
"""Largest error of the solver that is not reported, in standard errors of a parameter."""
ROUNDING = 1e-11
"""Noise below this fraction of the largest output is rounding: the model itself made the data."""


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
