"""What identification buys: from drives to files, from files to a car, and the study's jobs."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from experiments.app.build import ConfigError
from experiments.app.compose import composed
from experiments.app.origin import DRIVING, DRIVING_SOURCES
from experiments.driving.laps import (
    LAPS,
    VARIANTS,
    SeedJob,
    lap,
    lap_results,
    laps_of,
    spaces,
    stored_laps,
)
from experiments.driving.study import check_study
from miho.data import Dataset
from miho.methods.least_squares import LeastSquares
from miho.models import read_parameters
from miho.optim import Budget
from miho.vehicle.data.synthetic_brake import EMBEDDED_BRAKE
from miho.vehicle.data.synthetic_engine import true_torque
from miho.vehicle.driving import Sensors, embedded_plant
from miho.vehicle.driving.assembly.from_drives import (
    LOW_OPENINGS,
    identify_parts,
    joined,
    opening_of,
    part_of,
    problems_of,
)
from miho.vehicle.driving.assembly.from_files import Wrong, engine_from, known_from
from miho.vehicle.driving.embedded import embedded_tires
from miho.vehicle.driving.proving_ground import perform, programme
from miho.vehicle.models import Pacejka
from miho.vehicle.models.engine import RPM
from tests.vehicle.driving.cars import car

AV21 = car().vehicle
EXPERIMENT = "experiment=identification_buys"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Parts identified by least squares from one seed's measurements."""
    folder = tmp_path_factory.mktemp("parts")
    plant, rng = embedded_plant(AV21), np.random.default_rng(0)
    logs = {
        name: tuple(perform(plant, manoeuvre).log(name, Sensors(), rng) for manoeuvre in manoeuvres)
        for name, manoeuvres in programme(AV21, LOW_OPENINGS).items()
    }
    problems = problems_of(logs, AV21, spaces())
    identify_parts(problems, LeastSquares(), Budget(evaluations=5000), 0, folder)
    return folder


def test_parts_have_names_both_ways() -> None:
    assert [part_of(opening) for opening in (0.05, 0.65, 1.0)] == [
        "throttle_05", "throttle_65", "throttle_100",
    ]  # fmt: skip
    assert [opening_of(part_of(x)) for x in LOW_OPENINGS] == list(LOW_OPENINGS)


def test_joined_datasets_keep_their_events_apart() -> None:
    part = Dataset("a", {"x": np.arange(10.0), "event": np.ones(10)}, {"x": "s", "event": "-"}, "x")
    whole = joined([part, part], "both")
    assert whole["x"].tolist() == [0, 5, 0, 5]
    assert whole["event"].tolist() == [0, 0, 1, 1]


def test_unknown_seeds_and_methods_are_one_line() -> None:
    cfg = composed([EXPERIMENT])
    cfg.comparison.repetitions = 0
    with pytest.raises(ConfigError, match=r"comparison\.repetitions: is 0; expected at least 1"):
        check_study(cfg)
    cfg = composed([EXPERIMENT, "drive.sensitivity=null"])
    with pytest.raises(ConfigError, match=r"drive\.sensitivity: is null; expected a number"):
        check_study(cfg)
    cfg = composed([EXPERIMENT])
    cfg.comparison.methods = {"least_squares": {}}
    with pytest.raises(ConfigError, match=r"comparison\.methods\.miho: is missing"):
        check_study(cfg)


def test_a_job_done_before_is_read_only_if_it_was_the_same(tmp_path: Path) -> None:
    job = SeedJob("drive: {}", "code", 3, str(tmp_path))
    assert stored_laps(job) is None
    rows = [{"seed": 3, "lap_time": 60.0}]
    (tmp_path / LAPS).write_text(json.dumps({"job": asdict(job), "laps": rows}))
    assert stored_laps(job) == rows
    assert stored_laps(SeedJob("drive: {}", "other code", 3, str(tmp_path))) is None
    (tmp_path / LAPS).write_text("{")
    assert stored_laps(job) is None


