"""Synthetic brake tests: pressure, torque, steps, deceleration and play of a known brake.

The brake resembles that of a Dallara AV-21: up to 6000 kPa, a bias between 0.54 and 0.60, and about
2.0 N per kPa, as measured in driving (geometry alone would give 7 to 11). It replaces a brake test
bench and a straight, so that identified parameters can be compared with the truth.
"""

from __future__ import annotations

import numpy as np

from miho.data.dataset import Dataset
from miho.quantities import Array
from miho.validate import at_least, one_of, positive, whole
from miho.vehicle.models import Brake, BrakeResponse, play

EMBEDDED_BRAKE = Brake(
    u0=0.065, u1=0.93, P_max=6.0e6, n=1.35, bias=0.57,
    K_front=3.6e-4, P0_front=6.0e4, K_rear=3.25e-4, P0_rear=5.0e4,
    radius_front=0.298, radius_rear=0.310,
    delay=0.047, tau_rise=0.120, tau_fall=0.075,
)  # fmt: skip
"""The brake under test."""

MASS = 800.0
"""Mass of the car [kg]."""
DRAG = 0.5 * 1.2 * 0.79
"""Half the air density times C_d A [N s^2/m^2]."""
RESISTANCE = 1100.0
"""Rolling resistance and engine drag with closed throttle [N]."""
AXLES = ("front", "rear")
PLAY = 0.06
"""Full width of the play in the pedal linkage [-], in units of the command."""
TURNS = (0.0, 1.0, 0.0, 0.8, 0.35, 0.6, 0.5, 0.55, 0.2, 0.9, 0.7, 0.76, 0.1, 0.3, 0.0)
"""Turning points of the command: a full loop, inner loops, and reversals within the play."""


def brake_pressure_test(
    seed: int = 0, steps: int = 50, samples: int = 20, noise: float = 5.0e3
) -> Dataset:
    """Settled pressure on a staircase of commands from 0 to 1 and back.

    The top steps exceed u1, so that the pressure is P_max.

    Parameters
    ----------
    seed : int
        Seed of the noise.
    steps : int
        Steps up, and steps down.
    samples : int
        Samples per step.
    noise : float
        Standard deviation of both sensors [Pa].

    Returns
    -------
    Dataset
        Columns u [-], the output p [Pa] of the front circuit and p_rear [Pa].

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """
    rng = _rng("pressure", seed, steps=steps, samples=samples, noise=noise)
    up = np.linspace(0.0, 1.0, steps + 1)
    u = np.repeat(np.concatenate([up, up[-2::-1]]), samples)
    front, rear = (p + noise * rng.standard_normal(u.size) for p in EMBEDDED_BRAKE.pressure(u))
    columns = {"u": u, "p": front, "p_rear": rear}
    return Dataset("brake_pressure", columns, {"u": "-", "p": "Pa", "p_rear": "Pa"}, "p")


