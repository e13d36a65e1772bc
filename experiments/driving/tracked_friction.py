"""The friction of the road from the slip and the force of the front axle, by an online method.

The model of the axle is the Magic Formula of the lateral force per load, in which a change of the
friction scales the peak and leaves the cornering stiffness.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from miho.online import Running, TrackerState
from miho.quantities import Array, g
from miho.vehicle.driving import Drive, FrictionSource, Motion, Vehicle
from miho.vehicle.driving.friction import demand

MEAN = 4
"""Commands whose mean is a row, which is then at 25 Hz; noise of the slip angle averages out."""
PERIOD = 0.01 * MEAN
"""Time between two rows at 100 commands a second [s]."""
SMOOTHED = 5
"""Commands over which the yaw acceleration is a difference of the yaw rate."""
BRAKING = 2e5
"""Brake pressure [Pa] from which a row has no force, because the tires also brake."""
SLOWEST = 15.0
"""Speed [m/s] below which a row has no force."""
COLUMNS = {"slip": "rad", "load": "-", "use": "-"}
"""Columns of a row, with their units: slip angle, load relative to rest, and force per load."""


def axle_use(  # type: ignore[no-untyped-def]
    slip, load, *, front_grip, stiffness, shape, shift, sensitivity=0.0
):
    """Lateral force of an axle per load [-], positive to the left (ISO-W: at negative slip angles).

    slip is the slip angle [rad], and load the load relative to rest [-]. The parameters are the
    largest force per load at rest [-], the cornering stiffness per load [1/rad], C of the Magic
    Formula [-], the slip angle without a force [rad], and the relative change of the grip over a
    relative change of the load [-].
    """
    peak = front_grip * (1 + sensitivity * (load - 1))
    return -peak * np.sin(shape * np.arctan(stiffness * (slip - shift) / (shape * peak)))


class FrontAxle:
    """Rows of the front axle from measured motions, one each period [s]."""

    def __init__(self, vehicle: Vehicle, period: float = 0.01) -> None:
        self.vehicle, self.period = vehicle, period
        self._yaw_rates: deque[float] = deque(maxlen=SMOOTHED + 1)
        self._waiting: list[list[float]] = []

    def row(self, motion: Motion, curvature: float, bank: float) -> dict[str, float] | None:
        """Take a motion, and return a row after each `MEAN` motions.

        A row has the time [s] and the columns of `COLUMNS`, as means of the motions since the last
        row. Its force is NaN while it is not known. Curvature [1/m] and bank [rad] are of the line
        at the car.
        """
        car, vx = self.vehicle, max(motion.vx, 1.0)
        self._yaw_rates.append(motion.yaw_rate)
        turning = self._yaw_rates[-1] - self._yaw_rates[0]
        turning /= max(len(self._yaw_rates) - 1, 1) * self.period
        force = (car.mass * motion.ay * car.lr + car.Izz * turning) / car.wheelbase
        _, gravity = demand(vx, curvature, bank)
        rest = car.mass * car.lr / car.wheelbase  # of the mass
        pitch = car.mass * motion.ax * car.h_cg / car.wheelbase
        load = rest * float(gravity) + car.C_l_front * vx * vx - pitch
        slip = (motion.vy + car.lf * motion.yaw_rate) / vx - motion.steering
        known = motion.vx > SLOWEST and motion.brake_pressure < BRAKING
        use = force / load if known else math.nan
        self._waiting.append([motion.time, slip, load / (rest * g), use])
        if len(self._waiting) < MEAN:
            return None
        means = np.mean(self._waiting, axis=0)
        self._waiting.clear()
        return dict(zip(("time", *COLUMNS), means.tolist(), strict=True))


class TrackedFriction(FrictionSource):
    """Friction of the road relative to the known car, from a method that tracks the front grip.

    The method runs on rows of the axle with the model `axle_use`; `before` is the front grip of the
    known car [-].
    """

    def __init__(self, axle: FrontAxle, running: Running, before: float) -> None:
        self.axle, self.running, self.before = axle, running, before
        self.states: list[TrackerState] = []

    def friction(self, motion: Motion, curvature: float, bank: float) -> float:
        """See `FrictionSource.friction`."""
        row = self.axle.row(motion, curvature, bank)
        if row is not None:
            self.states.append(self.running.update(row))
        if not self.states:
            return 1.0
        return self.states[-1].values["front_grip"] / self.before


def front_rows(vehicle: Vehicle, drive: Drive) -> dict[str, Array]:
    """Return rows of the front axle, time [s] and `COLUMNS`, of a drive with 100 commands a second.

    The columns are (n,).
    """
    axle = FrontAxle(vehicle)
    names = ("time", "vx", "vy", "yaw_rate", "ax", "ay", "steering")
    columns = {name: drive.measured[name] for name in names}
    columns |= {"brake_pressure": drive.measured["brake"]}
    blank = Motion(*np.zeros(len(Motion._fields)))
    rows = []
    for k in range(len(drive)):
        values: dict[str, Any] = {name: float(column[k]) for name, column in columns.items()}
        motion = blank._replace(**values)
        row = axle.row(motion, float(drive["curvature"][k]), float(drive["bank"][k]))
        if row is not None:
            rows.append(row)
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}
