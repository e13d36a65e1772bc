"""A lap in which the grip falls: by the offline value, by a tracker, and by an oracle.

One lap of the flat Las Vegas Motor Speedway, planned with a share of the grip that leaves the tires
close to their limit. In the middle of the lap the friction falls within 0.2 s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from omegaconf import DictConfig

from experiments.driving.car import known_car
from experiments.driving.settings import track_and_vehicle
from experiments.driving.tracked_friction import (
    PERIOD,
    FrontAxle,
    TrackedFriction,
    axle_use,
    front_rows,
)
from miho.fitting.one_fit import fit
from miho.identification.report import Report
from miho.online import TrackerSettings
from miho.vehicle.driving.double_track import FrictionSchedule
from miho.vehicle.driving.driver import Driver
from miho.vehicle.driving.embedded import embedded_plant
from miho.vehicle.driving.known_car import KnownCar
from miho.vehicle.driving.learning_driver import FrictionSource, LearningDriver
from miho.vehicle.driving.path_tracking import Weights
from miho.vehicle.driving.plant import Motion
from miho.vehicle.driving.road import road_of
from miho.vehicle.driving.sensors import Sensors
from miho.vehicle.driving.simulation import Drive, simulate
from miho.vehicle.driving.steering_control import SteeringController
from miho.vehicle.driving.track import Track
from miho.vehicle.driving.velocity_planner import VelocityPlanner

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
TRACKER = TrackerSettings(use=0.02)
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
        """Return a source of friction by TRACKER, which tracks the front grip."""
        problem = replace(report.problem, sigma=report.at.noise)  # although errors are correlated
        running = TRACKER.start(problem, report, {"front_grip": 0.35}, NOISE, PERIOD)
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
