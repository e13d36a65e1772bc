"""A synthetic engine, its dyno test, and a drive that identifies it.

The paper's dyno data and logs are not public. This turbocharged engine has the peak torque (527 Nm
near 4900 rpm) and power (318 kW near 6150 rpm) of its class. Its closed form shows how far an
identified curve or map is from the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from miho.data.dataset import Dataset
from miho.quantities import Array, g
from miho.validate import whole
from miho.vehicle.data.driving_log import DrivingLog
from miho.vehicle.data.torque_samples import torque_samples
from miho.vehicle.models.engine import RPM
from miho.vehicle.models.longitudinal import Longitudinal

OMEGA_MAX = 7000 * RPM
"""Largest speed of the engine [rad/s]."""

CAR = Longitudinal(
    mass=800.0,
    wheel_radius=0.31,
    gear_ratios=(2.9167, 1.875, 1.3809, 1.1154, 0.96, 0.8889),
    final_drive=3.0,
    efficiency=0.9,
    engine_inertia=0.2,
    wheel_inertia=3.0,
    C_d=0.474,
    C_r=120.0,
)
"""The car of the synthetic drive: an AV-21, as in conf/vehicle/av21.yaml."""

DYNO_THROTTLES = (0.0, 0.05, 0.15, 0.2, 0.3, 0.5, 0.65, 0.8, 0.9, 1.0)
DYNO_TRUSTED = 0.3
"""The dyno is accurate from this opening on, and at 0, where the dyno drags the engine."""

HELD_THROTTLES = (0.05, 0.15, 0.2, 0.3)
HELD_GEARS = (2, 3, 4)
STEP = 0.04
WINDOW = 50
"""Time step of `_Drive` [s], and number of steps that are solved at once."""
SLOWEST, FASTEST = 1300 * RPM, 6800 * RPM
"""Range of engine speeds that the driver uses [rad/s]."""


def true_torque(omega: ArrayLike, throttle: ArrayLike) -> Array:
    """Torque [Nm] at engine speeds [rad/s] from 1000 to 7000 rpm and openings [0, 1]; broadcasts.

        T = filling (T_na + T_f + boost spool (T_turbo - T_na)) - T_f

    The filling of the cylinders saturates if the throttle passes more air than the engine draws,
    which happens earlier at low speed. The turbo spools up from 3000 to 3600 rpm. It may boost from
    an opening of 25 %, fully from 85 %. T_f is friction: with closed throttle the engine brakes.
    The torque rises with the opening at every speed, but hardly above 80 %.
    """
    n = np.asarray(omega, dtype=float) / RPM / 1000
    throttle = np.asarray(throttle, dtype=float)
    T_f = 8 + 21 * n
    T_na = 230 - 130 * np.exp((1 - n) / 1.5)
    T_turbo = 527 - 29.2 * np.abs((n - 4.9) / 1.2) ** 3
    spool = 1 / (1 + np.exp((3.3 - n) / 0.11))
    opened = np.clip((throttle - 0.25) / 0.6, 0, 1)
    boost = opened**2 * (3 - 2 * opened)
    filling = _filling(throttle, n) / _filling(np.asarray(1.0), n)
    return np.asarray(filling * (T_na + T_f + boost * spool * (T_turbo - T_na)) - T_f)


def _filling(throttle: Array, n: Array) -> Array:
    """Share of the air that the engine would draw at n [1000 rpm], before normalisation."""
    flow = 12.2 * throttle**1.2 / n
    return np.asarray(flow / (1 + flow**4) ** 0.25)


def dyno_test(seed: int = 0) -> Dataset:
    """A dyno test of the engine at the openings `DYNO_THROTTLES`.

    The noise is 2 Nm at an opening of 0 and from 30 % on. In between, where the dyno cannot hold a
    small torque, the noise is 15 Nm, and each curve has an additional error of 20 to 40 Nm that
    drifts with the speed: these curves cannot be trusted.

    Parameters
    ----------
    seed : int
        Seed of the noise.

    Returns
    -------
    Dataset
        Columns throttle [-], omega [rad/s] every 100 rpm from 1000 to 7000 rpm, and the output
        torque [Nm].
    """
    whole("seed", seed, 0)
    rng = np.random.default_rng(seed)
    omega = np.arange(1000, 7001, 100) * RPM
    w = omega / OMEGA_MAX
    rows = []
    for throttle in DYNO_THROTTLES:
        weak = 0 < throttle < DYNO_TRUSTED
        error = rng.choice([-1, 1]) * (rng.uniform(20, 40) + rng.normal(0, 20) * (w - 0.5))
        noise = rng.standard_normal(w.size)
        rows.append(true_torque(omega, throttle) + (error + 15 * noise if weak else 2 * noise))
    columns = {
        "throttle": np.repeat(DYNO_THROTTLES, omega.size),
        "omega": np.tile(omega, len(rows)),
        "torque": np.concatenate(rows),
    }
    units = {"throttle": "-", "omega": "rad/s", "torque": "Nm"}
    return Dataset("dyno", columns, units, "torque")


@dataclass
class _Drive:
    """The car on an undulating road at 25 Hz; `rows` collects the channels, (7, n) each.

    The torque follows the throttle without delay. omega is the speed of the engine, which differs
    from the wheels' while the clutch slips.
    """

    car: Longitudinal
    gear: int = 1
    vx: float = 6.0
    distance: float = 0.0
    omega: float = 0.0
    rows: list[Array] = field(default_factory=list)

    def locked(
        self, throttle: float, seconds: float, until: tuple[float, float], brake: float = 0.0
    ) -> None:
        """Drive with the clutch closed until the engine leaves the speeds (low, high) [rad/s].

        `brake` is a pressure [Pa]; it slows the car by 2 N per kPa, including the rotating mass.
        """
        car, gear = self.car, self.gear
        slowed = 2e-3 * brake / (car.mass + car.equivalent_mass(gear))
        for _ in range(round(seconds / (STEP * WINDOW))):

            def motion(vx: Array, grade: Array) -> tuple[Array, Array]:
                omega = car.engine_speed(vx, gear)
                # Steps after the end and early iterations may leave the engine's range.
                torque = true_torque(np.clip(omega, 0.5 * SLOWEST, OMEGA_MAX), throttle)
                return car.acceleration(torque, vx, gear, grade) - slowed, omega

            self._advance(WINDOW, motion, throttle, brake, gear, until)
            if not until[0] < self.omega < until[1]:
                return

    def shift(self, gear: int, throttle: float) -> None:
        """Open the clutch for 0.2 s, then let it slip less and less for 0.6 s."""
        car = replace(self.car, engine_inertia=0.0)  # the engine is decoupled from the wheels
        start, arrival = self.omega, float(self.car.engine_speed(self.vx, gear))
        running = start + 0.7 * (arrival - start) * np.linspace(0.2, 1, 5)

        def opened(vx: Array, grade: Array) -> tuple[Array, Array]:
            return car.acceleration(0.0, vx, gear, grade), running

        self._advance(5, opened, 0.0, 0.0, 0)
        slip = (self.omega - float(car.engine_speed(self.vx, gear))) * np.exp(
            -STEP / 0.1 * np.arange(1, 16)
        )

        def slipping(vx: Array, grade: Array) -> tuple[Array, Array]:
            omega = car.engine_speed(vx, gear) + slip
            clutch = true_torque(omega, throttle) + self.car.engine_inertia * slip / 0.1
            return car.acceleration(clutch, vx, gear, grade), omega

        self._advance(15, slipping, throttle, 0.0, gear)
        self.gear = gear

    def _advance(
        self,
        steps: int,
        motion: Callable[[Array, Array], tuple[Array, Array]],
        throttle: float,
        brake: float,
        gear: int,
        until: tuple[float, float] = (-np.inf, np.inf),
    ) -> None:
        """Euler steps of v' = ax, all at once: ax is iterated until it agrees with the speeds.

        `motion` gives ax [m/s^2] and the engine speed [rad/s] from vx and the grade.
        """
        ax = np.zeros(steps + 1)
        for _ in range(steps + 1):  # each pass settles at least one more step
            vx = self.vx + STEP * np.concatenate([[0.0], np.cumsum(ax[:-1])])
            distance = self.distance + STEP * np.concatenate([[0.0], np.cumsum(vx[:-1])])
            grade = 0.015 * np.sin(2 * np.pi * distance / 800)
            before = ax[:-1]
            now, omega = motion(vx[:-1], grade[:-1])
            ax = np.append(now, 0.0)
            if np.abs(now - before).max() < 1e-9:
                break
        outside = np.flatnonzero((omega <= until[0]) | (omega >= until[1]))
        n = int(outside[0]) + 1 if outside.size else steps
        felt = ax + g * np.sin(grade)
        held = (np.full(n, value) for value in (throttle, brake))
        self.rows.append(
            np.stack([vx[:n], felt[:n], np.full(n, gear), omega[:n], *held, grade[:n]])
        )
        self.vx, self.distance, self.omega = float(vx[n]), float(distance[n]), float(omega[n - 1])


CHANNELS = ("vx", "ax", "gear", "engine_speed", "throttle", "brake", "grade")
NOISE = (0.03, 0.15, 0.0, 2.0, 0.001, 2e3, 5e-4)
"""Standard deviations of the channels' noise, in their units."""


