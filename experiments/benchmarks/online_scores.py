"""Scores of one online method on all streams, with alarms calibrated on other seeds."""

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from baselines.online import Stream, bicycle, longitudinal, tire
from baselines.online.alarms import Detector
from baselines.online.streams import is_straight
from experiments.benchmarks.online_methods import Contender, detectors
from experiments.benchmarks.online_records import SETTLED, Record, records, seconds_of_row
from miho.online import OnlineMethod

TUNING, CALIBRATION, TEST, STRAIGHTS, HOURS = 1000, 5000, 60_000, 61_000, 70_000
"""First seeds of the sets of streams."""
FAULTS = ("nan", "dropout", "missing", "frozen", "time")
LONGITUDINAL = ("mass", "brake_gain", "drag")
CHANGES = ("jump", "ramp", "jump_outliers")
MARGIN = 0.02
"""The threshold of a peer's alarm is this share above its largest evidence in the calibration."""
PIECE = 25
"""Rows of an update of a method that has no lockstep, in the hours without a change."""
Family = Callable[..., Stream]


@dataclass
class Progress:
    """Lines to stderr with the seconds since the start."""

    started: float = field(default_factory=time.perf_counter)

    def __call__(self, text: str) -> None:
        """Print a line."""
        seconds = time.perf_counter() - self.started
        print(f"{seconds:6.0f} s  {text}", file=sys.stderr, flush=True)


@lru_cache(maxsize=2000)
def stream(family: Family, kind: str, seed: int, seconds: float, drop: float = 0.35) -> Stream:
    """Return a stream; all methods get the same object."""
    return family(kind, seed, seconds, drop=drop)


def streams(
    family: Family, kind: str, first: int, count: int, seconds: float, drop: float = 0.35
) -> list[Stream]:
    """Return streams of consecutive seeds."""
    return [stream(family, kind, first + k, seconds, drop) for k in range(count)]


@dataclass(frozen=True)
class Trial:
    """A contender with its calibrated alarms, and the sizes and the first seed of the test."""

    contender: Contender
    method: OnlineMethod
    first: int
    seeds: int
    hours: float
    thresholds: Mapping[str, float]
    alarm: str

    def over(self, each: Sequence[Stream], every: int = 1) -> list[Record]:
        """Return the runs over streams with the chosen alarm."""
        alarms = {self.alarm: detectors((self.alarm,), self.thresholds).get(self.alarm)}
        known: dict[str, Detector] = {n: d for n, d in alarms.items() if d is not None}
        return records(self.method, each, known, self.contender.abreast, every)


def tuning_error(method: OnlineMethod, contender: Contender, quick: bool) -> float:
    """Return the mean error on the tuning seeds' jumps, ramps and jumps with outliers, percent."""
    families = (tire,) if contender.share < 0.25 else (tire, bicycle)
    count = 1 if quick or contender.share < 0.25 else 4
    errors = []
    for family in families:
        each = [drive for kind in CHANGES for drive in streams(family, kind, TUNING, count, 45.0)]
        runs = records(method, each, {}, contender.abreast)
        errors += [record.errors().mean() for record in runs]
    return float(np.mean(errors))


def calibrated(contender: Contender, family: Family, first: int, seeds: int, hours: float) -> Trial:
    """Return the contender with calibrated alarms."""
    method = contender.method()
    seeds = max(2, round(seeds * (contender.share if contender.share < 0.25 else 1)))
    hours = hours * contender.share
    if contender.detectors == ("own",):
        return Trial(contender, method, first, seeds, hours, {}, "own")
    alarm = thresholds(contender, method, family, hours)
    return Trial(contender, method, first, seeds, hours, *alarm)


