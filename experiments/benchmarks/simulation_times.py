"""Seconds of simulations over the space of their parameters, measured on this machine.

The car of `single_track_response` drives the steering test, simulated by SciPy's `solve_ivp` with
default settings (RK45, adaptive steps). Stiff axles need more steps, a sliding car fewer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, cast

import numpy as np

from experiments.app.build import build_problem
from experiments.app.compose import composed
from experiments.app.schema import register
from miho.models import Trajectory
from miho.quantities import Array
from miho.vehicle.data.synthetic_steering import manoeuvre

DRAWS = 512
DURATION = 6.0
"""Seconds of the manoeuvre."""
TOLERANCE = 1e-6


def simulation_times() -> Array:
    """Seconds (DRAWS,) of simulations with parameters drawn uniformly, the shortest first."""
    return np.sort([_seconds(simulation) for simulation in simulations(DRAWS)])


def simulations(draws: int) -> list[Callable[[], Any]]:
    """Functions without arguments that simulate and return SciPy's solution."""
    register()
    problem = build_problem(composed(["model=single_track_response", "dataset=steering_test"]))
    model, space = cast(Trajectory, problem.model), problem.space
    thetas = space.decode(space.sample(draws, np.random.default_rng(0), "uniform"))
    names = [parameter.name for parameter in space.parameters]
    return [partial(_simulated, model, dict(zip(names, row, strict=True))) for row in thetas]


def _simulated(model: Trajectory, parameters: Mapping[str, float]) -> Any:
    from scipy.integrate import solve_ivp  # the import takes a second

    def rates(t: float, state: Array) -> tuple[float, ...]:
        vx, steering = manoeuvre(np.asarray(t), DURATION)
        motion: tuple[float, ...] = model.rhs(*state, vx, steering, **parameters)
        return motion

    return solve_ivp(rates, (0, DURATION), np.zeros(2), rtol=TOLERANCE, atol=TOLERANCE)


def _seconds(simulation: Callable[[], Any]) -> float:
    began = time.perf_counter()
    simulation()
    return time.perf_counter() - began
