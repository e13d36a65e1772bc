"""Results of a drive: errors, limits, clearance, and plans of the printed equations."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from miho.vehicle.driving import Drive, Driver, Track
from miho.vehicle.driving.as_printed import PrintedPlanner
from miho.vehicle.driving.embedded import embedded_tires
from miho.vehicle.driving.friction import FrictionCar, demand, friction_car, measured_use
from miho.vehicle.driving.grip import Grip
from miho.vehicle.driving.known_car import inclinations, static_loads
from miho.vehicle.driving.local_plan import NoPathError
from miho.vehicle.driving.velocity_planner import VelocityPlanner, front_share

CAR_LENGTH, CAR_WIDTH = 4.9, 1.93
"""Size of the AV-21 [m]."""
EVERY = 5
"""Step of the rows that are projected on the road; at 100 Hz they are about 3 m apart."""


class Clearance(NamedTuple):
    """Distances [m] of the car's sides from the left and the right edge of the road, (k,) each.

    Distances are negative outside the road. `rows` are the rows of the drive.
    """

    rows: np.ndarray
    left: np.ndarray
    right: np.ndarray

    @classmethod
    def of(cls, drive: Drive, road: Track) -> Clearance:
        """Return the clearance of a car along a drive on the road of the plant."""
        rows = np.arange(0, len(drive), EVERY)
        edges, hint = np.empty((2, rows.size)), None
        for i, (x, y) in enumerate(zip(drive["x"][rows], drive["y"][rows], strict=True)):
            at = road.project(float(x), float(y), hint)
            hint = at.s
            point = road.at(at.s)
            edges[:, i] = float(point.width_left) - at.e, float(point.width_right) + at.e
        left, right = edges - CAR_WIDTH / 2
        return cls(rows, left, right)

    @property
    def least(self) -> np.ndarray:
        """Distance to the nearer edge [m], (k,)."""
        return np.asarray(np.minimum(self.left, self.right))


class Departure(NamedTuple):
    """Departure of a car from its road.

    time [s] and distance [m] at which a side of the car first crossed an edge, the side of the
    road, and the largest distance outside the edge [m].
    """

    time: float
    distance: float
    side: str
    beyond: float

    def __str__(self) -> str:
        return (
            f"on the {self.side}, after {self.distance:.0f} m and {self.time:.1f} s, by up to "
            f"{self.beyond:.1f} m"
        )


def departure(drive: Drive, clearance: Clearance) -> Departure | None:
    """Return the departure of the car from the road, None if it stayed on the road."""
    outside = np.flatnonzero(clearance.least < 0)
    if not outside.size:
        return None
    first = outside[0]
    row = clearance.rows[first]
    return Departure(
        float(drive["time"][row] - drive["time"][0]),
        float(drive["distance"][row]),
        "left" if clearance.left[first] < clearance.right[first] else "right",
        -float(clearance.least.min()),
    )


def outcome_table(
    drive: Drive, driver: Driver, clearance: Clearance, road_friction: float = 1.0
) -> dict[str, float | str]:
    """Return the largest errors and uses of a drive on a road with this friction, by name."""
    e_psi = float(np.degrees(np.abs(drive["e_psi"]).max()))
    error, use = drive["vx"] - drive["v_des"], planned_use(drive, driver)
    table: dict[str, float | str] = {
        "stopped": drive.stopped or "no",
        "left the road": str(departure(drive, clearance) or "no"),
        "time [s]": _round(drive["time"][-1]),
        "top speed [km/h]": _round(3.6 * drive["vx"].max()),
        "largest position error [m]": _round(np.abs(drive["e_y"]).max()),
        "largest heading error [deg]": _round(e_psi),
        "velocity error, RMS [m/s]": _round(math.sqrt(float(np.mean(error**2)))),
        "velocity error, largest [m/s]": _round(np.abs(error).max()),
        "largest lateral acceleration [m/s^2]": _round(np.abs(drive["ay"]).max()),
        "largest steering command, road wheels [deg]": _round(
            np.degrees(np.abs(drive["u_steering"]).max())
        ),
        "largest use of the planned friction": _round(use.max()),
        "beyond the planned friction": str(excess(drive, use) or "no"),
        "largest use of the true tires' friction": _round(
            true_use(drive, driver, road_friction).max()
        ),
        "least room to an edge of the road [m]": _round(clearance.least.min()),
    }
    if driver.sighting is not None:
        table["least gap to the obstacle [m]"] = _round(gap(drive, driver))
    return table


class Excess(NamedTuple):
    """Use of more than the planned friction.

    Total duration [s], time [s] and distance [m] of the first excess, and the largest use [-].
    """

    duration: float
    time: float
    distance: float
    largest: float

    def __str__(self) -> str:
        return (
            f"for {self.duration:.2f} s, first after {self.distance:.0f} m and {self.time:.1f} s, "
            f"by up to {100 * (self.largest - 1):.0f} %"
        )


def excess(drive: Drive, use: np.ndarray) -> Excess | None:
    """Return the excess of a use of friction (N,) above 1, None if there is none."""
    beyond = np.flatnonzero(use > 1)
    if not beyond.size:
        return None
    first, time = beyond[0], drive["time"]
    return Excess(
        float(np.gradient(time)[beyond].sum()),
        float(time[first] - time[0]),
        float(drive["distance"][first]),
        float(use.max()),
    )


def planned_use(drive: Drive, driver: Driver) -> np.ndarray:
    """Return the quasi-static use of the planned friction by the driven motion, (N,).

    Above 1, the car exceeds the performance factor of Eq. 10, by the identified tires.
    """
    return _use(drive, driver.plan.friction)


def true_use(drive: Drive, driver: Driver, road_friction: float = 1.0) -> np.ndarray:
    """Return the quasi-static use of the true tires' friction, (N,); above 1 an axle slides."""
    vehicle = driver.speed.vehicle
    grip = Grip.of_tires(embedded_tires(), static_loads(vehicle), inclinations(vehicle))
    return _use(drive, friction_car(vehicle, grip, road_friction, front_share(driver.speed.brake)))


