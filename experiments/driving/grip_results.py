"""Results of laps in which the grip falls: table of all seeds, and figure of one seed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.driving.falling_grip import FallingGrip, TrackedFriction
from experiments.driving.outcome import true_use
from miho.analysis import save
from miho.analysis.compare.bootstrap import mean_error
from miho.analysis.figures.tracking import grip_figure
from miho.vehicle.driving import Drive, FrictionSchedule

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
