"""The node `drive` of a configuration: road, line, vehicle and driver, and the drive."""

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from omegaconf import DictConfig, OmegaConf

from experiments.app.explain import BAD_SETTINGS, ConfigError, as_config_error, unknown_message
from experiments.app.schema import RENAMED, DriveConfig
from miho.vehicle.driving import KnownCar, Sensors, Track, Vehicle, ims, lvms, road_of
from miho.vehicle.driving.as_printed import PrintedPlanner, PrintedSteering
from miho.vehicle.driving.driver import Driver, Pace, Sighting, SlowZone
from miho.vehicle.driving.embedded import embedded_plant
from miho.vehicle.driving.lines import beside, constant, track_from_csv
from miho.vehicle.driving.local_plan import LocalPlanner, Obstacle
from miho.vehicle.driving.path_tracking import Weights
from miho.vehicle.driving.simulation import Drive, simulate
from miho.vehicle.driving.speed_control import SpeedSettings
from miho.vehicle.driving.steering_control import SteeringController

OVALS = {"ims": ims, "lvms": lvms}
FACTORS = {
    "performance_factor": "the share of the tires' grip that the plan uses",
    "road_friction": "the friction of the road, relative to the road of the tire measurements",
}
EQUATIONS = ("corrected", "printed", "printed_plan", "printed_steering")
"""All as printed, only Eq. 10-12 with the load transfer, or only Eq. 13-15."""
LEAST_FACTOR, LARGEST_FACTOR = 0.05, 1.5
"""Wet ice, and tires with half as much grip again as known."""


def track_and_vehicle(cfg: DictConfig) -> tuple[Track, Track, Vehicle]:
    """The road, the driven line, and the vehicle."""
    keys = [field.name for field in fields(DriveConfig)]
    for key in cfg.drive:
        if key not in keys:
            name = f"drive.{key!s}"
            former = f"{name}: {RENAMED[name]}" if name in RENAMED else None
            raise ConfigError(former or unknown_message(name, keys))
    if not cfg.drive.track or not cfg.drive.vehicle or not cfg.drive.controller:
        raise ConfigError("drive: is incomplete; choose experiment=ims_obstacle or lvms_laps")
    if cfg.drive.figure not in ("fig7", "fig8"):
        raise ConfigError(f"drive.figure: is {cfg.drive.figure!r}; expected fig7 or fig8")
    if cfg.drive.equations not in EQUATIONS:
        raise ConfigError(
            f"drive.equations: is {cfg.drive.equations!r}; expected one of {', '.join(EQUATIONS)}"
        )
    for key, meaning in FACTORS.items():
        if not LEAST_FACTOR <= cfg.drive[key] <= LARGEST_FACTOR:
            raise ConfigError(
                f"drive.{key}: is {cfg.drive[key]:g}; expected {LEAST_FACTOR:g} to "
                f"{LARGEST_FACTOR:g}, {meaning}"
            )
    with as_config_error("drive", BAD_SETTINGS):
        vehicle = Vehicle.from_settings(_mapping(cfg.drive.vehicle))
        settings = _mapping(cfg.drive.track)
        name, offset = settings.pop("name", None), settings.pop("offset", 0.0)
        if name in OVALS:
            road = OVALS[name](**settings)
        elif name == "csv":
            road = track_from_csv(**settings)
        else:
            raise ConfigError(f"drive.track.name: is {name!r}; expected ims, lvms or csv")
        line = road if offset == 0 else beside(road, constant(float(offset)))
    return road, line, vehicle


def driver_of(cfg: DictConfig, car: KnownCar, line: Track) -> Driver:
    """Driver that `drive` describes, for a line and a known car."""
    settings = _mapping(cfg.drive.controller)
    weights, period = Weights(**settings["weights"]), settings["period"]
    mu, top_speed = cfg.drive.performance_factor, cfg.drive.top_speed
    live = None
    if cfg.drive.equations in ("printed", "printed_plan"):
        live = PrintedPlanner(car.vehicle, car.grip, mu, top_speed)
    corrected = replace(car.planner(mu, top_speed), reserve=cfg.drive.reserve)
    planner = corrected if live is None else live
    steering: SteeringController | PrintedSteering
    if cfg.drive.equations in ("printed", "printed_steering"):
        steering = PrintedSteering.of(car.vehicle, car.front, car.rear, weights, period)
    else:
        steering = car.steering_controller(weights, period)
    speed = car.speed_controller(SpeedSettings(**settings["speed"]))
    tops = tuple(cfg.drive.top_speeds) or (cfg.drive.top_speed,) * bool(cfg.drive.slow)
    slow = tuple(SlowZone(zone.start, zone.end, zone.top_speed) for zone in cfg.drive.slow)
    pace = Pace(tops, cfg.drive.ramp, cfg.drive.brake_ramp, slow) if tops else None
    box = cfg.drive.obstacle
    sighting = None
    if box.sight is not None:
        obstacle = Obstacle(s=box.s, e=box.e, length=box.length, width=box.width)
        local = LocalPlanner(out=box.out, back=box.back)
        sighting = Sighting((obstacle,), box.sight, local, planner)
    return Driver(planner.plan(line), speed, steering, pace, sighting, live)


def driven(
    cfg: DictConfig,
    driver: Driver,
    road: Track,
    line: Track,
    watch: Callable[[float], object] | None = None,
) -> Drive:
    """Simulate the drive that `drive` describes, from its arc length and speed on a line."""
    plant = embedded_plant(driver.speed.vehicle, road_of(road, cfg.drive.road_friction))
    gear = driver.speed.start(cfg.drive.speed).gear
    at = road.project(*map(float, line.position(cfg.drive.start)))
    start = plant.start(at.s, at.e, cfg.drive.speed, gear)
    sensors = Sensors() if cfg.drive.noise else None
    rng = np.random.default_rng(cfg.seed)
    return simulate(plant, driver, start, cfg.drive.distance, sensors=sensors, rng=rng, watch=watch)


def factors_text(cfg: DictConfig) -> str:
    """Text for figures: the two factors of `drive`, its reserve, and its equations if printed."""
    reserve = f" with a reserve of {cfg.drive.reserve:g}" if cfg.drive.reserve else ""
    text = (
        f"performance factor {cfg.drive.performance_factor:g}{reserve}, "
        f"road friction {cfg.drive.road_friction:g}"
    )
    equations = cfg.drive.equations
    return text if equations == "corrected" else f"{text}, equations: {equations}"


def _mapping(node: DictConfig) -> dict[str, Any]:
    plain = OmegaConf.to_container(node, resolve=True)
    if not isinstance(plain, Mapping):
        raise ConfigError(f"{node!r} is not a mapping; give settings by name")
    return {str(key): value for key, value in plain.items()}
