"""Identification of a car from driving logs: datasets, problems, parameters files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from miho.data import Dataset
from miho.identification import CurveFit
from miho.identification.parameters_file import identified_at
from miho.models import Model
from miho.models.identified import Value, parameters_text
from miho.optim import Budget, Optimizer, Space, minimize
from miho.study import write_text
from miho.vehicle.data.axle_samples import axle_samples
from miho.vehicle.data.braking_samples import braking_samples
from miho.vehicle.data.driving_log import DrivingLog
from miho.vehicle.data.synthetic_engine import DYNO_TRUSTED
from miho.vehicle.data.torque_samples import torque_samples
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models import BrakeDeceleration, Pacejka, TorqueCubic
from miho.vehicle.models.engine import RPM

Logs = Mapping[str, tuple[DrivingLog, ...]]

SPACES = ("axle_physical", "brake_deceleration", "torque_cubic")
"""Search spaces of the problems, in conf/space."""
LOW_OPENINGS = (0.05, 0.15, 0.2)
"""Openings that the paper learns from driving, because the dyno is unreliable there."""
HIGH_OPENINGS = (0.3, 0.4, 0.5, 0.65, 0.8, 0.9, 1.0)
"""Additional openings of an extended learned region, which are all rows of the dyno."""
MEAN_SPEED = "mean vx"
"""A derived quantity of an axle: the mean speed [m/s] of its data, which determines its loads."""
SMOOTH = 3700 * RPM
"""Engine speed above the spool of the turbo [rad/s], from which a cubic fits high openings."""
SETTLE = 1.0
"""Settling time of a turbocharged engine after a change of the pedal [s]."""
EVERY = 5
"""Step of the kept samples; a 5 Hz low-pass filter makes neighbours at 100 Hz dependent."""


def problems_of(logs: Logs, vehicle: Vehicle, spaces: Mapping[str, Space]) -> dict[str, CurveFit]:
    """Return the identification problems for the logs of a `programme`, by part.

    Parameters
    ----------
    logs : mapping of str to tuple of DrivingLog
        The logs of each entry of the programme.
    vehicle : Vehicle
        Masses and dimensions of the car.
    spaces : mapping of str to Space
        The spaces named in `SPACES`.

    Returns
    -------
    dict of str to CurveFit
        Problems of front_axle, rear_axle, brake, and throttle_05 etc.
    """
    data: dict[str, tuple[Model, str, Dataset]] = {}
    for axle in ("front", "rear"):
        data[f"{axle}_axle"] = (
            Pacejka(),
            "axle_physical",
            weave_samples(logs["weave"], vehicle, axle),
        )
    braked = (braking_samples(log, settle=0.4) for log in logs["braking"])
    data["brake"] = BrakeDeceleration(), "brake_deceleration", joined(braked, "braking")
    for part in (name for name in logs if name.startswith("throttle_")):
        torques = _torques(logs[part], vehicle, opening_of(part))
        data[part] = TorqueCubic(), "torque_cubic", torques
    return {
        part: CurveFit(model, dataset, spaces[space], label=part)
        for part, (model, space, dataset) in data.items()
    }


def weave_samples(logs: Iterable[DrivingLog], vehicle: Vehicle, axle: str) -> Dataset:
    """Return the stacked `axle_samples` of weaves, for small longitudinal acceleration."""
    samples = (axle_samples(log, vehicle.single_track, axle, max_ax=3.0) for log in logs)
    return joined(samples, f"{axle}_axle")


def part_of(opening: float) -> str:
    """Return the name of the part of an opening from 0 to 1, for example throttle_05."""
    return f"throttle_{round(100 * opening):02d}"


def opening_of(part: str) -> float:
    """Return the throttle opening of a part, for example 0.05 for throttle_05."""
    return int(part.removeprefix("throttle_")) / 100


def joined(parts: Iterable[Dataset], name: str) -> Dataset:
    """Return stacked datasets with every `EVERY`-th row; events are numbered by dataset."""
    datasets = list(parts)
    columns = {
        key: np.concatenate([dataset[key][::EVERY] for dataset in datasets])
        for key in datasets[0].columns
    }
    if "event" in columns:
        lengths = [len(dataset[dataset.output][::EVERY]) for dataset in datasets]
        columns["event"] = np.repeat(np.arange(len(datasets)), lengths).astype(float)
    return Dataset(name, columns, datasets[0].units, datasets[0].output)


def _torques(logs: Iterable[DrivingLog], vehicle: Vehicle, opening: float) -> Dataset:
    """Return torque samples at one opening, from all logs with samples."""
    parts = []
    for log in logs:
        try:
            samples = torque_samples(log, vehicle.longitudinal, throttle=opening, settle=SETTLE)
        except ValueError:  # too short, or too slow
            continue
        fast = samples["omega"] >= (SMOOTH if opening >= DYNO_TRUSTED else 0.0)
        if fast.any():
            parts.append(samples.select(fast))
    if not parts:
        raise ValueError(f"throttle {opening:g}: no log has a sample to learn from")
    return joined(parts, part_of(opening))


def identify_parts(
    problems: Mapping[str, CurveFit], optimizer: Optimizer, budget: Budget, seed: int, folder: Path
) -> None:
    """Identify all parts with one method, and write PART.json for each part to a folder.

    Parameters
    ----------
    problems : mapping of str to CurveFit
        The problems by part, as from `problems_of`.
    optimizer : Optimizer
        The method.
    budget : Budget
        Limits of each run.
    seed : int
        Seed of each run.
    folder : Path
        Folder of the parameters files; it is created if necessary.

    Raises
    ------
    ValueError
        If a run finds no finite error.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for part, problem in problems.items():
        record = minimize(optimizer, problem, budget, seed)
        if record.theta is None:
            raise ValueError(f"no finite error was found on {part}: {record.error}")
        result = identified_at(problem, record.theta)
        about = {
            "optimizer": repr(optimizer), "seed": seed, "evaluations": record.evaluations,
            "packages": {name: version(name) for name in ("numpy", "scipy")},
        }  # fmt: skip
        derived = {}
        if "vx" in problem.dataset.columns and "vx" not in problem.model.inputs:
            derived[MEAN_SPEED] = Value(float(problem.dataset["vx"].mean()), "m/s")
        whole = replace(result, derived=derived, provenance={**result.provenance, **about})
        write_text(folder / f"{part}.json", parameters_text(whole, {}))
