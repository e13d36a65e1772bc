"""Online methods on streams with known truth: delays, errors, coverage, alarms and faults.

python -m experiments.benchmarks.online [--quick] [--seeds N] [--first N] [--hours H]
    [--methods A,B] [--tune] [--output FOLDER]

Streams of a tire and of a car whose grip falls by 35 % within 0.2 s or within 10 s, and streams
without a change: mixed driving, straights, outliers and faults of sensors. Each seed has its own
vehicle and its own error of the offline estimate. All methods get the same streams. A peer's alarm
is at its highest evidence in an hour without a change, on other seeds; of its possible alarms the
quickest one is used. `--tune` tries TRIED settings of each peer first, on other seeds, and uses the
best; without it the settings in use are the results of an earlier `--tune`. Slow methods run over
a share of the seeds and hours. The oracle knows all but D, and the end of its fall.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from baselines.online import tire
from baselines.online.streams import FORCE_NOISE
from experiments.app.explain import ConfigError, unknown_message
from experiments.benchmarks.bars import Bar, Measured, at_least, at_most, benchmark, shown
from experiments.benchmarks.online_methods import CONTENDERS, Contender
from experiments.benchmarks.online_scores import Progress, scored, stream, tuning_error

ORACLE_SEEDS = 200
TABLES = {
    "Tire: delay after the jump (median and 90 % quantile), mean error": (
        "setting", "10 %", "10 % q90", "5 %", "5 % q90", "10 % outliers",
        "error", "error ramp", "error outliers", "seeds", "us",
    ),
    "Tire: coverage of the 95 % interval, alarms": (
        "before", "after", "ramp", "mixed", "corners", "alarm", "alarm s", "alarm s q90", "missed",
        "most alarms", "false an hour", "hours", "false mixed", "false straight",
        "false outliers", "false faults",
    ),
    "Tire: straights of 5 min, faults (largest error, percent), delay of other jumps to 5 %"
    " (stiffness to 10 %)": (
        "moved sd", "interval grows", "fault nan", "fault dropout", "fault missing",
        "fault frozen", "fault time", "fault delay", "fault glitch", "glitch alarms", "recovery",
        "delay D by 0.1", "delay D by 0.2", "delay D by 0.5", "delay stiffness",
        "delay mass", "delay brake_gain", "delay drag",
    ),
    "Car: vx, vy and yaw rate": (
        "car 10 %", "car 10 % q90", "car 5 %", "car 5 % q90", "car error", "car error ramp",
        "car error outliers", "car before", "car after", "car ramp", "car mixed", "car scale",
        "car before scaled", "car after scaled", "car mixed scaled", "car corners scaled",
        "car alarm", "car alarm s",
        "car missed", "car most alarms", "car false an hour", "car hours", "car false mixed",
        "car false straight", "car false outliers", "car false faults", "car moved sd",
        "car interval grows", "car us",
    ),
}  # fmt: skip
"""Columns of the printed tables."""


def measure(
    quick: bool, tune: bool, seeds: int, first: int, hours: float, methods: str
) -> Measured:
    """Measure all methods, one after the other, with a line of progress for each part."""
    note = Progress()
    names = methods.split(",") if methods else [*CONTENDERS]
    for name in names:
        if name not in CONTENDERS:
            raise ConfigError(unknown_message(f"--methods={name}", CONTENDERS))
    if quick:
        seeds, hours = min(seeds, 3), min(hours, 0.5)
    rows: list[Mapping[str, Any]] = []
    facts: dict[str, Any] = {}
    for name in names:
        contender = CONTENDERS[name]
        if tune and contender.grid:
            contender = tuned(name, contender, quick, note)
        facts[name] = dict(contender.chosen)
        rows += shown([scored(name, contender, first, seeds, hours, note)])
    rows.append({"method": "oracle", **oracle(10 if quick else ORACLE_SEEDS)})
    frame = pd.DataFrame(rows)
    tables = [
        f"{title}\n{frame[['method', *_there(frame, columns)]].to_string(index=False, **FORMAT)}\n"
        for title, columns in TABLES.items()
    ]
    table = frame[["method", *_there(frame, ("10 %", "5 %", "alarm s", "error"))]]
    return Measured(
        table, frame, bars(frame), tables, {"first": first, "seeds": seeds, "settings": facts}
    )


FORMAT: dict[str, Any] = {"float_format": "{:.3g}".format, "na_rep": "-"}


def _there(frame: pd.DataFrame, columns: tuple[str, ...]) -> list[str]:
    return [column for column in columns if column in frame]


def tuned(name: str, contender: Contender, quick: bool, note: Progress) -> Contender:
    """Return the contender with the setting of its grid that has the least error."""
    trials = contender.trials()[:: 4 if quick else 1]
    errors = []
    for trial in trials:
        errors.append(tuning_error(contender.build(**trial), contender, quick))
        note(f"{name}: {trial} {errors[-1]:.3f} %")
    return replace(contender, chosen=trials[int(np.argmin(errors))])


def oracle(count: int) -> dict[str, float]:
    """Return the delays of an estimator that knows all but D, from rows after its fall alone.

    Its alarm knows time and shape of the change; it is at odds of 1 false alarm an hour.
    """
    close: dict[float, list[float]] = {0.10: [], 0.05: []}
    late = []
    for seed in range(count):
        jump = stream(tire, "jump", seed, 40.0)
        B, C, D, Sx, Sy = (jump.truth[name] for name in ("B", "C", "D", "Sx", "Sy"))
        shape = np.sin(C * np.arctan(B * (Sx - jump.columns["alpha"])))
        force = jump.columns["Fy"] - Sy
        fallen = jump.during(30.2, 34.0)
        x, y = shape[fallen], force[fallen]
        away = np.abs(np.cumsum(x * y) / np.cumsum(x * x) / D[-1] - 1)
        for tolerance, delays in close.items():
            delays.append(0.2 + 0.02 * next(
                i for i in range(y.size) if (away[i : i + 50] < tolerance).all()
            ))  # fmt: skip
        changing = jump.during(30.0, 31.0)
        gain = (force - D[0] * shape) ** 2 - (force - D * shape) ** 2
        odds = np.cumsum(gain[changing]) / (2 * FORCE_NOISE**2)
        late.append(0.02 * int(np.argmax(odds > math.log(3600 * 50))))
    quantiles = {"10 %": close[0.10], "5 %": close[0.05], "alarm s": late}
    return {
        key: float(value)
        for name, values in quantiles.items()
        for key, value in (
            (name, np.median(values)), (f"{name} q90", np.quantile(values, 0.9)),
        )
    }  # fmt: skip


def bars(frame: pd.DataFrame) -> list[Bar]:
    """The bars of the tracker, in relation to the peers that were measured with it."""
    if "tracker" not in set(frame["method"]):
        return []
    rows: dict[str, Any] = {str(row["method"]): row for _, row in frame.iterrows()}
    own = rows["tracker"]
    peers = [row for name, row in rows.items() if name not in ("tracker", "oracle")]
    judged = []
    for prefix, name in (("", "tire"), ("car ", "car")):
        limits = {"10 %": 0.26, "5 %": 0.32, "alarm s": 0.12}
        judged += [
            at_most(f"{name}: delay, {column}", own[prefix + column], limit, "s")
            for column, limit in limits.items()
        ]
        errors = {"error": 0.7, "error outliers": 0.7, "error ramp": 1.5}
        judged += [
            at_most(f"{name}: mean {column}", own[prefix + column], limit, "%")
            for column, limit in errors.items()
        ]
        if peers:
            ratio = own[prefix + "error"] / min(row.get(prefix + "error", np.inf) for row in peers)
            judged.append(at_most(f"{name}: error on jumps / best peer's", ratio, 0.7))
        most = own[prefix + "most alarms"]
        judged.append(at_most(f"{name}: alarms of one change", most, 1))
        moved, grown = own[prefix + "moved sd"], own[prefix + "interval grows"]
        judged.append(at_most(f"{name}: straight of 5 min, D moves", moved, 0.1, "sd"))
        judged.append(at_least(f"{name}: straight of 5 min, interval grows", grown, 1.0))
        for column in ("before", "after", "mixed"):
            value = own[prefix + column]
            judged.append(at_least(f"{name}: coverage {column}", value, 0.92))
            judged.append(at_most(f"{name}: coverage {column}", value, 0.98))
    judged += [
        at_most("tire: delay, 10 %, with outliers", own["10 % outliers"], 0.26, "s"),
        at_least("tire: coverage in ramps", own["ramp"], 0.85),
        at_most("tire: false alarms an hour", own["false an hour"], 0.5),
        at_least("tire: hours without a change", own["hours"], 20, "h"),
        at_most("faults: recovery", own["recovery"], 1.0, "s"),
        at_most("one update", own["us"], 50, "us"),
    ]
    judged += [
        at_most(f"fault {kind}: largest error of D", own[f"fault {kind}"], 1.5, "%")
        for kind in ("nan", "dropout", "missing", "frozen", "time")
    ]
    return judged


if __name__ == "__main__":
    benchmark(
        __doc__,
        measure,
        "online",
        flags={"tune": "try the settings of each peer on other seeds first"},
        options={
            "seeds": (20, "seeds of the test"),
            "first": (0, "first seed of the test"),
            "hours": (20.0, "hours of streams without a change"),
            "methods": ("", "names of methods, with commas between them; by default all"),
        },
    )
