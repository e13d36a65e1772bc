"""The same lap on several sets of parameters: what identification buys, for one seed."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np
from omegaconf import DictConfig, OmegaConf

from experiments.app.build import build_optimizer, build_space, plain
from experiments.app.compose import composed
from experiments.app.schema import register
from experiments.driving.settings import driver_of, prepared
from miho.data.synthetic_brake import EMBEDDED_BRAKE
from miho.driving.assembly.from_drives import (
    HIGH_OPENINGS,
    LOW_OPENINGS,
    SPACES,
    identify_parts,
    problems_of,
)
from miho.driving.assembly.from_files import Wrong, known_from
from miho.driving.driver import Driver
from miho.driving.embedded import embedded_engine, embedded_plant, embedded_tires
from miho.driving.known_car import KnownCar
from miho.driving.outcome import true_use
from miho.driving.proving_ground import Driven, driven, programme
from miho.driving.road import road_of
from miho.driving.sensors import Sensors
from miho.driving.simulation import Drive, drive
from miho.driving.vehicle import Vehicle
from miho.optim import Budget, Optimizer, Space
from miho.study import single_thread, write_text

LAPS = "laps.json"
PART = (0.4, 0.95)
"""Throttle over which the paper has the dyno alone, but for what saturates."""
LOW_DYNO = 0.9
"""What a dyno that reads low shows from 30 % throttle on, over what the engine gives in the car."""


@dataclass(frozen=True)
class Variant:
    """What the planner and the controllers know: `method` None is the truth."""

    name: str
    method: str | None
    extended: bool = False
    dyno: float = 1.0
    wrong: Wrong | None = None


VARIANTS = (
    Variant("true parameters", None),
    Variant("MIHO", "miho"),
    Variant("least squares", "least_squares"),
    Variant("poor, too bold", "least_squares", wrong=Wrong(1.2, 0.6, 1.25, 1.3)),
    Variant("poor, too cautious", "least_squares", wrong=Wrong(0.8, 1.4, 0.8, 0.7)),
    Variant("MIHO, learned to 100 %", "miho", extended=True),
    Variant("MIHO, dyno 10 % low", "miho", dyno=LOW_DYNO),
    Variant("the same, learned to 100 %", "miho", extended=True, dyno=LOW_DYNO),
)
"""The last three ask whether learning the engine above 40 % throttle, where the paper has the dyno
alone, explains its speed error: with a dyno that is right, and with one that is not."""


@dataclass(frozen=True)
class Job:
    """One seed of the study: the configuration in YAML, the code's digest, where its files go."""

    setting: str
    code: str
    seed: int
    folder: str


def laps_of(job: Job) -> list[dict[str, Any]]:
    """Identify from one seed's measurements, drive a lap on each variant; a row for each."""
    register()
    cfg = cast(DictConfig, OmegaConf.create(job.setting))
    folder = Path(job.folder)
    with single_thread():
        _identify(cfg, job.seed, folder)
        rows = []
        for variant in VARIANTS:
            done, driver = lap(cfg, known(cfg, variant, folder, job.seed), job.seed)
            of_lap = {"seed": job.seed, "variant": variant.name}
            rows.append(of_lap | judged_lap(done, driver, cfg.drive))
    write_text(folder / LAPS, json.dumps({"job": asdict(job), "laps": rows}, indent=1) + "\n")
    return rows


