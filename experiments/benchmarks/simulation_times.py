"""How long a simulation takes over the space of its parameters, measured on this machine.

The car of `single_track_response` driven through the steering test by SciPy's `solve_ivp` as it
comes (RK45, adaptive steps): stiff axles need more steps, and a car that slides needs fewer.
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
from miho.data.synthetic_steering import manoeuvre
from miho.models import Trajectory
from miho.quantities import Array

DRAWS = 512
DURATION = 6.0
"""Seconds of the manoeuvre."""
TOLERANCE = 1e-6


def simulation_times(draws: int = DRAWS, seed: int = 0) -> Array:
    """Seconds (draws,) of simulations with parameters drawn uniformly, the shortest first."""
    return np.sort([_seconds(simulation) for simulation in simulations(draws, seed)])


def simulations(draws: int, seed: int = 0) -> list[Callable[[], Any]]:
    """Simulations that are to be called, each of which gives SciPy's solution."""
    register()
    problem = build_problem(composed(["model=single_track_response", "dataset=steering_test"]))
    model, space = cast(Trajectory, problem.model), problem.space
    thetas = space.decode(space.sample(draws, np.random.default_rng(seed), "uniform"))
    names = [parameter.name for parameter in space.parameters]
    return [partial(_simulated, model, dict(zip(names, row, strict=True))) for row in thetas]


def _simulated(model: Trajectory, parameters: Mapping[str, float]) -> Any:
    from scipy.integrate import solve_ivp  # here, since importing it takes a second

    def rates(t: float, state: Array) -> tuple[float, ...]:
        vx, steering = manoeuvre(np.asarray(t), DURATION)
        motion: tuple[float, ...] = model.rhs(*state, vx, steering, **parameters)
        return motion

    return solve_ivp(rates, (0, DURATION), np.zeros(2), rtol=TOLERANCE, atol=TOLERANCE)


def _seconds(simulation: Callable[[], Any]) -> float:
    began = time.perf_counter()
    simulation()
    return time.perf_counter() - began