def _use(drive: Drive, car: FrictionCar) -> np.ndarray:
    _, gravity = demand(drive["vx"], drive["curvature"], drive["bank"])
    return np.asarray(measured_use(car, drive["vx"], drive["ax"], drive["ay"], gravity))


BANDS = (
    ("all", 0.0, math.inf),
    ("up to 144 km/h", 0.0, 40.0),
    ("above 144 km/h", 40.0, math.inf),
    ("151 to 187 km/h", 42.0, 52.0),
)
"""Bands of the driven speed [m/s] that the paper evaluates separately (Sec. V-B.2)."""


def speed_bands(drive: Drive) -> list[dict[str, float | str]]:
    """Return the error of the speed, driven minus desired, in each of `BANDS` that occurs.

    Rows also have the mean throttle, and the share of time above 40 % throttle, for which the
    paper's engine map uses dynamometer data only.
    """
    vx, error, throttle = drive["vx"], drive["vx"] - drive["v_des"], drive["u_throttle"]
    step = np.gradient(drive["time"])
    rows: list[dict[str, float | str]] = []
    for name, low, high in BANDS:
        part = (vx > low) & (vx <= high)
        if not part.any():
            continue
        here = error[part]
        rows.append({
            "band": name,
            "time [s]": _round(step[part].sum()),
            "RMS error [m/s]": _round(math.sqrt(float(np.mean(here**2)))),
            "mean error [m/s]": _round(here.mean()),
            "largest error [m/s]": _round(np.abs(here).max()),
            "mean throttle [%]": _round(100 * throttle[part].mean()),
            "time above 40 % throttle [%]": _round(100 * (throttle[part] > 0.4).mean()),
        })  # fmt: skip
    return rows


def gap(drive: Drive, driver: Driver) -> float:
    """Return the least distance [m] between the boxes of car and obstacle, negative in a collision.

    Boxes are aligned with the line of the plan without the obstacle; the box of the car contains
    the rotated car.
    """
    if driver.sighting is None:
        raise ValueError("the driver has no obstacle; expected a sighting")
    obstacle, line = driver.sighting.obstacles[0], driver.plan.line
    least, hint = math.inf, None
    for x, y, yaw in zip(drive["x"], drive["y"], drive["yaw"], strict=True):
        at = line.project(float(x), float(y), hint)
        hint = at.s
        turn = yaw - float(line.at(at.s).heading)
        cosine, sine = abs(math.cos(turn)), abs(math.sin(turn))
        length = CAR_LENGTH * cosine + CAR_WIDTH * sine
        width = CAR_WIDTH * cosine + CAR_LENGTH * sine
        ahead = abs(math.remainder(at.s - obstacle.s, line.length))
        beside = abs(at.e - obstacle.e) - (width + obstacle.width) / 2
        along = ahead - (length + obstacle.length) / 2
        least = min(least, max(beside, along))
    return least


def plans(driver: Driver, start: float) -> dict[str, float | str]:
    """Return the least speeds [km/h] of the planners on the path around the obstacle.

    start is the arc length of the start of the drive [m]. The avoidance is planned from the point
    at which the obstacle is seen, without top speed and reserve, so only the tires limit it. The
    result is empty if there is no path around the obstacle.
    """
    sighting = driver.sighting
    if sighting is None:
        raise ValueError("the driver has no obstacle; expected a sighting")
    line, obstacle = driver.plan.line, sighting.obstacles[0]
    seen = min((obstacle.s - start) % line.length, sighting.distance)
    sighted = obstacle.s - seen
    try:
        path = sighting.local.path(line, sighting.obstacles, sighted)
    except NoPathError:
        return {}
    since = (path.s - sighted) % path.length
    near = (since > 0) & (since < seen + sighting.distance)
    known, speed = sighting.velocity, driver.speed
    planner = VelocityPlanner(known.vehicle, known.grip, speed.engine, speed.brake, known.mu)
    slowest = {"corrected": planner.lateral_limits(path)[near].min()}
    for name, transfer, yaw in (
        ("as printed", False, True),
        ("as printed, Eq. 11 without yaw term", False, False),
        ("the same with load transfer by a_y", True, False),
    ):
        printed = PrintedPlanner(
            planner.vehicle, planner.grip, planner.mu, transfer=transfer, yaw_term=yaw
        )
        slowest[name] = printed.speeds(path)[near].min()
    ratio = slowest["as printed"] / slowest["as printed, Eq. 11 without yaw term"]
    moved = slowest["the same with load transfer by a_y"]
    cancels = moved / slowest["as printed, Eq. 11 without yaw term"] - 1
    table: dict[str, float | str] = {
        f"least speed of the plan, {name} [km/h]": _round(3.6 * v) for name, v in slowest.items()
    }
    table["printed Eq. 11 over the same without yaw term"] = _round(ratio)
    table["effect of load transfer in Eq. 10 [%]"] = _round(100 * cancels)
    return table


def _round(value: float) -> float:
    """Round to four digits."""
    return float(f"{float(value):.4g}")
