"""Stream of a car as a bicycle: speeds and yaw rate, and their values one step later."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from baselines.online.streams import (
    STEP,
    SUDDEN,
    Stream,
    corners,
    period,
    present,
    space_about,
    spoil,
    straighten,
    swing_near_peak,
)
from miho.data import Dataset
from miho.identification import CurveFit
from miho.models.symbolic import Symbol, trace
from miho.models.traced import TracedExpression
from miho.quantities import Array
from miho.validate import one_of

FRONT, REAR = 1.2, 1.4
"""Distances of the axles from the centre of gravity [m]."""
FRONT_LOAD, REAR_LOAD = 9.81 * REAR / (FRONT + REAR), 9.81 * FRONT / (FRONT + REAR)
"""Loads of the axles, divided by the mass [m/s^2]. The yaw inertia is FRONT REAR times the mass."""
SHAPE = 1.5
"""C of both axles."""
NAMES = ("B_f", "D_f", "B_r", "D_r")
NOMINAL = np.array([12.0, 1.0, 14.0, 1.15])
OFFLINE = np.array([0.6, 0.03, 0.7, 0.0345])
"""Standard deviations of the offline estimate."""
NOISE = (0.01, 0.003, 0.002)
"""Standard deviations of the measured vx, vy [m/s] and yaw rate [rad/s]."""
STATES, OUTPUTS = ("vx", "vy", "yaw_rate"), ("vx_next", "vy_next", "yaw_rate_next")
NEAR_PEAK = (0.115, 0.02)
SUBSTEPS = 5
"""Steps of the simulation in one step of the model."""
KINDS = ("none", "jump", "ramp", "straight", "mixed", "outliers", "jump_outliers",
         "nan", "dropout", "missing", "frozen", "time")  # fmt: skip
Functions = tuple[Callable[[Any], Any], Callable[[Any], Any], Callable[[Any], Any]]
"""Sine, cosine and arc tangent, of numbers or of symbols."""
Motion = tuple[Any, Any, Any]
"""vx, vy [m/s] and yaw rate [rad/s]."""


def bicycle(
    kind: str, seed: int, seconds: float = 60.0, at: float = 30.0, drop: float = 0.35
) -> Stream:
    """Return a stream of the motion of a car at 50 Hz, whose grip may fall at both axles.

    A row has the measured motion and the motion one step (20 ms) later, so that a model of one step
    predicts the outputs `vx_next`, `vy_next` [m/s] and `yaw_rate_next` [rad/s]. The unknown
    parameters are B and D of the front and rear axle; the speed is about 20 m/s.

    Parameters
    ----------
    kind : str
        Change or fault, as in `baselines.online.streams.tire`; D of both axles falls.
    seed : int
        Seed of the car, the drive and the noise.
    seconds : float, optional
        Length of the stream.
    at : float, optional
        Time of the change or fault [s].
    drop : float, optional
        Share by which the grip falls.

    Returns
    -------
    Stream
        The rows.

    Raises
    ------
    ValueError
        If the kind is unknown.

    Examples
    --------
    >>> stream = bicycle("jump", seed=1, seconds=2, at=1)
    >>> [problem.dataset.output for problem in stream.problem]
    ['vx_next', 'vy_next', 'yaw_rate_next']
    """
    one_of("kind", kind, KINDS)
    rng = np.random.default_rng(seed)
    t = np.asarray(STEP * np.arange(round(seconds / STEP) + 1), dtype=float)
    theta = NOMINAL * (1 + 0.1 * rng.uniform(-1, 1, 4))
    theta[3] = 1.15 * theta[1] * (1 + 0.05 * rng.uniform(-1, 1))
    estimate = theta + OFFLINE * rng.standard_normal(4)
    slip = corners(rng, t.size)
    if kind in SUDDEN:
        swing_near_peak(slip, t, at, rng, NEAR_PEAK)
    straighten(slip, t, kind, at, rng)
    slip = np.convolve(slip, np.ones(5) / 5, "same")
    speed = 20 + 3 * np.sin(2 * np.pi * t / 37 + rng.uniform(0, 6))
    rows = np.tile(theta, (t.size, 1))
    if kind in SUDDEN or kind == "ramp":
        fall = 1 - drop * np.clip((t - at) / (10.0 if kind == "ramp" else 0.2), 0, 1)
        rows[:, [1, 3]] *= fall[:, None]
    motion, steering, drive = simulated(slip, speed, rows)
    measured = motion + np.array(NOISE) * rng.standard_normal(motion.shape)
    columns = {
        "time": t[:-1].copy(),
        **dict(zip(STATES, measured[:-1].T.copy(), strict=True)),
        "steering": steering[:-1],
        "drive": drive[:-1],
        **dict(zip(OUTPUTS, measured[1:].T.copy(), strict=True)),
    }
    spoil(columns, OUTPUTS, NOISE, kind, at, rng)
    there = present(t[:-1], kind, at)
    return Stream(
        kind,
        bicycle_problem(estimate),
        {n: (float(v), float(s)) for n, v, s in zip(NAMES, estimate, OFFLINE, strict=True)},
        {"D_f": 0.35, "D_r": 0.35},
        dict(zip(STATES, NOISE, strict=True)),
        {name: column[there] for name, column in columns.items()},
        {name: column[there] for name, column in zip(NAMES, rows[:-1].T, strict=True)},
        t[:-1][there],
        *period(kind, at),
    )


def bicycle_problem(estimate: Array) -> tuple[CurveFit, ...]:
    """Return the fits of vx, vy and yaw rate one step later; their rows are at 20 m/s.

    The offline `estimate` (4,) makes the rows.
    """
    slip = np.linspace(-0.12, 0.12, 25)
    inputs = {"vx": np.full(25, 20.0), "vy": -20 * slip, "yaw_rate": np.zeros(25),
              "steering": np.zeros(25), "drive": np.zeros(25)}  # fmt: skip
    space = space_about(OneStep.parameters, NOMINAL)
    fits = []
    for k, (output, sigma) in enumerate(zip(OUTPUTS, NOISE, strict=True)):
        model = OneStep(k)
        columns = {**inputs, output: model.predict(estimate[None], *inputs.values())[0]}
        data = Dataset(output, columns, {**OneStep.inputs, output: model.output}, output)
        fits.append(CurveFit(model, data, space, sigma=sigma))
    return tuple(fits)


def accelerations(
    state: Motion, steering: Any, drive: Any, theta: Sequence[Any], functions: Functions
) -> Motion:
    """Return the rates of vx, vy [m/s^2] and yaw rate [rad/s^2].

    All arguments are numbers, arrays or symbols. `state` is vx, vy [m/s] and yaw rate [rad/s],
    `steering` the angle of the front wheels [rad], `drive` the driving force over the mass [m/s^2],
    `theta` is B_f [1/rad], D_f [-], B_r [1/rad], D_r [-], and `functions` are their sine, cosine
    and arc tangent.
    """
    vx, vy, yaw_rate = state
    B_f, D_f, B_r, D_r = theta
    sin, cos, arctan = functions
    front_slip = steering - (vy + FRONT * yaw_rate) / vx
    rear_slip = (REAR * yaw_rate - vy) / vx
    front = FRONT_LOAD * D_f * sin(SHAPE * arctan(B_f * front_slip))
    rear = REAR_LOAD * D_r * sin(SHAPE * arctan(B_r * rear_slip))
    lateral = front * cos(steering)
    return (
        drive - front * sin(steering) + vy * yaw_rate,
        lateral + rear - vx * yaw_rate,
        lateral / REAR - rear / FRONT,
    )


def one_step(
    state: Motion,
    steering: Any,
    drive: Any,
    theta: Sequence[Any],
    step: float = STEP,
    functions: Functions = (np.sin, np.cos, np.arctan),
) -> Motion:
    """Return the motion one step later by the midpoint rule.

    Parameters
    ----------
    state, steering, drive, theta
        As for `accelerations`.
    step : float, optional
        Duration of the step [s].
    functions : tuple of callable, optional
        As for `accelerations`; by default NumPy's functions.

    Returns
    -------
    tuple
        vx, vy [m/s] and yaw rate [rad/s].
    """
    rates = accelerations(state, steering, drive, theta, functions)
    middle = tuple(x + step / 2 * rate for x, rate in zip(state, rates, strict=True))
    rates = accelerations(middle, steering, drive, theta, functions)
    vx, vy, yaw_rate = (x + step * rate for x, rate in zip(state, rates, strict=True))
    return vx, vy, yaw_rate


@dataclass(frozen=True)
class OneStep(TracedExpression):
    """One component of the motion after a step of 20 ms.

    Parameters
    ----------
    component : int
        0 for vx, 1 for vy, 2 for the yaw rate.
    """

    component: int
    inputs = MappingProxyType(
        {"vx": "m/s", "vy": "m/s", "yaw_rate": "rad/s", "steering": "rad", "drive": "m/s^2"}
    )
    parameters = MappingProxyType({"B_f": "1/rad", "D_f": "-", "B_r": "1/rad", "D_r": "-"})

    @cached_property
    def graph(self) -> Symbol:
        """Graph of the component."""
        vx, vy, yaw_rate, steering, drive = self.columns
        state = (vx, vy, yaw_rate)
        return trace(lambda: one_step(state, steering, drive, self.arguments)[self.component])

    @property
    def output(self) -> str:
        """Unit of the component."""
        return ("m/s", "m/s", "rad/s")[self.component]


def simulated(slip: Array, speed: Array, theta: Array) -> tuple[Array, Array, Array]:
    """Return the motion along slip angles of the front axle and speeds.

    The steering follows the slip angle, at most 0.5 rad; the drive follows the speed. `slip` (N,)
    [rad] is positive for forces to the left, `speed` (N,) is in m/s, and `theta` (N, 4) has the
    parameters of the car in each row. The results are vx, vy [m/s] and yaw rate [rad/s] (N, 3), the
    angle of the front wheels [rad] (N,), and the driving force over the mass [m/s^2] (N,).
    """
    motion, steering, drive = np.empty((slip.size, 3)), np.empty(slip.size), np.empty(slip.size)
    state: Motion = (float(speed[0]), 0.0, 0.0)
    functions = (math.sin, math.cos, math.atan)
    for k in range(slip.size):
        vx, vy, yaw_rate = motion[k] = state
        angle = min(max(float(slip[k]) + (vy + FRONT * yaw_rate) / vx, -0.5), 0.5)
        push = 2.0 * (float(speed[k]) - vx)
        steering[k], drive[k] = angle, push
        parameters = theta[k].tolist()
        for _ in range(SUBSTEPS):
            state = one_step(state, angle, push, parameters, STEP / SUBSTEPS, functions)
    return motion, steering, drive
