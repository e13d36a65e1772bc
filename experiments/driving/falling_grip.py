"""A lap in which the grip falls: by the offline value, by a tracker, and by an oracle.

One lap of the flat Las Vegas Motor Speedway, planned with a share of the grip that leaves the tires
close to their limit. In the middle of the lap the friction falls within 0.2 s.

The tracker follows it from the slip and the force of the front axle. Its model is the Magic Formula
of the lateral force per load, in which a change of the friction scales the peak and leaves the
cornering stiffness.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from omegaconf import DictConfig

from experiments.driving.car import known_car
from experiments.driving.outcome import true_use
from experiments.driving.settings import track_and_vehicle
from miho.analysis import save
from miho.analysis.compare.bootstrap import mean_error
from miho.analysis.figures.tracking import grip_figure
from miho.fitting.one_fit import fit
from miho.identification.report import Report
from miho.online import Running, TrackerSettings, TrackerState
from miho.quantities import Array, g
from miho.vehicle.driving import Drive, Driver, LearningDriver, Motion, Track, Vehicle, simulate
from miho.vehicle.driving.double_track import FrictionSchedule
from miho.vehicle.driving.embedded import embedded_plant
from miho.vehicle.driving.friction import demand
from miho.vehicle.driving.known_car import KnownCar
from miho.vehicle.driving.learning_driver import FrictionSource
from miho.vehicle.driving.path_tracking import Weights
from miho.vehicle.driving.plant import Sensors
from miho.vehicle.driving.road import road_of
from miho.vehicle.driving.steering_control import SteeringController
from miho.vehicle.driving.velocity_planner import VelocityPlanner

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


LEARNED_AT = 0.8
"""Share of the grip that the earlier lap uses, from which the offline report is."""
MIDDLE = (0.4, 0.6)
"""Part of the planned time of the lap in which the grip falls."""
NOISE = MappingProxyType({"slip": 0.00075})
"""Standard deviation of the noise of a row's slip angle [rad], of `Sensors` at 60 m/s."""
RESERVE = 0.2
"""Reserve of the driver with a tracker at the entry of a turn [-]. With the fall at 21.9 s, at the
end of the front arc, it finishes 5 of 5 laps (seeds 105, 108, 111, 113 and 132), 4 with 0.15 and
none with 0.1."""
SETTINGS = TrackerSettings(use=0.02)
"""A row of the front arc, with half of the grip in use, also teaches. On seeds 100 to 111 the alarm
came after 1.8 s, and after 3.5 s with 0.1 (medians, before the driver had a reserve)."""


class Constant(FrictionSource):
    """A friction that does not follow the road: the offline value 1, or a cautious one."""

    def __init__(self, value: float = 1.0) -> None:
        self.value = value

    def friction(self, motion: Motion, curvature: float, bank: float) -> float:
        """See `FrictionSource.friction`."""
        return self.value


class Oracle(FrictionSource):
    """The true friction at each time."""

    def __init__(self, schedule: FrictionSchedule) -> None:
        self.schedule = schedule

    def friction(self, motion: Motion, curvature: float, bank: float) -> float:
        """See `FrictionSource.friction`."""
        return self.schedule.at(motion.time)


@dataclass(frozen=True, eq=False)
class FallingGrip:
    """Laps of a known car on a line, in which the friction falls by `fall`."""

    car: KnownCar
    line: Track
    share: float = 0.7
    top_speed: float = 80.0
    fall: float = 0.3

    @classmethod
    def of(cls, cfg: DictConfig) -> FallingGrip:
        """Return the laps that `drive` describes."""
        _, line, vehicle = track_and_vehicle(cfg)
        car, _ = known_car(cfg, vehicle)
        return cls(car, line, cfg.drive.performance_factor, cfg.drive.top_speed)

    def schedule(self, seed: int) -> FrictionSchedule:
        """Friction of a seed, which draws the time of the fall."""
        time = self.driver().plan.lap_time
        at = np.random.default_rng([seed, 2]).uniform(*MIDDLE) * time
        return FrictionSchedule.drop(float(at), self.fall)

    def driver(self, planner: VelocityPlanner | None = None) -> Driver:
        """Driver for a friction of 1."""
        plan = (self._planner(self.share) if planner is None else planner).plan(self.line)
        return Driver(plan, self.car.speed_controller(), self._steering)

    def earlier(self, seed: int) -> Report:
        """Report of the front axle from a lap without a fall, with other noise."""
        drive = self._drive(self.driver(self._planner(LEARNED_AT)), None, seed + 1000)
        rows = front_rows(self.car.vehicle, drive)
        known = {name: column[np.isfinite(rows["use"])] for name, column in rows.items()}
        sensitivity = float(np.mean(self.car.grip.lateral_sensitivity[:2]))
        space = {"front_grip": (0.2, 4.0), "stiffness": (5.0, 80.0), "shift": (-0.02, 0.02)}
        return fit(
            axle_use, known, "use", space,
            fixed={"shape": 1.5, "sensitivity": sensitivity},
        ).report()  # fmt: skip

    def lap(self, seed: int, source: FrictionSource, reserve: float = 0.0) -> Drive:
        """Return the lap of a driver that takes the friction from a source.

        reserve is the share of the friction that it keeps at the entry of a turn [-].
        """
        planner = replace(self._planner(self.share), entry_reserve=reserve)
        learning = LearningDriver(self.driver(planner), planner, source)
        return self._drive(learning, self.schedule(seed), seed)

    def tracked(self, report: Report) -> TrackedFriction:
        """Return a source of friction by SETTINGS, which tracks the front grip."""
        problem = replace(report.problem, sigma=report.at.noise)  # although errors are correlated
        running = SETTINGS.start(problem, report, {"front_grip": 0.35}, NOISE, PERIOD)
        place = report.problem.space.names.index("front_grip")
        return TrackedFriction(FrontAxle(self.car.vehicle), running, float(report.at.theta[place]))

    @cached_property
    def _steering(self) -> SteeringController:
        """Steering for a friction of 1, once for all laps, because its gains take a second."""
        return self.car.steering_controller(Weights(steering=100.0))

    def _planner(self, share: float) -> VelocityPlanner:
        return self.car.planner(share, self.top_speed)

    def _drive(
        self, driver: Driver | LearningDriver, schedule: FrictionSchedule | None, seed: int
    ) -> Drive:
        plant = replace(embedded_plant(self.car.vehicle, road_of(self.line)), friction=schedule)
        speed, _ = driver.plan.at(0.0)
        gear = self.car.speed_controller().start(speed).gear
        start = plant.start(0.0, 0.0, speed, gear)
        rng = np.random.default_rng([seed, 1])
        return simulate(plant, driver, start, self.line.length, sensors=Sensors(), rng=rng)