def laps_before(job: Job) -> list[dict[str, Any]] | None:
    """The rows of a job that was done before, by the same code and settings; else None."""
    try:
        stored = json.loads(Path(job.folder, LAPS).read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return None
    return stored["laps"] if stored.get("job") == asdict(job) else None


def known(cfg: DictConfig, variant: Variant, folder: Path, seed: int) -> KnownCar:
    """The car as a variant knows it."""
    _, _, vehicle = prepared(cfg)
    if variant.method is None:
        return KnownCar.of_tires(vehicle, embedded_tires(), embedded_engine(), EMBEDDED_BRAKE)
    return known_from(
        folder / variant.method,
        vehicle,
        sensitivity=cfg.drive.sensitivity,
        extended=variant.extended,
        dyno=variant.dyno,
        seed=seed,
        wrong=variant.wrong,
    )


def lap(cfg: DictConfig, car: KnownCar, seed: int) -> tuple[Drive, Driver]:
    """A drive of `drive.distance`, begun at the speed that the plan has there.

    The sensors' noise is that of the seed, the same for every variant.
    """
    road, line, vehicle = prepared(cfg)
    driver = driver_of(cfg, car, line)
    plant = embedded_plant(vehicle, road_of(road, cfg.drive.road_friction))
    speed, _ = driver.plan.at(cfg.drive.start)
    at = road.project(*map(float, line.position(cfg.drive.start)))
    start = plant.start(at.s, at.e, speed, driver.speed.start(speed).gear)
    rng = np.random.default_rng([seed, 1])
    return drive(plant, driver, start, cfg.drive.distance, sensors=Sensors(), rng=rng), driver


def judged_lap(done: Drive, driver: Driver, settings: DictConfig) -> dict[str, float | str]:
    """What a lap with the settings of `drive` came to.

    lap_time [s], unless the car stopped; largest e_y [m] and e_psi [rad].
    speed_error [m/s]: root mean square of driven less desired speed; part_throttle: the same where
    the throttle is between 40 % and 95 %, as the engine's inverse map has it. margin [-]: 1 less
    the largest use of the true tires' friction, negative beyond it.
    """
    brake = replace(driver.speed, brake=EMBEDDED_BRAKE)  # the plant's, for the use of its tires
    error, friction = done["vx"] - done["v_des"], settings.road_friction
    part = (done["u_throttle"] > PART[0]) & (done["u_throttle"] < PART[1])
    left = settings.distance - float(done["distance"][-1])
    finished: dict[str, float | str]
    finished = {} if done.stopped else {"lap_time": _finish(done, left)}
    return finished | {
        "stopped": done.stopped,
        "e_y": float(np.abs(done["e_y"]).max()),
        "e_psi": float(np.abs(done["e_psi"]).max()),
        "speed_error": float(np.sqrt(np.mean(error**2))),
        "part_throttle": float(np.sqrt(np.mean(error[part] ** 2))) if part.any() else 0.0,
        "margin": 1 - float(true_use(done, replace(driver, speed=brake), friction).max()),
    }


def _finish(done: Drive, left: float) -> float:
    """The time at which the last `left` [m] are done too."""
    return float(done["time"][-1] - done["time"][0] + left / done["vx"][-1])


def _identify(cfg: DictConfig, seed: int, folder: Path) -> None:
    """One folder of parameters files for each method, from the same measurements."""
    _, _, vehicle = prepared(cfg)
    openings = LOW_OPENINGS + HIGH_OPENINGS
    rng = np.random.default_rng([seed, 0])
    logs = {
        name: tuple(manoeuvre.log(name, Sensors(), rng) for manoeuvre in runs)
        for name, runs in _drives(vehicle, openings).items()
    }
    problems = problems_of(logs, vehicle, spaces())
    budget = Budget(evaluations=cfg.budget.evaluations, seconds=cfg.budget.seconds)
    for name, method in methods_of(cfg).items():
        identify_parts(problems, method, budget, seed, folder / name)


def methods_of(cfg: DictConfig) -> dict[str, Optimizer]:
    """The methods of `comparison.methods`, by name."""
    methods = {}
    for name, settings in cfg.comparison.methods.items():
        chosen = composed([f"optimizer={name}"])
        chosen.optimizer = OmegaConf.merge(chosen.optimizer, settings)
        methods[str(name)] = build_optimizer(chosen)
    return methods


def spaces() -> dict[str, Space]:
    """The spaces that parts are searched in which driving shows."""
    return {name: build_space(plain(composed([f"space={name}"]))["space"]) for name in SPACES}


@lru_cache(maxsize=1)
def _drives(vehicle: Vehicle, openings: tuple[float, ...]) -> dict[str, tuple[Driven, ...]]:
    """What happens on the proving ground, which no seed changes."""
    plant = embedded_plant(vehicle)
    return {
        name: tuple(driven(plant, manoeuvre) for manoeuvre in runs)
        for name, runs in programme(vehicle, openings).items()
    }
