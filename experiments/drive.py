"""Drive the paper's field tests in closed loop, and draw their figures.

python -m experiments.drive experiment=ims_obstacle   # Fig. 7: around an obstacle, a minute
python -m experiments.drive experiment=lvms_laps      # Fig. 8: nine laps, 90 seconds

A drive that leaves the road is written and drawn like any other, says so, and ends with exit code
6.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from omegaconf import DictConfig
from tqdm import tqdm

from experiments.app.build import build_optimizer
from experiments.app.console import LEFT_ROAD, OK, command
from experiments.app.origin import regenerates
from experiments.driving.car import Parts, known_car
from experiments.driving.settings import driver_of, factors, one_line, prepared
from miho.analysis import save
from miho.analysis.figures.driving import fig7, fig8
from miho.driving.driver import Driver
from miho.driving.embedded import embedded_plant
from miho.driving.outcome import Departure, Room, departure, judged, plans
from miho.driving.road import road_of
from miho.driving.sensors import Sensors
from miho.driving.simulation import Drive
from miho.driving.simulation import drive as drive_loop
from miho.driving.track import Track
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


def drive(cfg: DictConfig) -> int:
    """One drive: log, figure, table and what regenerates them, in `root`."""
    road, line, vehicle = prepared(cfg)
    known, parts = known_car(cfg, vehicle)
    with one_line():
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
    left = write(cfg, done, driver, road, parts)
    if left is None:
        return OK
    advice = "lower drive.performance_factor or drive.top_speed"
    print(f"the car left the road {left}; {advice}", file=sys.stderr)
    return LEFT_ROAD


def write(
    cfg: DictConfig, done: Drive, driver: Driver, road: Track, parts: Parts
) -> Departure | None:
    """The log and what sensors showed of it as CSV, the figure, the table, and what made them.

    Gives how the car left the road, if it did.
    """
    root = Path(cfg.root)
    root.mkdir(parents=True, exist_ok=True)
    log = pd.DataFrame(dict(done.columns))
    write_text(root / "log.csv", log.to_csv(index=False, float_format="%.6g"))
    measured = pd.DataFrame(dict(done.measured))
    write_text(root / "measured.csv", measured.to_csv(index=False, float_format="%.6g"))
    models = "true models" if not parts else f"models identified by {cfg.optimizer.name}"
    note = f"{factors(cfg)}; {models}"
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
    about = regenerates("experiments.drive", [build_optimizer(cfg)])
    about |= {"seed": cfg.seed, "results": table}
    about["identified"] = {
        part: {"data": problem.dataset.digest, **dict(zip(problem.space.names, theta, strict=True))}
        for part, (problem, theta) in parts.items()
    }
    write_text(root / "drive.json", json.dumps(about, indent=1) + "\n")
    for name, value in table.items():
        print(f"{name:<48} {value}")
    print("\n".join(map(str, [*paths, root / "log.csv", root / "drive.json"])))
    return left


def _passing(cfg: DictConfig, log: pd.DataFrame) -> float | None:
    """When the car is beside the obstacle [s], if there is one."""
    if cfg.drive.obstacle.sight is None:
        return None
    gone = log["distance"] >= cfg.drive.obstacle.s - cfg.drive.start
    return float(log["time"][gone].iloc[0]) if gone.any() else None


if __name__ == "__main__":
    command(drive, settings=SETTINGS)