@pytest.mark.slow
def test_what_is_identified_is_near_the_truth(folder: Path) -> None:
    """Peaks and torques of the plant's own models, which no identification sees.

    The axle's peak may miss the tires' at static load by a tenth: the curve is at the loads of the
    weave, with the load transfer in it. The engine's rows are within 12 Nm where they were driven.
    """
    identified = known_from(folder, AV21, sensitivity=0.0)
    alpha = np.linspace(-0.2, 0.2, 401)
    lf, rf, lr, rr = embedded_tires()
    for axle, tires, loads in (
        (identified.front, (lf, rf), identified.loads[:2]),
        (identified.rear, (lr, rr), identified.loads[2:]),
    ):
        force = sum(
            tire.forces(load, 0.0, alpha).Fy for tire, load in zip(tires, loads, strict=True)
        )
        assert axle.force(alpha).max() == pytest.approx(np.max(force), rel=0.1)
    engine = engine_from(folder)
    speeds = np.array([3700, 4200, 4700, 5200]) * RPM
    for opening in LOW_OPENINGS:
        miss = engine.torque(speeds, opening) - true_torque(speeds, opening)
        assert np.abs(miss).max() < 12.0
    pressures = np.array([0.5e6, 1.5e6, 3.0e6])
    assert identified.brake.force_of_pressure(pressures) == pytest.approx(
        EMBEDDED_BRAKE.force_of_pressure(pressures), rel=0.05
    )


@pytest.mark.slow
def test_wrong_factors_are_what_they_say(folder: Path) -> None:
    identified = known_from(folder, AV21, sensitivity=0.0)
    wrong = known_from(folder, AV21, sensitivity=0.0, wrong=Wrong(1.2, 0.6, 1.25, 1.3))
    assert wrong.grip.left == pytest.approx(1.2 * identified.grip.left)
    assert wrong.engine.table == pytest.approx(1.25 * identified.engine.table)
    assert wrong.front.left[0] == pytest.approx(0.6 * identified.front.left[0])
    assert wrong.brake.force_of_pressure(2e6) == pytest.approx(
        1.3 * identified.brake.force_of_pressure(2e6)
    )


@pytest.mark.slow
def test_a_dyno_that_reads_low_counts_above_its_trusted_opening(folder: Path) -> None:
    right, low = engine_from(folder), engine_from(folder, dyno=0.9)
    omega = 5000 * RPM
    assert low.torque(omega, 0.8) == pytest.approx(0.9 * right.torque(omega, 0.8))
    assert low.torque(omega, 0.15) == pytest.approx(right.torque(omega, 0.15), abs=1e-9)


@pytest.mark.slow
def test_a_lap_on_identified_parameters_finishes_within_the_limit(folder: Path) -> None:
    cfg = composed([EXPERIMENT])
    front = read_parameters(folder / "front_axle.json", Pacejka())
    assert front.derived["mean vx"].value == pytest.approx(35.0, abs=8.0)
    car = known_from(folder, AV21, sensitivity=cfg.drive.sensitivity)
    drive, driver = lap(cfg, car, seed=0)
    result = lap_results(drive, driver, cfg.drive)
    assert result["stopped"] == ""
    assert float(result["margin"]) > 0
    assert float(result["lap_time"]) == pytest.approx(driver.plan.lap_time, rel=0.02)


@pytest.mark.slow
def test_a_seed_gives_the_same_rows_again(tmp_path: Path) -> None:
    """All variants on a short stretch, twice; and what is stored is what was returned."""
    cfg = composed([EXPERIMENT])
    cfg.drive.distance = 30.0
    cfg.budget.evaluations = 200
    cfg.comparison.methods.miho.R = 9
    parts = {"drive": cfg.drive, "budget": cfg.budget}
    parts["comparison"] = {"methods": cfg.comparison.methods}
    setting = OmegaConf.to_yaml(OmegaConf.create(parts))
    jobs = [SeedJob(setting, "code", 1, str(tmp_path / name)) for name in ("a", "b")]
    first, second = (laps_of(job) for job in jobs)
    assert first == second == stored_laps(jobs[0])
    assert [row["variant"] for row in first] == [variant.name for variant in VARIANTS]


def test_the_code_of_a_drive_is_all_that_it_uses_and_no_plumbing() -> None:
    used = DRIVING_SOURCES.closure([*DRIVING, LeastSquares.__module__])
    for module in (
        "experiments.driving.settings", "experiments.driving.laps",
        "miho.vehicle.driving.simulation", "miho.vehicle.driving.assembly.from_files",
        "miho.methods.least_squares", "miho.vehicle.models.engine_map", "miho.optim.minimize",
    ):  # fmt: skip
        assert module in used
    assert not [
        name for name in used if name.startswith(("experiments.app", "miho.analysis.pages"))
    ]
    assert not {"miho.methods.tiktak", "miho.data.mat", "baselines.dehb"} & set(used)
