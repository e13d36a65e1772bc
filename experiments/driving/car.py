"""The car model of planner and controllers: identified from the embedded data, or the truth."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from omegaconf import DictConfig

from experiments.app.build import ConfigError, build, plain
from experiments.app.compose import composed
from experiments.app.explain import unknown_message
from experiments.app.plan import request_of
from experiments.app.runs import run
from experiments.app.schema import SweepConfig
from miho.identification import CurveFit
from miho.identification.parameters_file import identified_at
from miho.models import read_parameters
from miho.models.identified import parameters_text
from miho.quantities import Array
from miho.study import write_text
from miho.vehicle.data.synthetic_brake import EMBEDDED_BRAKE
from miho.vehicle.driving import KnownCar, Vehicle
from miho.vehicle.driving.assembly.bench import TIRES, assembled
from miho.vehicle.driving.embedded import embedded_engine, embedded_tires

PARAMETERS = "parameters"
"""Folder of the parameters files of a drive, below its root."""
PARTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        **{tire: (f"dataset=tire_{tire}",) for tire in TIRES},
        **{f"torque_{part}": (f"dataset=torque_{part}",) for part in ("05", "15", "20")},
        "brake_pressure": ("dataset=brake_pressure",),
        "brake_torque_front": ("dataset=brake_torque", "dataset.axle=front"),
        "brake_torque_rear": ("dataset=brake_torque", "dataset.axle=rear"),
        "brake_step": ("dataset=brake_step",),
    }
)
"""Identified parts of a car, and the overrides that describe the problem of each."""
Parts = Mapping[str, tuple[CurveFit, Array]]
"""Problem and identified parameters of each part in `PARTS`."""


def known_car(cfg: DictConfig, vehicle: Vehicle) -> tuple[KnownCar, Parts]:
    """The car that `drive.known` chooses, and its identified parts (empty for the truth)."""
    if cfg.drive.known == "truth":
        tires, engine = embedded_tires(), embedded_engine()
        return KnownCar.of_tires(vehicle, tires, engine, EMBEDDED_BRAKE), {}
    if cfg.drive.known != "identified":
        raise ConfigError(f"drive.known: is {cfg.drive.known!r}; expected identified or truth")
    unknown = sorted(set(cfg.drive.parameters) - set(PARTS))
    if unknown:
        raise ConfigError(unknown_message(f"drive.parameters.{unknown[0]}", PARTS))
    if cfg.drive.sensitivity is None and (own := sorted(set(cfg.drive.parameters) & set(TIRES))):
        raise ConfigError(
            f"drive.sensitivity: is null; expected a number with drive.parameters.{own[0]}, since "
            "the property data determine it only for their tires"
        )
    parts = identified_parts(cfg)
    problems = {part: problem for part, (problem, _) in parts.items()}
    thetas = {part: theta for part, (_, theta) in parts.items()}
    return assembled(vehicle, problems, thetas, cfg.drive.sensitivity), parts


def identified_parts(cfg: DictConfig, names: Sequence[str] = tuple(PARTS)) -> Parts:
    """Parts of the car, each from the parameters file that `drive.parameters` names, or a new one.

    A part without a named file is identified by the configured method, unless that run is stored in
    `root`, and its file is written to ROOT/parameters.
    """
    experiments = {part: build(part_setting(cfg, part)) for part in names}
    files = {part: Path(path) for part, path in cfg.drive.parameters.items()}
    plan = [
        request_of(experiment, part_setting(cfg, part), part)
        for part, experiment in experiments.items()
        if part not in files
    ]
    runs = run(plan, SweepConfig(), here=True, fresh=cfg.fresh)
    runs.raise_if_stopped()
    for state in runs.states:
        part, problem = state.request.words, experiments[state.request.words].problem
        if state.run is None:
            raise ConfigError(f"optimizer: {part} is not identified: {state.line}")
        if state.run.result["theta"] is None:
            raise ConfigError(f"optimizer: found no finite error on {part}: {state.line}")
        files[part] = Path(cfg.root) / PARAMETERS / f"{part}.json"
        files[part].parent.mkdir(parents=True, exist_ok=True)
        part_result = identified_at(problem, np.array(state.run.result["theta"]))
        write_text(files[part], parameters_text(part_result, state.run.config["model"]))
    return {
        part: (experiment.problem, read_parameters(files[part], experiment.problem.model).theta)
        for part, experiment in experiments.items()
    }


def part_setting(cfg: DictConfig, part: str) -> Mapping[str, Any]:
    """Configuration of a part with the method, the budget, the seed and the root of a drive."""
    drive = plain(cfg)
    budget = {**drive["budget"], "target": None}
    shared = {key: drive[key] for key in ("optimizer", "method", "seed", "root")}
    return {**plain(composed([*PARTS[part]])), **shared, "budget": budget}
