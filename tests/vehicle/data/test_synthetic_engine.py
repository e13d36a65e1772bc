"""The synthetic engine: its facts, its dyno, and that a drive gives back its curves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.app.compose import composed
from experiments.driving.car import identified_parts
from miho.vehicle.data import dyno_test, engine_driving_log, load_engine_drive
from miho.vehicle.data.synthetic_engine import CAR, DYNO_TRUSTED, HELD_THROTTLES, STEP, true_torque
from miho.vehicle.driving.assembly.engine import (
    DATASETS,
    IdentifiedEngine,
    engine_of,
    truth_error,
)
from miho.vehicle.models import TorqueCubic
from miho.vehicle.models.engine import RPM

RPMS = np.linspace(1000, 7000, 601)
THROTTLES = np.linspace(0, 1, 401)[:, None]


def test_the_engine_has_the_torque_and_power_of_its_class() -> None:
    full = true_torque(RPMS * RPM, 1.0)
    assert full.max() == pytest.approx(527, abs=0.5)
    assert RPMS[full.argmax()] == pytest.approx(4900, abs=50)
    power = full * RPMS * RPM
    assert power.max() == pytest.approx(318e3, abs=1e3)
    assert RPMS[power.argmax()] == pytest.approx(6100, abs=100)


def test_more_throttle_is_more_torque_at_every_speed_but_hardly_above_80_percent() -> None:
    torque = true_torque(RPMS * RPM, THROTTLES)
    assert np.diff(torque, axis=0).min() > 0
    assert (torque[0] < 0).all()
    assert (torque[-1] - true_torque(RPMS * RPM, 0.8)).max() < 0.06 * torque.max()


def test_the_turbo_spools_up_from_3000_to_3600_rpm() -> None:
    for throttle in (0.5, 0.8, 1.0):
        rise = true_torque(np.array([2400, 3000, 3600, 4200]) * RPM, throttle)
        before, spool, after = np.diff(rise)
        assert spool > 3 * max(abs(before), abs(after))
    rise = true_torque(np.array([3000, 3600]) * RPM, 0.2)
    assert rise[1] < rise[0]


def test_the_dyno_is_good_where_it_can_be_trusted_and_bad_between() -> None:
    """Over seeds: 2 Nm of noise against rows that are wrong by 20 to 40 Nm."""
    good, bad = [], []
    for seed in range(5):
        test = dyno_test(seed)
        error = test["torque"] - true_torque(test["omega"], test["throttle"])
        trusted = (test["throttle"] == 0) | (test["throttle"] >= DYNO_TRUSTED)
        good.append(error[trusted])
        bad += [error[test["throttle"] == t] for t in np.unique(test["throttle"][~trusted])]
    assert np.concatenate(good).std() == pytest.approx(2, rel=0.1)
    assert abs(np.concatenate(good).mean()) < 0.2
    assert min(abs(row.mean()) for row in bad) > 12
    assert dyno_test(1).digest == dyno_test(1).digest != dyno_test(2).digest


def test_the_drive_goes_through_the_gears_and_holds_each_throttle() -> None:
    log = engine_driving_log()
    assert set(np.unique(log["gear"])) == {0, 1, 2, 3, 4}
    assert log["vx"].min() > 5
    assert log["engine_speed"].max() < 7000 * RPM
    for throttle in HELD_THROTTLES:
        held = np.abs(log["throttle"] - throttle) < 0.01
        assert held.sum() * STEP > 60
        assert np.ptp(log["engine_speed"][held]) > 5000 * RPM


def test_the_clutch_slips_after_a_shift_and_only_there() -> None:
    """Two gears at least two seconds after any shift: the engine turns as fast as the wheels."""
    log = engine_driving_log()
    gear = log["gear"]
    wheels = CAR.engine_speed(log["vx"], np.maximum(gear, 1))
    slip = np.abs(log["engine_speed"] - wheels) / wheels
    shifts = np.flatnonzero(np.diff(gear))
    settled = np.ones(len(log), dtype=bool)
    for shift in shifts:
        settled[max(0, shift - 5) : shift + 50] = False
    assert slip[settled].max() < 0.06  # noise of 2 rad/s and 0.03 m/s at 140 rad/s
    assert slip[shifts + 2].max() > 0.2


def test_speed_is_the_integral_of_the_accelerometer_without_the_grade() -> None:
    """What the channels say fits together: over 10 s the noise leaves 0.15 m/s."""
    log = engine_driving_log()
    motion = log["ax"] - 9.80665 * np.sin(log["grade"])
    gained = np.concatenate([[0], np.cumsum(motion[:-1]) * STEP])
    window = round(10 / STEP)
    error = (log["vx"][window:] - log["vx"][:-window]) - (gained[window:] - gained[:-window])
    assert error.std() < 0.2
    assert abs(error.mean()) < 0.02


@pytest.mark.parametrize("throttle", HELD_THROTTLES)
def test_the_drive_gives_back_the_curve_of_each_held_throttle(throttle: float) -> None:
    """Least squares on the torque samples of Eq. 6-7: within 5 Nm of the truth, RMSE."""
    samples = load_engine_drive(throttle)
    assert samples.name == f"torque_{round(100 * throttle):02d}"
    assert len(samples) > 1000
    omega = samples["omega"]
    assert omega.min() < 1500 * RPM < 6500 * RPM < omega.max()
    error = samples["torque"] - true_torque(omega, throttle)
    assert abs(error.mean()) < 1
    assert error.std() < 8
    model = TorqueCubic()
    theta = np.linalg.lstsq(model.jacobian(np.zeros(4), omega), samples["torque"])[0]
    valid = np.linspace(omega.min(), omega.max(), 500)
    miss = model.predict(theta[None], valid)[0] - true_torque(valid, throttle)
    assert np.sqrt(np.mean(miss**2)) < 5


def identified_engine(root: Path) -> IdentifiedEngine:
    """Engine map with the curves at 5, 15 and 20 % throttle, identified by least squares."""
    cfg = composed(["optimizer=least_squares", f"root={root}"])
    parts = identified_parts(cfg, tuple(DATASETS.values()))
    problems = {throttle: parts[name][0] for throttle, name in DATASETS.items()}
    thetas = {throttle: parts[name][1] for throttle, name in DATASETS.items()}
    return engine_of(problems, thetas, cfg.seed)


def test_the_map_of_the_embedded_data_is_near_the_engine(tmp_path: Path) -> None:
    """The figures of docs/results.md and docs/paper.md, to half of their last digit.

    Where curves were learned, 16 Nm of the dyno become less than 2; inverse and order hold.
    """
    engine = identified_engine(tmp_path)
    omega, throttle = np.linspace(1300, 6500, 261) * RPM, np.linspace(0.05, 0.2, 101)[:, None]
    true = true_torque(omega, throttle)
    dyno, learned = (
        float(np.sqrt(np.mean((table.torque(omega, throttle) - true) ** 2)))
        for table in (engine.trusted, engine.integrated)
    )
    assert dyno == pytest.approx(16.3, abs=0.05)
    assert learned == pytest.approx(1.8, abs=0.05)
    errors = [truth_error(curve) for curve in engine.curves.values()]
    assert errors == pytest.approx([0.5, 1.3, 2.7], abs=0.05)
    for opening, curve in engine.curves.items():
        samples, torque = engine.samples(opening)
        J = TorqueCubic().jacobian(np.zeros(4), samples)
        best = np.linalg.norm(J @ np.linalg.lstsq(J, torque)[0] - torque)
        assert np.linalg.norm(curve.torque(samples) - torque) == pytest.approx(best, rel=1e-10)
    every = np.linspace(1000, 7000, 241) * RPM
    assert np.diff(engine.integrated.torque(every, THROTTLES), axis=0).min() > -1e-10
    low, high = engine.integrated.limits(every)
    torque = low + (high - low) * THROTTLES
    inside = (low <= torque) & (torque <= high)
    assert inside.mean() > 0.99  # but for rounding, all
    assert engine.integrated.throttle(every, torque).residual[inside].max() < 1e-11
    delivered = true_torque(every, engine.integrated.throttle(every, torque).opening)
    assert np.sqrt(np.mean((delivered - torque) ** 2)) < 10


def test_a_drive_has_a_seed_and_known_throttles() -> None:
    assert load_engine_drive(0.15, 3).digest == load_engine_drive(0.15, 3).digest
    assert load_engine_drive(0.15, 3).digest != load_engine_drive(0.15, 4).digest
    with pytest.raises(ValueError, match=r"throttle is 0\.1; expected one of"):
        load_engine_drive(0.1)
    with pytest.raises(ValueError, match="seed is -1"):
        load_engine_drive(0.15, -1)
    with pytest.raises(ValueError, match="seed is -1"):
        dyno_test(-1)