BLIND, TRACKER, ORACLE, CAUTIOUS = (
    "the offline value", "the tracker", "the oracle", "the offline value less 30 %",
)  # fmt: skip


def row(seed: int, name: str, drive: Drive) -> dict[str, Any]:
    """Results of a lap: lap_time [s], NaN if the car stopped, and the largest offset [m]."""
    time = float("nan") if drive.stopped else float(drive["time"][-1])
    offset = float(np.abs(drive["e_y"]).max())
    return {"seed": seed, "knows": name, "lap_time": time, "offset": offset}


def detection(tracked: TrackedFriction, schedule: FrictionSchedule) -> dict[str, Any]:
    """Delay [s] of the first alarm after the fall, its words, alarms before it, and coverage."""
    time = np.array([state.time for state in tracked.states])
    ends = np.array([state.intervals()[0] for state in tracked.states]) / tracked.before
    truth = np.array([schedule.at(at) for at in time])
    alarms = [state.alarm for state in tracked.states if state.alarm is not None]
    after = [alarm for alarm in alarms if alarm.time >= schedule.time[0]]
    inside = (ends[:, 0] <= truth) & (truth <= ends[:, 1])
    return {
        "alarm_delay": after[0].time - schedule.time[0] if after else float("nan"),
        "alarm": str(after[0]) if after else "",
        "false_alarms": len(alarms) - len(after),
        "coverage": float(inside.mean()),
    }


def table(rows: pd.DataFrame, rng: np.random.Generator) -> str:
    """Laps finished, and lap time with its 95 % interval, for each knowledge of the grip."""
    lines = []
    for name, group in rows.groupby("knows", sort=False):
        times = group["lap_time"].dropna().to_numpy()
        text = "-"
        if times.size:
            mean = mean_error(times, rng)
            text = f"{mean.estimate:.2f} [{mean.low:.2f}, {mean.high:.2f}]"
        finished = f"{times.size} of {len(group)}"
        lines.append({"the controllers know": name, "finished": finished, "lap time [s]": text})
    of = rows.pivot(index="seed", columns="knows", values="lap_time")
    lost, most = of[TRACKER] - of[ORACLE], of[CAUTIOUS] - of[ORACLE]
    tracked = rows[rows["knows"] == TRACKER]
    return "\n".join([
        pd.DataFrame(lines).to_string(index=False),
        f"loss against the oracle: {lost.mean():.2f} s by the tracker, {most.mean():.2f} s by "
        f"{CAUTIOUS}",
        f"alarm after {tracked['alarm_delay'].median():.2f} s in the median, at most "
        f"{tracked['alarm_delay'].max():.2f} s; {tracked['false_alarms'].sum():.0f} alarms before",
    ])  # fmt: skip


def draw(
    root: Path, laps: FallingGrip, drives: dict[str, Drive], tracked: TrackedFriction,
    schedule: FrictionSchedule,
) -> None:  # fmt: skip
    """Draw the first seed."""
    states = pd.DataFrame(
        [
            {
                "time": state.time,
                "front_grip": state.theta[0] / tracked.before,
                "front_grip_low": state.intervals()[0, 0] / tracked.before,
                "front_grip_high": state.intervals()[0, 1] / tracked.before,
                "front_grip_true": schedule.at(state.time),
            }
            for state in tracked.states
        ]
    )
    alarms = {s.alarm.time: str(s.alarm).replace("_", " ") for s in tracked.states if s.alarm}
    driver, logs, lost = laps.driver(), {}, []
    for name, drive in drives.items():
        friction = np.array([schedule.at(at) for at in drive["time"]])
        log = pd.DataFrame(
            {
                "time": drive["time"],
                "vx": np.hypot(drive["vx"], drive["vy"]),
                "use": true_use(drive, driver) / friction,
            }
        )
        gone = np.abs(drive["e_y"]) > 10 if drive.stopped else np.zeros(len(drive), dtype=bool)
        logs[name] = log[~np.maximum.accumulate(gone)]
        if gone.any():
            lost.append(f"{name}: the car leaves its line by 10 m in the next turn, where"
                        " its curve ends")  # fmt: skip
    save(
        grip_figure(states, logs, alarms, schedule.time[0], note="; ".join(lost)),
        root / "figures" / "grip_falls",
    )
