"""Stream of a car that accelerates and brakes, whose mass, brake gain or drag changes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np

from baselines.online.streams import STEP, Stream, space_about
from miho.data import Dataset
from miho.identification import CurveFit
from miho.models.symbolic import Symbol, trace
from miho.models.traced import TracedExpression
from miho.quantities import Array
from miho.validate import one_of

NOMINAL = np.array([780.0, 180.0, 0.95])
"""Mass [kg], brake gain [N/bar] and drag [N s^2/m^2]."""
OFFLINE = np.array([8.0, 5.0, 0.05])
"""Standard deviations of the offline estimate."""
NOISE = 0.15
"""Standard deviation of the measured acceleration [m/s^2]."""
TRACTION, PRESSURE, SPEEDS = 6000.0, 60.0, (15.0, 65.0)
"""Largest traction [N], largest brake pressure [bar], lowest and highest speed [m/s]."""


@dataclass(frozen=True)
class Acceleration(TracedExpression):
    """Acceleration of a car: (traction - brake_gain pressure - drag speed^2) / mass."""

    inputs = MappingProxyType({"traction": "N", "pressure": "bar", "speed": "m/s"})
    parameters = MappingProxyType({"mass": "kg", "brake_gain": "N/bar", "drag": "N*s^2/m^2"})
    output = "m/s^2"

    @cached_property
    def graph(self) -> Symbol:
        """Graph of the acceleration."""
        (traction, pressure, speed), (mass, gain, drag) = self.columns, self.arguments
        return trace(lambda: (traction - gain * pressure - drag * speed * speed) / mass)


NAMES = tuple(Acceleration.parameters)
KINDS = ("none", *NAMES)


def longitudinal(
    kind: str, seed: int, seconds: float = 60.0, at: float = 30.0, drop: float = 0.35
) -> Stream:
    """Return a stream of the acceleration of a car at 50 Hz.

    The car accelerates with 40 to 100 % of its traction to a speed of 40 to 65 m/s, then brakes
    with 30 to 100 % of the pressure to 15 to 30 m/s.

    Parameters
    ----------
    kind : {"none", "mass", "brake_gain", "drag"}
        The parameter that falls within 0.2 s.
    seed : int
        Seed of the car, the drive and the noise.
    seconds : float, optional
        Length of the stream.
    at : float, optional
        Time of the change [s].
    drop : float, optional
        Share by which the parameter falls.

    Returns
    -------
    Stream
        The rows with `traction` [N], `pressure` [bar], `speed` [m/s] and `acceleration` [m/s^2].

    Raises
    ------
    ValueError
        If the kind is unknown.
    """
    one_of("kind", kind, KINDS)
    rng = np.random.default_rng(seed)
    t = np.asarray(STEP * np.arange(round(seconds / STEP)), dtype=float)
    theta = NOMINAL * (1 + 0.1 * rng.uniform(-1, 1, 3))
    estimate = theta + OFFLINE * rng.standard_normal(3)
    rows = np.tile(theta, (t.size, 1))
    if kind != "none":
        rows[:, NAMES.index(kind)] *= 1 - drop * np.clip((t - at) / 0.2, 0, 1)
    columns = _driven(rng, rows)
    columns["acceleration"] = columns["acceleration"] + NOISE * rng.standard_normal(t.size)
    return Stream(
        kind,
        (longitudinal_problem(estimate),),
        {n: (float(v), float(s)) for n, v, s in zip(NAMES, estimate, OFFLINE, strict=True)},
        dict.fromkeys(NAMES, 0.35),
        {},
        {"time": t.copy(), **columns},
        dict(zip(NAMES, rows.T, strict=True)),
        t,
        *((at, at + 0.2) if kind != "none" else (None, None)),
    )


def longitudinal_problem(estimate: Array) -> CurveFit:
    """Return the fit of the acceleration; its rows accelerate, brake and roll.

    The offline `estimate` (3,) makes the rows.
    """
    inputs = {
        "traction": np.array([TRACTION, 0.0, 0.0]),
        "pressure": np.array([0.0, PRESSURE, 0.0]),
        "speed": np.array([SPEEDS[0], SPEEDS[1], SPEEDS[1]]),
    }
    model = Acceleration()
    output = model.predict(estimate[None], *inputs.values())[0]
    units = {**Acceleration.inputs, "acceleration": "m/s^2"}
    data = Dataset("car", {**inputs, "acceleration": output}, units, "acceleration")
    space = space_about(Acceleration.parameters, NOMINAL)
    return CurveFit(model, data, space, sigma=NOISE)


def _driven(rng: np.random.Generator, theta: Array) -> dict[str, Array]:
    """Columns of the drive, without noise."""
    rows = np.empty((len(theta), 4))
    speed, braking, share, target = SPEEDS[0], False, 0.8, 50.0
    for k, (mass, gain, drag) in enumerate(theta.tolist()):
        if (speed <= target) if braking else (speed >= target):
            braking = not braking
            share = rng.uniform(0.3, 1.0) if braking else rng.uniform(0.4, 1.0)
            target = rng.uniform(SPEEDS[0], 30.0) if braking else rng.uniform(40.0, SPEEDS[1])
        traction, pressure = (0.0, share * PRESSURE) if braking else (share * TRACTION, 0.0)
        acceleration = (traction - gain * pressure - drag * speed * speed) / mass
        if not braking and acceleration < 0.2:
            target = speed
        rows[k] = traction, pressure, speed, acceleration
        speed += STEP * acceleration
    return dict(zip((*Acceleration.inputs, "acceleration"), rows.T, strict=True))
