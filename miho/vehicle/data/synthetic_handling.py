"""Simulated handling: the driving log of a weave, and a steering test up to the limit of grip."""

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
from miho.vehicle.data.axle_samples import axle_samples
from miho.vehicle.data.driving_log import DrivingLog
from miho.vehicle.models import FrontRear, Pacejka, SingleTrack
from miho.vehicle.models.vehicle_settings import from_settings

AXLES = MappingProxyType(
    {
        "front": MappingProxyType({"B": 18.0, "C": 1.5, "D": 5500.0, "Sx": 0.003, "Sy": 120.0}),
        "rear": MappingProxyType({"B": 18.0, "C": 1.5, "D": 8000.0, "Sx": 0.002, "Sy": 150.0}),
    }
)
"""Axles of the simulated car, both tires together (Eq. 4 in ISO-W).

They are chosen so that a car with the AV-21's masses understeers: cornering stiffness near 150 and
215 kN/rad, friction near 1.5 at its static load and downforce at 40 m/s, and a small asymmetry of
an oval car.
"""

NOISE = MappingProxyType({"vx": 0.05, "vy": 0.05, "yaw_rate": 0.005, "ay": 0.3, "steering": 0.001})
"""Standard deviation of each sensor's white noise at 50 Hz, in SI units: a good unit with GNSS."""

DT = 0.02
DURATION = 40.0
FREQUENCY = 0.4
AMPLITUDE = 0.12


def simulated_weave(car: SingleTrack, noise: float = 1.0, seed: int = 0) -> DrivingLog:
    """40 s at 50 Hz on a flat road: vx from 30 to 45 m/s and back, steering up to +-0.12 rad.

    The steering is a sine of 0.4 Hz whose amplitude grows from zero until the front axle slides.
    The axles are `AXLES`; the lateral motion is integrated by Runge-Kutta of fourth order.

    Parameters
    ----------
    car : SingleTrack
        The car.
    noise : float
        Standard deviation of the white noise, in multiples of `NOISE`.
    seed : int
        Seed of the noise.

    Returns
    -------
    DrivingLog
        Channels vx, vy, yaw_rate, steering and ay.
    """
    at_least("noise", noise, 0)
    whole("seed", seed, 0)
    channels = dict(_true_channels(car))
    rng = np.random.default_rng(seed)
    for name, std in NOISE.items():
        channels[name] = channels[name] + noise * std * rng.standard_normal(channels[name].size)
    return DrivingLog("weave", channels)


def simulated_axle_drive(
    vehicle: Mapping[str, float],
    axle: str = "front",
    noise: float = 1.0,
    seed: int = 0,
    cutoff: float = 5.0,
) -> Dataset:
    """Slip angle and lateral force of an axle in `simulated_weave`.

    The name is the axle and "_axle_drive". The true parameters are in `AXLES`.

    Parameters
    ----------
    vehicle : mapping of str to float
        Fields of `SingleTrack`.
    axle : {'front', 'rear'}
        The axle.
    noise, seed
        See `simulated_weave`.
    cutoff : float
        See `load_axle_samples`.

    Returns
    -------
    Dataset
        See `load_axle_samples`.
    """
    car = from_settings(SingleTrack, vehicle)
    data = axle_samples(simulated_weave(car, noise, seed), car, axle, cutoff)
    return Dataset(f"{axle}_axle_drive", data.columns, data.units, data.output)


@cache
def _true_channels(car: SingleTrack) -> Mapping[str, Array]:
    """The channels without noise."""
    time: Array = np.linspace(0.0, DURATION, round(DURATION / DT) + 1)
    state = np.zeros((time.size, 2))
    for k, t in enumerate(time[:-1]):
        k1 = _derivative(car, t, state[k])
        k2 = _derivative(car, t + DT / 2, state[k] + DT / 2 * k1)
        k3 = _derivative(car, t + DT / 2, state[k] + DT / 2 * k2)
        k4 = _derivative(car, t + DT, state[k] + DT * k3)
        state[k + 1] = state[k] + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    vx, steering = _manoeuvre(time)
    vy, yaw_rate = state.T
    front, rear = _forces(car, vx, vy, yaw_rate, steering)
    ay = (front * np.cos(steering) + rear) / car.mass
    return MappingProxyType(
        {"time": time, "vx": vx, "vy": vy, "yaw_rate": yaw_rate, "ay": ay, "steering": steering}
    )


def _manoeuvre(t: Array) -> tuple[Array, Array]:
    vx = 37.5 - 7.5 * np.cos(2 * np.pi * t / DURATION)
    return vx, AMPLITUDE * t / DURATION * np.sin(2 * np.pi * FREQUENCY * t)


def _forces(car: SingleTrack, vx: Array, vy: Array, yaw_rate: Array, steering: Array) -> FrontRear:
    slip_angles = car.slip_angles(vx, vy, yaw_rate, steering)
    front, rear = (
        Pacejka().predict(np.array([list(theta.values())]), np.atleast_1d(alpha))[0]
        for theta, alpha in zip(AXLES.values(), slip_angles, strict=True)
    )
    return FrontRear(front, rear)


def _derivative(car: SingleTrack, t: float, state: Array) -> Array:
    """Rates of v_y and of the yaw rate."""
    vx, steering = _manoeuvre(np.asarray(t))
    vy, yaw_rate = state
    front, rear = _forces(car, vx, vy, yaw_rate, steering)
    lateral, moment = front * np.cos(steering) + rear, car.lf * front * np.cos(steering)
    return np.concatenate([lateral / car.mass - vx * yaw_rate, (moment - car.lr * rear) / car.Izz])


TRUTH = MappingProxyType(
    {
        axle: MappingProxyType({name: values[name] for name in ("B", "C", "D")})
        for axle, values in AXLES.items()
    }
)
"""The car's axles: the axles of the simulated weave without their asymmetry."""

TEST_AMPLITUDE = 0.12
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
    return 45.0 - 15.0 * share, TEST_AMPLITUDE * share * np.sin(2 * np.pi * cycles)


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
