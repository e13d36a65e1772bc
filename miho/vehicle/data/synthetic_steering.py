"""A synthetic steering test: the yaw rate of a known car up to its limit of grip."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

import numpy as np
import scipy  # loads its subpackages on first use: importing them takes a second

from miho.data.dataset import Dataset
from miho.quantities import Array
from miho.validate import at_least, positive, whole
from miho.vehicle.data.synthetic_handling import AXLES, NOISE
from miho.vehicle.models.single_track import SingleTrack
from miho.vehicle.models.vehicle_settings import from_settings

TRUTH = MappingProxyType(
    {
        axle: MappingProxyType({name: values[name] for name in ("B", "C", "D")})
        for axle, values in AXLES.items()
    }
)
"""The car's axles: the axles of the simulated weave without their asymmetry."""

AMPLITUDE = 0.12
"""Largest steering angle [rad]: the rear axle passes its peak force, the front nears it."""
TOLERANCE = 1e-10


def steering_test(
    vehicle: Mapping[str, object],
    seed: int = 0,
    duration: float = 6.0,
    rate: float = 50.0,
    noise: float = NOISE["yaw_rate"],
) -> Dataset:
    """A sine of growing amplitude, 0.25 to 1.25 Hz, while the car slows from 45 to 30 m/s.

    Steering angles are linear between rows (a steering robot), and the motion is integrated by a
    method of order 8 with a relative tolerance of 1e-10.

    Parameters
    ----------
    vehicle : mapping of str to object
        Fields of `SingleTrack`; the axles are `TRUTH`.
    seed : int
        Seed of the noise.
    duration : float
        Duration [s].
    rate : float
        Rows per second.
    noise : float
        Standard deviation of the normal noise of the yaw rate [rad/s]. Speed and steering are
        exact.

    Returns
    -------
    Dataset
        Columns t [s], vx [m/s], steering [rad] and the output yaw_rate [rad/s], positive to the
        left.
    """
    whole("seed", seed, 0)
    positive("duration", duration)
    positive("rate", rate)
    at_least("noise", noise, 0)
    if round(duration * rate) < 2:
        raise ValueError(f"duration is {duration} s at rate {rate}; expected at least two rows")
    t, vx, steering, yaw_rate = _simulate(from_settings(SingleTrack, vehicle), duration, rate)
    rng = np.random.default_rng([seed, *b"steering"])
    yaw_rate = yaw_rate + noise * rng.standard_normal(t.size)
    columns = {"t": t, "vx": vx, "steering": steering, "yaw_rate": yaw_rate}
    units = {"t": "s", "vx": "m/s", "steering": "rad", "yaw_rate": "rad/s"}
    return Dataset("steering_test", columns, units, "yaw_rate")


def manoeuvre(t: Array, duration: float) -> tuple[Array, Array]:
    """Speed [m/s] and steering angle [rad] at times t [s]."""
    share = t / duration
    cycles = t * (0.25 + 0.5 * share)  # frequency 0.25 + share, in Hz
    return 45.0 - 15.0 * share, AMPLITUDE * share * np.sin(2 * np.pi * cycles)


@cache
def _simulate(car: SingleTrack, duration: float, rate: float) -> tuple[Array, Array, Array, Array]:
    """Time [s], speed [m/s], steering [rad] and yaw rate [rad/s] without noise, (N,) each."""
    t = np.arange(round(duration * rate)) / rate
    vx, steering = manoeuvre(t, duration)

    def rates(at: float, state: Array) -> Array:
        speed, delta = np.interp(at, t, vx), np.interp(at, t, steering)
        slip = car.slip_angles(speed, state[0], state[1], delta)
        F_f = _force("front", float(slip.front)) * math.cos(delta)
        F_r = _force("rear", float(slip.rear))
        return np.array(
            [(F_f + F_r) / car.mass - speed * state[1], (car.lf * F_f - car.lr * F_r) / car.Izz]
        )

    yaw_rate, state = np.zeros(t.size), np.zeros(2)
    for row in range(1, t.size):  # the steering has a kink at each row
        span = (t[row - 1], t[row])
        solution = scipy.integrate.solve_ivp(
            rates, span, state, "DOP853", rtol=TOLERANCE, atol=TOLERANCE / 100
        )
        state = solution.y[:, -1]
        yaw_rate[row] = state[1]
    return t, vx, steering, yaw_rate


def _force(axle: str, alpha: float) -> float:
    truth = TRUTH[axle]
    return -truth["D"] * math.sin(truth["C"] * math.atan(truth["B"] * alpha))