def engine_driving_log(seed: int = 0) -> DrivingLog:
    """A drive of `CAR` at 25 Hz with held throttles of 5, 15, 20 and 30 % in gears 2 to 4.

    In each gear the driver shifts up at full throttle to 6800 rpm, holds the opening while the
    engine slows down, brakes to 1300 rpm, and holds it again while the engine speeds up (or not).
    Every opening thus meets nearly all engine speeds, on both sides of its equilibrium. The
    accelerometer includes the grade.

    Parameters
    ----------
    seed : int
        Seed of the channels' noise.

    Returns
    -------
    DrivingLog
        The drive.
    """
    whole("seed", seed, 0)
    truth = _true_channels()
    rng = np.random.default_rng(seed)
    noisy = truth + np.array(NOISE)[:, None] * rng.standard_normal(truth.shape)
    channels = dict(zip(CHANNELS, noisy, strict=True))
    return DrivingLog("engine", {"time": STEP * np.arange(truth.shape[1])} | channels)


@cache
def _true_channels() -> Array:
    """The channels (7, N) without noise; the drive takes a second to compute."""
    drive = _Drive(CAR)
    for throttle in HELD_THROTTLES:
        for gear in HELD_GEARS:
            while drive.gear > 1 and drive.gear >= gear:
                drive.shift(drive.gear - 1, 0.0)
            drive.locked(1.0, 60.0, until=(0.0, FASTEST))
            while drive.gear < gear:
                drive.shift(drive.gear + 1, 1.0)
                drive.locked(1.0, 60.0, until=(0.0, FASTEST))
            drive.locked(throttle, 20.0, until=(SLOWEST, OMEGA_MAX))
            drive.locked(0.0, 60.0, until=(SLOWEST, OMEGA_MAX), brake=2e6)
            drive.locked(throttle, 8.0, until=(SLOWEST - 100 * RPM, OMEGA_MAX))
    channels = np.concatenate(drive.rows, axis=1)
    channels.flags.writeable = False
    return channels


def load_engine_drive(throttle: float, seed: int = 0) -> Dataset:
    """Torque samples at a held opening of `engine_driving_log`.

    Parameters
    ----------
    throttle : {0.05, 0.15, 0.2, 0.3}
        The opening.
    seed : int
        Seed of the noise.

    Returns
    -------
    Dataset
        Columns omega [rad/s], throttle [-] and the output torque [Nm], named "torque_" and the
        opening in percent.

    Raises
    ------
    ValueError
        For another opening.
    """
    if throttle not in HELD_THROTTLES:
        raise ValueError(f"throttle is {throttle}; expected one of {HELD_THROTTLES}")
    samples = torque_samples(engine_driving_log(seed), CAR, throttle=throttle)
    return replace(samples, name=f"torque_{round(100 * throttle):02d}")