def brake_torque_test(
    axle: str = "front", seed: int = 0, steps: int = 40, samples: int = 20, noise: float = 10.0
) -> Dataset:
    """Torque of an axle over the pressure in its circuit, at three speeds.

    Parameters
    ----------
    axle : {'front', 'rear'}
        The axle.
    seed : int
        Seed of the noise.
    steps : int
        Steps of the pressure, from 0 to the largest of the circuit.
    samples : int
        Samples per step.
    noise : float
        Standard deviation of the torque [Nm].

    Returns
    -------
    Dataset
        Columns p [Pa], vx [m/s] and the output T [Nm].

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """
    one_of("axle", axle, AXLES)
    rng = _rng(f"torque {axle}", seed, steps=steps, samples=samples, noise=noise)
    brake = EMBEDDED_BRAKE
    largest = float(brake.pressure(1.0)[AXLES.index(axle)])
    speeds = (20.0, 40.0, 60.0)
    p = np.tile(np.repeat(np.linspace(0.0, largest, steps + 1), samples), len(speeds))
    vx = np.repeat(speeds, p.size // len(speeds))
    K, P0 = (getattr(brake, f"{name}_{axle}") for name in ("K", "P0"))
    T = K * np.maximum(p - P0, 0.0) + noise * rng.standard_normal(p.size)
    name = "brake_torque" if axle == "front" else "brake_torque_rear"
    units = {"p": "Pa", "vx": "m/s", "T": "Nm"}
    return Dataset(name, {"p": p, "vx": vx, "T": T}, units, "T")


def brake_step_test(
    seed: int = 0, steps: int = 40, rate: float = 100.0, noise: float = 1.5e4
) -> Dataset:
    """Random steps of the command, up, down and to zero, with the pressure over time.

    Parameters
    ----------
    seed : int
        Seed of the steps and the noise.
    steps : int
        Number of steps; each lasts between 0.3 and 0.8 s.
    rate : float
        Samples per second.
    noise : float
        Standard deviation of the pressure [Pa].

    Returns
    -------
    Dataset
        Columns t [s], u [-], the steady pressure target [Pa] that u commands and the output p [Pa]
        of the front circuit.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """
    rng = _rng("step", seed, steps=steps, rate=rate, noise=noise)
    brake = EMBEDDED_BRAKE
    level = np.where(rng.random(steps) < 0.3, 0.0, rng.uniform(0.1, 1.0, steps))
    level[0] = 0.0
    held = np.round(rate * rng.uniform(0.3, 0.8, steps)).astype(int)
    u = np.repeat(level, np.maximum(held, 1))
    t = np.arange(u.size) / rate
    target = brake.pressure(u)[0]
    theta = np.array([[brake.delay, brake.tau_rise, brake.tau_fall]])
    p = BrakeResponse().predict(theta, t, target)[0] + noise * rng.standard_normal(u.size)
    columns = {"t": t, "u": u, "target": target, "p": p}
    units = {"t": "s", "u": "-", "target": "Pa", "p": "Pa"}
    return Dataset("brake_step", columns, units, "p")


def brake_deceleration_test(
    seed: int = 0, samples: int = 20, duration: float = 1.0, noise: float = 0.15
) -> Dataset:
    """Braking from five speeds at six pressures, as a driving log would record it.

    All pressures exceed the contact pressures of the pads.

    Parameters
    ----------
    seed : int
        Seed of the noise.
    samples : int
        Samples per phase.
    duration : float
        Duration of a phase [s].
    noise : float
        Standard deviation of the deceleration [m/s^2].

    Returns
    -------
    Dataset
        Columns p [Pa] of the front circuit, vx [m/s] and the output deceleration [m/s^2], positive.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """
    rng = _rng("deceleration", seed, samples=samples, duration=duration, noise=noise)
    since = np.linspace(0.0, duration, samples)
    phases = [
        (np.full(samples, pressure), _slow_down(speed, pressure, since))
        for speed in (20.0, 30.0, 40.0, 50.0, 60.0)
        for pressure in (0.25e6, 0.5e6, 1.0e6, 2.0e6, 3.5e6, 5.0e6)
    ]
    p, vx = (np.concatenate(column) for column in zip(*phases, strict=True))
    deceleration = _deceleration(p, vx) + noise * rng.standard_normal(p.size)
    columns = {"p": p, "vx": vx, "deceleration": deceleration}
    units = {"p": "Pa", "vx": "m/s", "deceleration": "m/s^2"}
    return Dataset("brake_deceleration", columns, units, "deceleration")


def brake_play_test(seed: int = 0, samples: int = 800, noise: float = 5.0e4) -> Dataset:
    """Slow sweeps of the command between `TURNS` and the settled pressure of the front circuit.

    Parameters
    ----------
    seed : int
        Seed of the noise.
    samples : int
        Number of samples, at equal steps along the path of the command.
    noise : float
        Standard deviation of the normal noise of the pressure [Pa].

    Returns
    -------
    Dataset
        Columns u [-] and the output p [Pa], in the order of measurement.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """
    whole("samples", samples, len(TURNS))
    rng = _rng("play", seed, noise=noise)
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(TURNS)))])
    u: Array = np.interp(np.linspace(0.0, travelled[-1], samples), travelled, TURNS)
    p = EMBEDDED_BRAKE.pressure(play(u, PLAY))[0] + noise * rng.standard_normal(samples)
    return Dataset("brake_play", {"u": u, "p": p}, {"u": "-", "p": "Pa"}, "p")


def _slow_down(speed: float, pressure: float, since: Array) -> Array:
    """Speed [m/s] at times since the brake was applied: the solution of dv/dt = -(a + b v^2)."""
    a, b = _deceleration(np.array(pressure), np.array(0.0)), DRAG / MASS
    root = np.sqrt(a / b)
    return np.asarray(root * np.tan(np.arctan(speed / root) - np.sqrt(a * b) * since))


def _deceleration(p: Array, vx: Array) -> Array:
    return np.asarray((EMBEDDED_BRAKE.force_of_pressure(p) + DRAG * vx * vx + RESISTANCE) / MASS)


def _rng(test: str, seed: int, **settings: float) -> np.random.Generator:
    """A random stream for each test and seed; raises ValueError for invalid settings."""
    whole("seed", seed, 0)
    for name, value in settings.items():
        least = {"steps": 2, "samples": 1, "noise": 0.0}.get(name)
        if least is None:
            positive(name, value)
        else:
            at_least(name, value, least)
    return np.random.default_rng([seed, *test.encode()])
