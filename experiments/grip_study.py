"""Compare laps in which the grip falls by 30 %, with different knowledge of the grip.

python -m experiments.grip_study experiment=grip_falls                          # 20 seeds
python -m experiments.grip_study experiment=grip_falls comparison.repetitions=1 # a look

A seed draws the time of the fall, in the middle of the lap, and the noise of the measurements.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

if not __package__:  # as python experiments/grip_study.py, like python -m experiments.grip_study
    sys.path[0] = str(Path(__file__).parents[1])

import numpy as np
import pandas as pd
from omegaconf import DictConfig
from tqdm import tqdm

from experiments.app.build import ConfigError
from experiments.app.console import command
from experiments.app.origin import regenerates
from experiments.driving.falling_grip import Constant, FallingGrip, Oracle
from experiments.driving.settings import as_config_error
from miho.analysis import save
from miho.analysis.compare.bootstrap import mean_error
from miho.analysis.figures.tracking import grip_figure
from miho.analysis.text import csv_text
from miho.study import write_text
from miho.vehicle.driving.friction_schedule import FrictionSchedule
from miho.vehicle.driving.outcome import true_use
from miho.vehicle.driving.simulation import Drive
from miho.vehicle.driving.tracked_friction import TrackedFriction

BLIND, TRACKER, ORACLE, CAUTIOUS = (
    "the offline value", "the tracker", "the oracle", "the offline value less 30 %",
)  # fmt: skip
SETTINGS = {
    "experiment": "grip_falls",
    "comparison.repetitions": "number of seeds",
    "drive.performance_factor": "share of the grip that the plan uses",
    "seed": "the first seed",
    "root": "folder of laps, table and figure",
}


def study(cfg: DictConfig) -> None:
    """Drive the laps of all seeds, then write laps, table, figure and provenance."""
    if cfg.comparison.repetitions < 1:
        raise ConfigError(
            f"comparison.repetitions: is {cfg.comparison.repetitions}; expected at least 1"
        )
    with as_config_error():
        laps = FallingGrip.of(cfg)
    root = Path(cfg.root)
    root.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for seed in tqdm(range(cfg.seed, cfg.seed + cfg.comparison.repetitions), disable=None):
        tracked = laps.tracked(laps.earlier(seed))
        schedule = laps.schedule(seed)
        sources = {
            BLIND: Constant(), TRACKER: tracked, ORACLE: Oracle(schedule),
            CAUTIOUS: Constant(1 - laps.fall),
        }  # fmt: skip
        drives = {name: laps.lap(seed, source) for name, source in sources.items()}
        rows += [row(seed, name, drive) for name, drive in drives.items()]
        rows[-3] |= detection(tracked, schedule)
        if seed == cfg.seed:
            del drives[CAUTIOUS]
            _draw(root, laps, drives, tracked, schedule)
        write_text(root / "laps.csv", csv_text(pd.DataFrame(rows), float_format="%.6g"))
    text = table(pd.DataFrame(rows), np.random.default_rng(cfg.seed))
    write_text(root / "table.txt", text + "\n")
    about = regenerates("experiments.grip_study", [])
    write_text(root / "grip_study.json", json.dumps(about, indent=1) + "\n")
    print(text)


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


def _draw(
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
    driver, logs = laps.driver(), {}
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
    note = (
        "the offline value: the car leaves its line by 10 m in the next turn, where its curve ends"
    )
    save(
        grip_figure(states, logs, alarms, schedule.time[0], note=note),
        root / "figures" / "grip_falls",
    )


if __name__ == "__main__":
    command(study, config_name="drive", settings=SETTINGS)
