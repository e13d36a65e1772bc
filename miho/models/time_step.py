"""Whether the time step of a simulation is small enough for what the data can tell."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from miho.quantities import Array

if TYPE_CHECKING:
    from miho.models.fmu import FmuModel
    from miho.models.trajectory import Trajectory

NOTICEABLE = 0.25
"""Standard errors by which the solver's own error may move a parameter before it is told."""


def time_step_remarks(
    model: Trajectory | FmuModel, order: int, theta: Array, noise: float, *inputs: Array
) -> list[str]:
    """A sentence if half the step would move parameters by much of their standard errors.

    The change of the solution, projected on what the parameters can do, over the standard deviation
    of the errors, `noise`: so many standard errors at most does the optimum `theta` (d,) move in
    any direction. The solver's error falls with a power of the step, its `order`.
    """
    if noise == 0:
        return []
    finer = replace(model, substeps=2 * model.substeps)
    change = finer.predict(theta[None], *inputs)[0] - model.predict(theta[None], *inputs)[0]
    J = model.jacobian(theta, *inputs)
    moves = J[:, np.abs(J).max(axis=0) > 0]
    scaled = moves / np.linalg.norm(moves, axis=0)
    errors = float(np.linalg.norm(np.linalg.qr(scaled)[0].T @ change)) / noise
    if errors <= NOTICEABLE:
        return []
    needed = 2 * model.substeps
    if np.isfinite(errors):
        needed = int(np.ceil(model.substeps * (errors / NOTICEABLE) ** (1 / order))) + 1
    return [
        f"half the time step moves the optimum by up to {errors:.2g} standard errors: set "
        f"substeps to {needed}, it is {model.substeps}."
    ]
