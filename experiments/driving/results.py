"""Files of a drive in its root: logs, figure, table and provenance."""

import json
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure
from omegaconf import DictConfig

from experiments.app.build import build_optimizer, method_of
from experiments.app.origin import regenerates
from experiments.driving.car import Parts
from experiments.driving.outcome import (
    Clearance,
    Departure,
    departure,
    excess,
    outcome_table,
    planned_use,
    plans,
    speed_bands,
)
from experiments.driving.settings import factors_text
from miho.analysis import save
from miho.analysis.figures.driving import fig7, fig8
from miho.study import write_text
from miho.vehicle.driving import Drive, Driver, Track


def write_drive(
    cfg: DictConfig, drive: Drive, driver: Driver, road: Track, parts: Parts
) -> Departure | None:
    """Write the log and the sensor log as CSV, the figure, the table, and their provenance.

    Returns how the car left the road, or None.
    """
    root = Path(cfg.drive.output)
    root.mkdir(parents=True, exist_ok=True)
    use = planned_use(drive, driver)
    log = pd.DataFrame({**drive.columns, "planned_use": use})
    write_text(root / "log.csv", log.to_csv(index=False, float_format="%.6g"))
    measured = pd.DataFrame(dict(drive.measured))
    write_text(root / "measured.csv", measured.to_csv(index=False, float_format="%.6g"))
    clearance = Clearance.of(drive, road)
    off_road = departure(drive, clearance)
    models = "true models" if not parts else f"models identified by {method_of(cfg)}"
    beyond = excess(drive, use)
    note = f"{factors_text(cfg)}; {models}"
    figure = _figure(cfg, log, driver, off_road, note, "" if beyond is None else str(beyond))
    paths = save(figure, root / "figures" / cfg.drive.figure)
    table = outcome_table(drive, driver, clearance, cfg.drive.road_friction)
    if driver.sighting is not None:
        table |= plans(driver, cfg.drive.start)
    about = regenerates("experiments.drive", [build_optimizer(cfg)])
    bands = speed_bands(drive)
    about |= {"seed": cfg.seed, "results": table, "speed bands": bands}
    about["identified"] = {
        part: {"data": problem.dataset.digest, **dict(zip(problem.space.names, theta, strict=True))}
        for part, (problem, theta) in parts.items()
    }
    write_text(root / "drive.json", json.dumps(about, indent=1) + "\n")
    for name, value in table.items():
        print(f"{name:<48} {value}")
    print(pd.DataFrame(bands).to_string(index=False))
    print("\n".join(map(str, [*paths, root / "log.csv", root / "drive.json"])))
    return off_road


def _figure(
    cfg: DictConfig,
    log: pd.DataFrame,
    driver: Driver,
    off_road: Departure | None,
    note: str,
    beyond: str,
) -> Figure:
    """Fig. 7 over time, or Fig. 8 over distance, with a mark if the car left the road.

    `beyond` is text on the use of more friction than planned; "" if there was none.
    """
    left = f"the car left the road {off_road}"
    if cfg.drive.figure == "fig7":
        begun = float(log["time"].iloc[0])
        passing = _passing(cfg, log, driver.plan.line.length)
        mark = None if off_road is None else (begun + off_road.time, left)
        return fig7(log, obstacle=passing, departure=mark, excess=beyond, note=note)
    length = driver.plan.line.length
    laps = [k * length for k in range(int(log["distance"].max() / length) + 1)]
    mark = None if off_road is None else (off_road.distance, left)
    return fig8(log, laps=laps, departure=mark, note=note)


def _passing(cfg: DictConfig, log: pd.DataFrame, lap: float) -> float | None:
    """Time [s] at which the car passes the obstacle on a line of length `lap`; None without one."""
    if cfg.drive.obstacle.sight is None:
        return None
    passed = log["distance"] >= (cfg.drive.obstacle.s - cfg.drive.start) % lap
    return float(log["time"][passed].iloc[0]) if passed.any() else None
