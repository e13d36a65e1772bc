"""From an identified problem to what `parameters.json` holds."""

from __future__ import annotations

import contextlib
import math

import numpy as np
from numpy.typing import NDArray

from miho.identification.curve_fit import CurveFit
from miho.identification.refit import refit
from miho.identification.uncertainty import linearised
from miho.models.identified import Identified, Value

Array = NDArray[np.float64]

NAN = math.nan
MEAN_SPEED = "mean vx"
"""A derived quantity of an axle: the speed [m/s] at whose loads its forces were measured."""


def identified(problem: CurveFit, theta: Array) -> Identified:
    """A result with the linearised intervals of the optimum nearby, as parameters.json has it.

    Without them, as of parameters that the data do not tell apart, errors are NaN.
    """
    size = len(theta)
    errors, ends, correlation = np.full(size, NAN), np.full((size, 2), NAN), np.eye(size)
    with contextlib.suppress(ValueError):
        at = linearised(problem, refit(problem, theta).theta)
        errors, ends, correlation = at.standard_errors, at.intervals(), at.correlation
    parameters = {
        p.name: Value(float(theta[i]), p.unit, float(errors[i]), *map(float, ends[i]))
        for i, p in enumerate(problem.space.parameters)
    }
    ranges = {
        name: (float(problem.dataset[name].min()), float(problem.dataset[name].max()))
        for name in problem.model.inputs
    }
    loss = float(problem.loss(theta[None])[0])
    derived = {}
    if "vx" in problem.dataset.columns and "vx" not in problem.model.inputs:
        derived[MEAN_SPEED] = Value(float(problem.dataset["vx"].mean()), "m/s")
    about = {"problem": problem.name, "data": problem.dataset.digest, "error": math.sqrt(loss)}
    return Identified(problem.model, parameters, correlation, ranges, derived, about)
