"""Both field tests with the paper's printed equations and with the corrected ones.

    python -m experiments.check.printed_equations [SETTING=VALUE ...]   # 4 minutes

Settings are the settings of `experiments.drive`. Planner and controllers use the true models, so
only the equations differ; drive.known=identified identifies the car first. All drives have the same
sensor noise. The table and its provenance are written to ROOT/table.csv and
ROOT/printed_equations.json.
"""

import copy
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from omegaconf import DictConfig

from experiments.app.build import build_optimizer
from experiments.app.compose import composed
from experiments.app.origin import regenerates
from experiments.driving.car import known_car
from experiments.driving.outcome import Clearance, departure, true_use
from experiments.driving.settings import driven, driver_of, track_and_vehicle
from miho.quantities import g
from miho.study import write_text
from miho.vehicle.driving import Drive, Driver, LoadTransfer
from miho.vehicle.driving.as_printed import PrintedPlanner

TESTS = ("ims_obstacle", "lvms_laps")
SETTINGS = ("root=runs/printed_equations", "drive.known=truth")


@dataclass(frozen=True)
class Variant:
    """Equations of a drive, the weight R of Eq. 15, and whether Eq. 11 has its yaw term.

    `laps` of the nine laps are driven; if it is one, the last lap.
    """

    name: str
    equations: str
    laps: int = 9
    weight: float = 100.0
    yaw_term: bool = True


VARIANTS = (
    Variant("corrected", "corrected"),
    Variant("printed", "printed"),
    Variant("Eq. 10-12 printed", "printed_plan"),
    Variant("Eq. 13-15 printed", "printed_steering"),
    Variant("Eq. 10-12 printed, Eq. 11 without yaw term", "printed_plan", 1, yaw_term=False),
    Variant("corrected, R = 1000", "corrected", 1, 1000.0),
    Variant("printed, R = 1000", "printed", 1, 1000.0),
)


def rows_of(test: str, settings: list[str]) -> Iterator[dict[str, object]]:
    """One row per variant of a field test."""
    cfg = composed([f"experiment={test}", *SETTINGS, *settings])
    road, line, vehicle = track_and_vehicle(cfg)
    car, _ = known_car(cfg, vehicle)
    for variant in VARIANTS:
        setting = setting_of(cfg, variant, line.length)
        driver = driver_of(setting, car, line)
        if not variant.yaw_term and driver.live is not None:
            driver = planned_by(driver, replace(driver.live, yaw_term=False))
        drive = driven(setting, driver, road, line)
        clearance = Clearance.of(drive, road)
        row = results(setting, drive, driver, clearance)
        yield {"test": test, "equations": variant.name, **row}


def setting_of(cfg: DictConfig, variant: Variant, lap: float) -> DictConfig:
    """Settings of a test with a variant; `lap` is the length of the line [m]."""
    setting = copy.deepcopy(cfg)
    if setting.drive.top_speeds and variant.laps == 1:
        fastest = setting.drive.top_speeds[-1]
        setting.drive.speed, setting.drive.top_speeds = fastest, [fastest]
        setting.drive.distance = min(setting.drive.distance, lap)
    setting.drive.equations = variant.equations
    setting.drive.controller.weights.steering = variant.weight
    return setting


def planned_by(driver: Driver, planner: PrintedPlanner) -> Driver:
    """Driver with another printed planner in all its parts."""
    sighting = driver.sighting
    if sighting is not None:
        sighting = replace(sighting, velocity=planner)
    plan = planner.plan(driver.plan.line)
    return replace(driver, plan=plan, live=planner, sighting=sighting)


def results(
    cfg: DictConfig, drive: Drive, driver: Driver, clearance: Clearance
) -> dict[str, object]:
    """Errors, friction uses and lap times until the car left the road; then only whole laps."""
    length, left = driver.plan.line.length, departure(drive, clearance)
    whole = math.inf if left is None else left.distance // length * length
    complete = drive["distance"] < whole
    laps = int(min(whole, drive["distance"][-1] + 1.0) // length)  # the last row is a step short
    row: dict[str, object] = {
        "left the road after [m]": math.nan if left is None else left.distance,
        "stopped": drive.stopped,
        "whole laps": laps,
        "time [s]": drive["time"][-1] - drive["time"][0] if left is None else math.nan,
    }
    vy_rate = drive["ay"] + g * np.sin(drive["bank"]) - drive["vx"] * drive["yaw_rate"]
    printed = LoadTransfer(driver.speed.vehicle, as_printed=True).coefficients.lateral_front
    largest = {
        "e_y [m]": np.abs(drive["e_y"]),
        "e_psi [deg]": np.degrees(np.abs(drive["e_psi"])),
        "v_x - v_des [m/s]": np.abs(drive["vx"] - drive["v_des"]),
        "a_y [m/s^2]": np.abs(drive["ay"]),
        "share of the plan's limit": np.abs(drive["ay"]) / drive["ay_limit"],
        "use of the true friction": true_use(drive, driver, cfg.drive.road_friction),
        "deceleration [m/s^2]": -drive["ax"],
        "load moved on the front axle [N]": np.abs(drive["load_fr"] - drive["load_fl"]) / 2,
        "the same by printed C_roll [N]": np.abs(printed * vy_rate),
    }
    row |= {
        f"largest {name}": values[complete].max() if complete.any() else math.nan
        for name, values in largest.items()
    }
    crossed = np.interp(length * np.arange(10), drive["distance"], drive["time"])
    times = np.where(np.arange(1, 10) <= laps, np.diff(crossed), math.nan)
    return row | {f"lap {lap} [s]": time for lap, time in enumerate(times, 1)}


def main() -> None:
    """Drive all variants of both tests, print the table and store it."""
    settings = sys.argv[1:]
    cfg = composed([f"experiment={TESTS[0]}", *SETTINGS, *settings])
    rows = []
    for test in TESTS:
        for row in rows_of(test, settings):
            print(f"{row['test']}: {row['equations']}", file=sys.stderr)
            rows.append(row)
    table = pd.DataFrame(rows)
    root = Path(cfg.root)
    root.mkdir(parents=True, exist_ok=True)
    write_text(root / "table.csv", table.to_csv(index=False, float_format="%.4g"))
    about = regenerates("experiments.check.printed_equations", [build_optimizer(cfg)])
    write_text(root / "printed_equations.json", json.dumps(about | {"seed": cfg.seed}) + "\n")
    for test in TESTS:
        part = table[table["test"] == test].dropna(axis=1, how="all")
        shown = part.set_index("equations").drop(columns="test").T
        print(f"\n{test}\n\n{shown.to_string(float_format='{:.3g}'.format)}")


if __name__ == "__main__":
    main()
