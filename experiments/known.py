"""The car as planner and controllers know it: identified from the embedded data, or true."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from omegaconf import DictConfig

from experiments.build import ConfigError, Experiment, build
from experiments.cli import composed
from experiments.engine import engine_of
from experiments.progress import progress
from miho.data.synthetic_brake import EMBEDDED_BRAKE
from miho.data.tir_sampling import EMBEDDED_RANGES
from miho.driving.embedded import embedded_engine, embedded_tires
from miho.driving.grip import Grip
from miho.driving.known_car import KnownCar
from miho.driving.vehicle import Vehicle
from miho.identification import CurveFit
from miho.models import Axle, Brake, EngineMap, read_parameters
from miho.optim import Budget, Outcome, minimize

Array = NDArray[np.float64]

TIRES = ("lf", "rf", "lr", "rr")
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
"""What is identified of a car, and the overrides that describe each problem."""
Parts = Mapping[str, tuple[CurveFit, Array]]
"""The problem of each part of `PARTS` with the parameters that were found."""


def known_car(cfg: DictConfig, vehicle: Vehicle) -> tuple[KnownCar, Parts]:
    """What `drive.known` asks for, and what of it was identified."""
    if cfg.drive.known == "truth":
        tires, engine = embedded_tires(), embedded_engine()
        return KnownCar.of_tires(vehicle, tires, engine, EMBEDDED_BRAKE), {}
    if cfg.drive.known != "identified":
        raise ConfigError(f"drive.known: is {cfg.drive.known!r}; expected identified or truth")
    unknown = sorted(set(cfg.drive.parameters) - set(PARTS))
    if unknown:
        raise ConfigError(
            f"drive.parameters.{unknown[0]}: is unknown; allowed are {', '.join(PARTS)}"
        )
    parts = {part: identified_part(cfg, part) for part in PARTS}
    problems = {part: problem for part, (problem, _) in parts.items()}
    thetas = {part: theta for part, (_, theta) in parts.items()}
    return assembled(vehicle, problems, thetas, cfg.drive.sensitivity), parts


def assembled(
    vehicle: Vehicle,
    problems: Mapping[str, CurveFit],
    thetas: Mapping[str, Array],
    sensitivity: float,
) -> KnownCar:
    """The car that identified parameters of all `PARTS` make.

    The tires' curves are those of the middle of the loads they were sampled at. sensitivity: of
    their peaks to the load [-], which is in none of the curves.
    """
    front, rear = Axle(thetas["lf"], thetas["rf"]), Axle(thetas["lr"], thetas["rr"])
    loads = np.array([np.mean(EMBEDDED_RANGES[tire].Fz) for tire in TIRES])
    grip = Grip.of_axles(front, rear, loads, sensitivity=sensitivity)
    return KnownCar(
        vehicle, front, rear, loads, grip, _engine(problems, thetas), _brake(problems, thetas)
    )


def identified_part(cfg: DictConfig, part: str) -> tuple[CurveFit, Array]:
    """The problem of a part, and its parameters from a file or by the configured method."""
    chosen = build_part(cfg, part)
    path = cfg.drive.parameters.get(part)
    if path is not None:
        return chosen.problem, read_parameters(Path(path), chosen.problem.model).theta
    budget = Budget(evaluations=cfg.budget.evaluations, seconds=cfg.budget.seconds)
    with progress(part, budget, chosen.problem.model.output) as observe:
        record = minimize(chosen.optimizer, chosen.problem, budget, cfg.seed, observer=observe)
    if record.outcome is Outcome.INTERRUPTED:
        raise KeyboardInterrupt
    if record.theta is None:
        raise ConfigError(f"optimizer: found no finite error on {part}: {record.error}")
    return chosen.problem, record.theta


def build_part(cfg: DictConfig, part: str) -> Experiment:
    """One problem of `PARTS` with the configured method."""
    one = composed([*PARTS[part]])
    one.optimizer = cfg.optimizer
    return build(one)


def _engine(problems: Mapping[str, CurveFit], thetas: Mapping[str, Array]) -> EngineMap:
    names = {0.05: "torque_05", 0.15: "torque_15", 0.2: "torque_20"}
    learned = {throttle: problems[name] for throttle, name in names.items()}
    return engine_of(learned, {t: thetas[name] for t, name in names.items()}).integrated


def _brake(problems: Mapping[str, CurveFit], thetas: Mapping[str, Array]) -> Brake:
    """Radii are the car's own; the bias is the slope of the rear over the front pressure."""
    test = problems["brake_pressure"].dataset
    slope = float(test["p_rear"] @ test["p"] / (test["p"] @ test["p"]))
    u0, u1, P_max, n = thetas["brake_pressure"].tolist()
    K_front, P0_front = thetas["brake_torque_front"].tolist()
    K_rear, P0_rear = thetas["brake_torque_rear"].tolist()
    delay, tau_rise, tau_fall = thetas["brake_step"].tolist()
    return replace(
        EMBEDDED_BRAKE,
        u0=u0, u1=u1, P_max=P_max, n=n, bias=1 / (1 + slope), K_front=K_front, P0_front=P0_front,
        K_rear=K_rear, P0_rear=P0_rear, delay=delay, tau_rise=tau_rise, tau_fall=tau_fall,
    )  # fmt: skip
