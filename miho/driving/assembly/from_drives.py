"""From what drives of a car measured to parameters.json: logs, datasets, problems, results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from miho.data import Dataset
from miho.data.axle_samples import axle_samples
from miho.data.braking_samples import braking_samples
from miho.data.driving_log import DrivingLog
from miho.data.synthetic_engine import DYNO_TRUSTED
from miho.data.torque_samples import torque_samples
from miho.driving.vehicle import Vehicle
from miho.identification import CurveFit
from miho.identification.parameters_file import identified_at
from miho.models import Model, Pacejka, TorqueCubic
from miho.models.brake_statics import BrakeDeceleration
from miho.models.engine import RPM
from miho.models.identified import parameters_text
from miho.optim import Budget, Optimizer, Space, minimize
from miho.study import write_text

Array = NDArray[np.float64]
Logs = Mapping[str, tuple[DrivingLog, ...]]

SPACES = ("axle_physical", "brake_deceleration", "torque_cubic")
"""The spaces that its problems are searched in, as conf/space has them."""
LOW_OPENINGS = (0.05, 0.15, 0.2)
"""What the paper learns from driving; the dyno has nothing to be trusted there."""
HIGH_OPENINGS = (0.3, 0.4, 0.5, 0.65, 0.8, 0.9, 1.0)
"""What is learned as well when the learned region is extended, with all rows of the dyno."""
SMOOTH = 3700 * RPM
"""From here on [rad/s], past the turbo's spool, a cubic can follow these openings."""
SETTLE = 1.0
"""Seconds after which a turbocharged engine gives what the pedal asks for."""
EVERY = 5
"""Of 100 samples a second, which a low pass of 5 Hz has made dependent, every fifth is kept."""


def problems_of(logs: Logs, vehicle: Vehicle, spaces: Mapping[str, Space]) -> dict[str, CurveFit]:
    """The identification problems that the logs of a `programme` pose, by part.

    `spaces` holds those named in `SPACES`.
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
    """`axle_samples` of weaves below each other, where the car hardly brakes or accelerates."""
    samples = (axle_samples(log, vehicle.single_track, axle, max_ax=3.0) for log in logs)
    return joined(samples, f"{axle}_axle")


def part_of(opening: float) -> str:
    """The name of the part that is an opening from 0 to 1, such as throttle_05."""
    return f"throttle_{round(100 * opening):02d}"


def opening_of(part: str) -> float:
    """The throttle of a part such as throttle_05."""
    return int(part.removeprefix("throttle_")) / 100


def joined(parts: Iterable[Dataset], name: str) -> Dataset:
    """Datasets below each other, every `EVERY`-th row; events keep apart."""
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
    """Torque samples at one opening, of those logs that have any."""
    parts = []
    for log in logs:
        try:
            samples = torque_samples(log, vehicle.longitudinal, throttle=opening, settle=SETTLE)
        except ValueError:  # too short, or all of it too slow
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
    """Identify every part with one method, and write PART.json for each into a folder."""
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
        whole = replace(result, provenance={**result.provenance, **about})
        write_text(folder / f"{part}.json", parameters_text(whole, {}))
