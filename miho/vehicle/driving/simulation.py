"""Closed-loop simulation of a plant with its driver, and its log."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from miho.quantities import Array
from miho.validate import positive
from miho.vehicle.data.driving_log import DrivingLog
from miho.vehicle.driving.driver import Driver, DriverState, place
from miho.vehicle.driving.learning_driver import LearningDriver
from miho.vehicle.driving.plant import Command, Motion, Plant, Sensors, channels_of

State = TypeVar("State")

MOTION = (
    "time", "x", "y", "yaw", "vx", "vy", "yaw_rate", "ax", "ay", "steering", "engine_speed",
    "engine_torque", "gear", "brake_pressure",
)  # fmt: skip
LOGGED = (
    *MOTION, "load_fl", "load_fr", "load_rl", "load_rr", "distance", "s", "e_y", "e_psi",
    "curvature", "bank", "v_plan", "v_des", "ay_plan", "ay_limit", "u_steering", "u_throttle",
    "u_brake", "u_gear", "stopping",
)  # fmt: skip
STANDING = 0.3
"""Speed [m/s] below which a car counts as stopped."""


@dataclass(frozen=True, eq=False)
class Drive:
    """Log of a drive, with a row for each command.

    Attributes
    ----------
    columns : Mapping[str, ndarray]
        Columns (N,) without noise, in SI units. time, x, y, yaw, vx, vy, yaw_rate, ax, ay,
        steering, engine_speed, engine_torque, gear and brake_pressure are as in `Motion`;
        load_fl, load_fr, load_rl, load_rr are wheel loads [N]; distance [m] is along the first
        line since the start. s [m], e_y [m], e_psi [rad], curvature [1/m] and bank [rad] refer to
        the line of the plan; v_plan [m/s], ay_plan and ay_limit [m/s^2] are its speed, lateral
        demand and limit of the demand. v_des [m/s] is the desired speed. u_steering [rad],
        u_throttle, u_brake [Pa] and u_gear are commands. stopping is 1 during a safe stop.
    measured : Mapping[str, ndarray]
        Measured channels of a `DrivingLog`.
    stopped : str
        Reason of a safe stop or of an end before the distance, or "".
    """

    columns: Mapping[str, Array]
    measured: Mapping[str, Array]
    stopped: str

    def __getitem__(self, name: str) -> Array:
        """Return a column by its name, (N,)."""
        return self.columns[name]

    def __len__(self) -> int:
        return self.columns["time"].size

    def log(self, name: str) -> DrivingLog:
        """Return the measurements as data for identification, without bank and grade."""
        return DrivingLog(name, self.measured)


def simulate(
    plant: Plant[State],
    driver: Driver | LearningDriver,
    start: State,
    distance: float,
    *,
    sensors: Sensors | None = None,
    rng: np.random.Generator | None = None,
    longest: float = 1200.0,
    watch: Callable[[float], object] | None = None,
) -> Drive:
    """Simulate a drive along the line of the driver's plan.

    The drive ends at the distance, at the time limit, or at rest after a safe stop.

    Parameters
    ----------
    plant : Plant
        The simulated car.
    driver : Driver or LearningDriver
        The driver.
    start : State
        Initial state of the plant.
    distance : float
        Distance along the line [m].
    sensors : Sensors, optional
        Noise of the measurements; by default there is none.
    rng : numpy.random.Generator, optional
        Random numbers of the noise, required with `sensors`.
    longest : float, optional
        Time limit [s].
    watch : callable, optional
        Function that is called with the distance so far [m] after each command.

    Returns
    -------
    Drive
        The log.

    Raises
    ------
    ValueError
        If `rng` is missing, or if the distance is not positive.
    """
    if sensors is not None and rng is None:
        raise ValueError("rng is None; give a numpy Generator for the noise of the sensors")
    positive("distance", distance, "of metres")
    state, motion = start, plant.motion(start)
    memory, line = driver.begin(motion), driver.plan.line
    rows: list[list[float]] = []
    measurements: list[Motion] = []
    commands: list[Command] = []
    driven, before = 0.0, memory.at
    while driven < distance and motion.time < longest:
        measured = motion if sensors is None or rng is None else sensors.measure(motion, rng)
        command, memory = driver.step(memory, measured)
        rows.append(_row(motion, memory, driven))
        measurements.append(measured)
        commands.append(command)
        state = plant.advance(state, command, driver.period)
        motion = plant.motion(state)
        at = line.project(motion.x, motion.y, before).s
        driven += math.remainder(at - before, line.length)
        before = at
        if watch is not None:
            watch(driven)
        if memory.stopped and math.hypot(motion.vx, motion.vy) < STANDING:
            break
    columns = dict(zip(LOGGED, np.array(rows).T, strict=True))
    stopped = memory.stopped
    if not stopped and driven < distance:
        stopped = f"at the time limit of {longest:g} s, after {driven:.0f} of {distance:g} m"
    return Drive(columns, channels_of(measurements, commands), stopped)


def _row(motion: Motion, memory: DriverState, driven: float) -> list[float]:
    """Return one row of the columns `LOGGED`."""
    plan = memory.plan
    at, error = place(plan.line, motion, memory.at)
    point = plan.line.at(at.s)
    i = min(int(at.s / plan.line.step), plan.v.size - 1)
    moving = [float(getattr(motion, name)) for name in MOTION]
    planned = [plan.v[i], memory.desired, plan.lateral[i], plan.limit[i]]
    return [
        *moving, *motion.loads, driven, at.s, error.e_y, error.e_psi, float(point.curvature),
        float(point.bank), *planned, *memory.command, float(bool(memory.stopped)),
    ]  # fmt: skip
