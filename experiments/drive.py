"""Drive the paper's field tests in closed loop, and draw their figures.

python -m experiments.drive experiment=ims_obstacle   # Fig. 7: around an obstacle, a minute
python -m experiments.drive experiment=lvms_laps      # Fig. 8: nine laps, 90 seconds

A drive that leaves the road is written and drawn like any other, says so, and ends with exit code
6.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from experiments.build import ConfigError
from experiments.cli import LEFT_ROAD, OK, command
from experiments.drive_results import Room, departure, judged, plans, regenerates
from experiments.known import Parts, known_car
from experiments.schema import RENAMED, DriveConfig
from miho.analysis import save
from miho.analysis.driving_figures import fig7, fig8
from miho.data import CSVError
from miho.driving.centre_line import track_from_csv
from miho.driving.driver import Driver, Pace, Sighting
from miho.driving.embedded import embedded_plant
from miho.driving.known_car import KnownCar
from miho.driving.lines import beside, constant
from miho.driving.local_plan import LocalPlanner, Obstacle
from miho.driving.ovals import ims, lvms
from miho.driving.path_tracking import Weights
from miho.driving.road import road_of
from miho.driving.sensors import Sensors
from miho.driving.simulation import Drive
from miho.driving.simulation import drive as drive_loop
from miho.driving.speed_control import SpeedSettings
from miho.driving.track import Track
from miho.driving.vehicle import Vehicle
from miho.study import write_text

SETTINGS = {
    "experiment": "ims_obstacle or lvms_laps, the field tests of the paper",
    "track, vehicle, controller": "where is driven, with which car, controlled how",
    "drive.known": "what planner and controllers know of the car: identified or truth",
    "drive.performance_factor": "the share of the tires' grip that the plan uses (the paper's mu)",
    "drive.road_friction": "what the road gives the car, which the plan does not know",
    "drive.top_speed, .distance": "[m/s] and [m]; see --cfg job for all of drive",
    "optimizer, seed": "what identifies the car, and the noise of all measurements",
    "root": "where log, figure and table go",
}
OVALS = {"ims": ims, "lvms": lvms}
FACTORS = {
    "performance_factor": "the share of the tires' grip that the plan uses",
    "road_friction": "what the road gives, over the road on which the tires were measured",
}
LEAST_FACTOR, LARGEST_FACTOR = 0.05, 1.5
"""A car on wet ice, and one on tires half as good again as they are known."""
departures: list[str] = []
"""How cars of this process left their roads."""


def drive(cfg: DictConfig) -> None:
    """One drive: log, figure, table and what regenerates them, in `root`."""
    road, line, vehicle = prepared(cfg)
    known, parts = known_car(cfg, vehicle)
    with _one_line():
        driver = driver_of(cfg, known, line)
        plant = embedded_plant(vehicle, road_of(road, cfg.drive.road_friction))
        gear = driver.speed.start(cfg.drive.speed).gear
        at = road.project(*map(float, line.position(cfg.drive.start)))
        start = plant.start(at.s, at.e, cfg.drive.speed, gear)
        sensors = Sensors() if cfg.drive.noise else None
        rng = np.random.default_rng(cfg.seed)
        distance = cfg.drive.distance
        with tqdm(total=distance, desc="drive", unit="m", leave=False, disable=None) as bar:
            done = drive_loop(
                plant, driver, start, distance, sensors=sensors, rng=rng,
                watch=lambda gone: bar.update(gone - bar.n),
            )  # fmt: skip
    write(cfg, done, driver, road, parts)


def write(cfg: DictConfig, done: Drive, driver: Driver, road: Track, parts: Parts) -> None:
    """The log and what sensors showed of it as CSV, the figure, the table, and what made them."""
    root = Path(cfg.root)
    root.mkdir(parents=True, exist_ok=True)
    log = pd.DataFrame(dict(done.columns))
    write_text(root / "log.csv", log.to_csv(index=False, float_format="%.6g"))
    measured = pd.DataFrame(dict(done.measured))
    write_text(root / "measured.csv", measured.to_csv(index=False, float_format="%.6g"))
    found = "true models" if not parts else f"models identified by {cfg.optimizer.name}"
    note = f"{factors(cfg)}; {found}"
    room = Room.of(done, road)
    left = departure(done, room)
    if cfg.drive.figure == "fig7":
        ratio = driver.speed.vehicle.steering_ratio
        mark = (
            None
            if left is None
            else (float(log["time"].iloc[0]) + left.time, f"the car left the road {left}")
        )
        figure = fig7(
            log, steering_ratio=ratio, obstacle=_passing(cfg, log), departure=mark, note=note
        )
    else:
        length = driver.plan.line.length
        laps = [k * length for k in range(int(log["distance"].max() / length) + 1)]
        mark = None if left is None else (left.distance, f"the car left the road {left}")
        figure = fig8(log, laps=laps, departure=mark, note=note)
    paths = save(figure, root / "figures" / cfg.drive.figure)
    table = judged(done, driver, room, cfg.drive.road_friction)
    if driver.sighting is not None:
        table |= plans(driver, cfg.drive.start)
    about = regenerates("experiments.drive") | {"seed": cfg.seed, "results": table}
    about["identified"] = {
        part: {"data": problem.dataset.digest, **dict(zip(problem.space.names, theta, strict=True))}
        for part, (problem, theta) in parts.items()
    }
    write_text(root / "drive.json", json.dumps(about, indent=1) + "\n")
    for name, value in table.items():
        print(f"{name:<48} {value}")
    print("\n".join(map(str, [*paths, root / "log.csv", root / "drive.json"])))
    if left is not None:
        departures.append(f"the car left the road {left}")


def prepared(cfg: DictConfig) -> tuple[Track, Track, Vehicle]:
    """The road, the line that is driven on it, and the vehicle."""
    known = [field.name for field in fields(DriveConfig)]
    for key in cfg.drive:
        if key not in known:
            allowed = f"is unknown; allowed are {', '.join(known)}"
            raise ConfigError(f"drive.{key!s}: {RENAMED.get(f'drive.{key!s}', allowed)}")
    if not cfg.drive.track or not cfg.drive.vehicle or not cfg.drive.controller:
        raise ConfigError("drive: is incomplete; choose experiment=ims_obstacle or lvms_laps")
    if cfg.drive.figure not in ("fig7", "fig8"):
        raise ConfigError(f"drive.figure: is {cfg.drive.figure!r}; expected fig7 or fig8")
    for key, meaning in FACTORS.items():
        if not LEAST_FACTOR <= cfg.drive[key] <= LARGEST_FACTOR:
            raise ConfigError(
                f"drive.{key}: is {cfg.drive[key]:g}; expected {LEAST_FACTOR:g} to "
                f"{LARGEST_FACTOR:g}, {meaning}"
            )
    with _one_line():
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


def driver_of(cfg: DictConfig, known: KnownCar, line: Track) -> Driver:
    """The driver that `drive` describes, for a line and what is known of the car."""
    settings = _mapping(cfg.drive.controller)
    planner = known.planner(cfg.drive.performance_factor, cfg.drive.top_speed)
    steering = known.steering_controller(Weights(**settings["weights"]), settings["period"])
    speed = known.speed_controller(SpeedSettings(**settings["speed"]))
    tops = tuple(cfg.drive.top_speeds)
    pace = Pace(tops, cfg.drive.ramp) if tops else None
    box = cfg.drive.obstacle
    sighting = None
    if box.sight is not None:
        obstacle = Obstacle(s=box.s, e=box.e, length=box.length, width=box.width)
        sighting = Sighting((obstacle,), box.sight, LocalPlanner(), planner)
    return Driver(planner.plan(line), speed, steering, pace, sighting)


def factors(cfg: DictConfig) -> str:
    """The two factors of `drive` in words, for figures."""
    return (
        f"performance factor {cfg.drive.performance_factor:g}, "
        f"road friction {cfg.drive.road_friction:g}"
    )


def _passing(cfg: DictConfig, log: pd.DataFrame) -> float | None:
    """When the car is beside the obstacle [s], if there is one."""
    if cfg.drive.obstacle.sight is None:
        return None
    gone = log["distance"] >= cfg.drive.obstacle.s - cfg.drive.start
    return float(log["time"][gone].iloc[0]) if gone.any() else None


def _mapping(node: DictConfig) -> dict[str, Any]:
    plain = OmegaConf.to_container(node, resolve=True)
    if not isinstance(plain, Mapping):
        raise ConfigError(f"{node!r} is not a mapping; expected settings by name")
    return {str(key): value for key, value in plain.items()}


@contextmanager
def _one_line() -> Iterator[None]:
    """What the library finds wrong with settings is bad input, in its own words."""
    try:
        yield
    except (ConfigError, CSVError):
        raise
    except (ValueError, TypeError) as error:
        raise ConfigError(f"drive: {error}") from None


def summary() -> int:
    """Say which cars left their roads; the exit code of the command."""
    for departed in departures:
        print(f"{departed}; lower drive.performance_factor or drive.top_speed", file=sys.stderr)
    return LEFT_ROAD if departures else OK


if __name__ == "__main__":
    command(drive, summary, settings=SETTINGS)