def thresholds(
    contender: Contender, method: OnlineMethod, family: Family, hours: float = 1.0
) -> tuple[Mapping[str, float], str]:
    """Return the thresholds of a peer's alarms, and the alarm that is used.

    The thresholds are from 1 h without a change, half of it with straights. The alarm with the
    least mean delay on the tuning seeds is used; a missed change counts as 10 s.
    """
    count = max(2, round(24 * min(1.0, contender.share, 2 * hours)))
    peaks: dict[str, float] = {}
    each = [
        drive
        for k, kind in enumerate(("none", "mixed"))
        for drive in streams(family, kind, CALIBRATION + k * count, max(1, count // 2), 150.0)
    ]
    for record in records(method, each, detectors(contender.detectors, {}), contender.abreast):
        for name, peak in record.peaks.items():
            peaks[name] = max(peaks.get(name, -np.inf), peak)
    limits = {name: peak + MARGIN * abs(peak) for name, peak in peaks.items()}
    tried = records(
        method,
        streams(family, "jump", TUNING, 4, 45.0),
        detectors(contender.detectors, limits),
        contender.abreast,
    )
    delays = {
        name: float(np.mean([min(record.alarm_delay(name), 10.0) for record in tried]))
        for name in contender.detectors
    }
    return limits, min(delays, key=lambda name: delays[name])


def scored(
    name: str, contender: Contender, first: int, seeds: int, hours: float, note: Progress
) -> dict[str, Any]:
    """Return all scores of a method by name of the column."""
    row: dict[str, Any] = {"method": name}
    for family, prefix in ((tire, ""), (bicycle, "car ")):
        if prefix and contender.share < 0.25:
            continue
        trial = calibrated(contender, family, first, seeds, hours / 5 if prefix else hours)
        note(f"{name}: {prefix}alarm {trial.alarm}, thresholds {_short(trial.thresholds)}")
        row |= {prefix + key: value for key, value in _changes(trial, family).items()}
        note(f"{name}: {prefix}changes")
        row |= {prefix + key: value for key, value in _quiet(trial, family).items()}
        note(f"{name}: {prefix}streams without a change")
        if not prefix:
            row |= _faults(trial)
            row |= _other_changes(trial)
            note(f"{name}: faults")
        row[prefix + "us"] = 1e6 * seconds_of_row(trial.method, stream(family, "jump", TEST, 60.0))
    row["setting"] = ", ".join(f"{value:g}" for value in contender.chosen.values())
    return row


def _changes(trial: Trial, family: Family) -> dict[str, Any]:
    """Delays, errors, coverage and alarms on jumps, ramps and jumps with outliers."""
    n, first = trial.seeds, TEST + trial.first
    each = trial.over(
        [drive for kind in CHANGES for drive in streams(family, kind, first, n, 60.0)]
    )
    jump, ramp, outliers = each[:n], each[n : 2 * n], each[2 * n :]
    alarm = trial.alarm
    late = [record.alarm_delay(alarm) for record in jump]
    scale = _scale(trial, family)
    return {
        **_delays("10 %", [record.delay(0.10) for record in jump]),
        **_delays("5 %", [record.delay(0.05) for record in jump]),
        "error": np.mean([record.errors().mean() for record in jump]),
        "error ramp": np.mean([record.errors().mean() for record in ramp]),
        "error outliers": np.mean([record.errors().mean() for record in outliers]),
        "10 % outliers": np.median([record.delay(0.10) for record in outliers]),
        "before": np.mean([record.coverage(10, 30) for record in jump]),
        "after": np.mean([record.coverage(32) for record in jump]),
        "ramp": np.mean([record.coverage(30, 40) for record in ramp]),
        "scale": scale,
        "before scaled": np.mean([record.coverage(10, 30, scale) for record in jump]),
        "after scaled": np.mean([record.coverage(32, scale=scale) for record in jump]),
        "alarm": alarm,
        **_delays("alarm s", late),
        "missed": int(np.isinf(late).sum()),
        "most alarms": max(record.alarm_count(alarm) for record in jump),
        "seeds": trial.seeds,
    }  # fmt: skip


def _scale(trial: Trial, family: Family) -> float:
    """Factor of the intervals by which they hold 95 % on the tuning seeds."""
    each = trial.over(streams(family, "jump", TUNING, 4, 45.0))
    ratios = [
        (np.abs(record.theta - record.truth) / record.reach)[record.clock >= 10] for record in each
    ]
    return float(np.quantile(np.concatenate(ratios), 0.95))


def _quiet(trial: Trial, family: Family) -> dict[str, Any]:
    """False alarms an hour, coverage in mixed driving, and the change of estimates on straights."""
    hours, straights, others = trial.hours, STRAIGHTS + trial.first, HOURS + trial.first
    count = _count(hours / 8 / len(FAULTS), 60)
    sets = {
        "mixed": streams(family, "mixed", others, _count(hours / 2, 330), 330.0),
        "straight": streams(family, "straight", straights, _count(hours / 4, 330), 330.0),
        "outliers": streams(family, "outliers", straights, _count(hours / 8, 330), 330.0),
        "faults": [
            drive for kind in FAULTS for drive in streams(family, kind, others, count, 60.0)
        ],
    }
    runs = iter(trial.over([drive for each in sets.values() for drive in each], PIECE))
    parts = {name: [next(runs) for _ in each] for name, each in sets.items()}
    alarms = {n: sum(len(r.alarms[trial.alarm]) for r in each) for n, each in parts.items()}
    spent = {n: sum(len(r.stream) for r in each) / 180_000 for n, each in parts.items()}
    moved, grown = zip(*(_on_straight(record) for record in parts["straight"]), strict=True)
    scale = _scale(trial, family)
    return {
        "corners scaled": np.mean([_in_corners(record, scale) for record in parts["mixed"]]),
        "corners": np.mean([_in_corners(record) for record in parts["mixed"]]),
        "mixed": np.mean([record.coverage() for record in parts["mixed"]]),
        "mixed scaled": np.mean([record.coverage(scale=scale) for record in parts["mixed"]]),
        **{f"false {n}": f"{alarms[n]} in {spent[n]:.2g} h" for n in parts},
        "false an hour": sum(alarms.values()) / sum(spent.values()),
        "hours": sum(spent.values()),
        "moved sd": np.median(moved),
        "interval grows": np.median(grown),
    }


def _in_corners(record: Record, scale: float = 1.0) -> float:
    """Coverage in mixed driving off its straights, where intervals grow and the truth stands."""
    inside = (record.clock >= SETTLED) & ~is_straight("mixed", record.clock)
    held = np.abs(record.theta - record.truth) < scale * record.reach
    return float(held[inside].mean())


def _on_straight(record: Record) -> tuple[float, float]:
    """Largest move of an estimate on a straight, in deviations at its start; their growth.

    The straight starts at 30 s; 1 s later the rear axle of a car no longer slides either.
    """
    k = int(np.searchsorted(record.clock, 31.0)) - 1
    moves = np.abs(record.theta[k:] - record.theta[k]).max(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        deviations = record.reach / 1.959964
        return float(np.max(moves / deviations[k])), float(np.min(deviations[-1] / deviations[k]))


def _faults(trial: Trial) -> dict[str, Any]:
    """Median over seeds of the largest error from the fault on, and the longest recovery."""
    row: dict[str, Any] = {}
    slowest = 0.0
    kinds, n, first = (*FAULTS, "delay", "glitch"), trial.seeds, TEST + trial.first
    runs = trial.over([drive for kind in kinds for drive in streams(tire, kind, first, n, 45.0)])
    for k, kind in enumerate(kinds):
        each = runs[k * n : (k + 1) * n]
        row[f"fault {kind}"] = np.median([record.errors(30.0).max() for record in each])
        if each[0].stream.end is not None:
            slowest = max(slowest, float(np.median([record.recovery(1.5) for record in each])))
    late = np.concatenate([record.alarms[trial.alarm] for record in each]) >= 30.0
    glitches = n * (each[0].stream.during(30.0).sum() // 100)
    return {**row, "recovery": slowest, "glitch alarms": 100 * late.sum() / glitches}


def _other_changes(trial: Trial) -> dict[str, Any]:
    """Median delays after smaller and larger jumps of D, and after jumps of other parameters."""
    n, first, drops = min(trial.seeds, 10), TEST + trial.first, (0.1, 0.2, 0.5)
    sets = {f"D by {drop:g}": streams(tire, "jump", first, n, 45.0, drop) for drop in drops}
    sets["stiffness"] = streams(tire, "stiffness", first, n, 45.0)
    for name in LONGITUDINAL:
        sets[name] = streams(longitudinal, name, first, n, 90.0, 0.2)
    row = {}
    for name, each in sets.items():
        late = [record.delay(0.10 if name == "stiffness" else 0.05) for record in trial.over(each)]
        row[f"delay {name}"] = np.median(late)
    return row


def _count(hours: float, seconds: float) -> int:
    """Number of streams of this length that make up some hours, at least one."""
    return max(1, math.ceil(3600 * hours / seconds))


def _delays(name: str, values: Sequence[float]) -> dict[str, float]:
    """Median and 90 % quantile."""
    high = float(np.quantile(values, 0.9, method="higher"))
    return {name: float(np.median(values)), f"{name} q90": high}


def _short(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in values.items()) or "own"
