"""The embedded brake test, what is identified from it, and braking in a driving log."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from miho.data import Dataset
from miho.data.csv import read_numbers
from miho.models import Model
from miho.quantities import Array
from miho.vehicle.data import (
    DrivingLog,
    brake_deceleration_test,
    brake_pressure_test,
    brake_step_test,
    brake_torque_test,
    load_braking_samples,
    load_driving_log,
)
from miho.vehicle.data.braking_samples import braking_samples
from miho.vehicle.data.synthetic_brake import DRAG, EMBEDDED_BRAKE, MASS, RESISTANCE
from miho.vehicle.models import BrakeDeceleration, BrakePressure, BrakeResponse, BrakeTorque

TESTS = (brake_pressure_test, brake_torque_test, brake_step_test, brake_deceleration_test)
LAW = np.array([2.52e-6, 5.9e-4, 1.24])


def fitted(model: Model, data: Dataset, start: list[float]) -> tuple[Array, Array]:
    """Parameters and their standard errors, by least squares in units of the start."""
    inputs, scale = [data[name] for name in model.inputs], np.array(start)

    def residuals(x: Array) -> Array:
        return np.asarray(model.predict((x * scale)[None], *inputs)[0] - data[data.output])

    def jacobian(x: Array) -> Array:
        return np.asarray(model.jacobian(x * scale, *inputs) * scale)

    solution = least_squares(residuals, np.ones(scale.size), jac=jacobian, x_scale="jac")
    J = jacobian(solution.x)
    variance = 2 * solution.cost / (len(data) - scale.size)
    errors = np.sqrt(variance * np.diag(np.linalg.inv(J.T @ J)))
    return solution.x * scale, errors * scale


def true(*names: str) -> Array:
    return np.array([getattr(EMBEDDED_BRAKE, name) for name in names])


def test_the_brake_has_the_size_of_an_av21() -> None:
    slope = (EMBEDDED_BRAKE.force_of_pressure(3e6) - EMBEDDED_BRAKE.force_of_pressure(1e6)) / 2e3
    assert slope == pytest.approx(2.0, rel=0.01), "N per kPa"
    assert EMBEDDED_BRAKE.P_max == 6e6
    assert 0.54 <= EMBEDDED_BRAKE.bias <= 0.60


@pytest.mark.parametrize("seed", range(3))
def test_force_to_command_to_force_with_what_is_identified(seed: int) -> None:
    """Within 0.5 % from a twentieth of the largest force, and within 2.2 % from a hundredth.

    The command is of the identified brake, the force of the true one.
    """
    curve, _ = fitted(BrakePressure(), brake_pressure_test(seed), [0.05, 0.9, 5e6, 1.2])
    front, _ = fitted(BrakeTorque(), brake_torque_test("front", seed), [3e-4, 4e4])
    rear, _ = fitted(BrakeTorque(), brake_torque_test("rear", seed), [3e-4, 4e4])
    names = ("u0", "u1", "P_max", "n", "K_front", "P0_front", "K_rear", "P0_rear")
    values = np.concatenate([curve, front, rear]).tolist()
    identified = replace(EMBEDDED_BRAKE, **dict(zip(names, values, strict=True)))
    largest = min(identified.largest_force, EMBEDDED_BRAKE.largest_force)
    for share, limit in ((0.05, 0.0055), (0.01, 0.0225)):  # the figures of docs/results.md, rounded
        forces = np.geomspace(share * largest, largest, 2000)
        command = identified.command(forces).u
        np.testing.assert_allclose(EMBEDDED_BRAKE.force(command), forces, rtol=limit)
        np.testing.assert_allclose(identified.force(command), forces, rtol=1e-9)


@pytest.mark.parametrize(
    ("model", "data", "names", "start"),
    [
        (BrakePressure(), brake_pressure_test(), ("u0", "u1", "P_max", "n"), [0.05, 0.9, 5e6, 1.2]),
        (BrakeTorque(), brake_torque_test(), ("K_front", "P0_front"), [3e-4, 4e4]),
        (BrakeTorque(), brake_torque_test("rear"), ("K_rear", "P0_rear"), [3e-4, 4e4]),
        (BrakeResponse(), brake_step_test(), ("delay", "tau_rise", "tau_fall"), [0.03, 0.2, 0.05]),
    ],
)
def test_parameters_are_recovered(
    model: Model, data: Dataset, names: tuple[str, ...], start: list[float]
) -> None:
    """Within four standard errors, none above 5 %: the test tells the parameters apart."""
    theta, errors = fitted(model, data, start)
    assert (np.abs(theta - true(*names)) < 4 * errors).all()
    assert (errors < 0.05 * true(*names)).all()


def test_the_deceleration_law_is_recovered() -> None:
    data = brake_deceleration_test()
    theta, errors = fitted(BrakeDeceleration(), data, LAW.tolist())
    low, high = (EMBEDDED_BRAKE.force_of_pressure(p) for p in (1e6, 2e6))
    law = np.array([(high - low) / 1e6, DRAG, 2 * low - high + RESISTANCE]) / MASS
    assert (np.abs(theta - law) < 4 * errors).all()
    assert (errors < 0.02 * law).all()


def test_speeds_of_the_deceleration_test_solve_the_equation_of_motion() -> None:
    data = brake_deceleration_test(noise=0.0, samples=5)
    force = float(EMBEDDED_BRAKE.force_of_pressure(3.5e6))

    def rate(_: float, v: Array) -> Array:
        return -(force + DRAG * v * v + RESISTANCE) / MASS

    t = np.linspace(0, 1, 5)
    solved = solve_ivp(rate, (0, 1), [60.0], t_eval=t, rtol=1e-10).y[0]
    phase = (data["p"] == 3.5e6) & (np.arange(len(data)) >= 24 * 5)
    np.testing.assert_allclose(data["vx"][phase], solved, rtol=1e-8)


def test_the_staircase_reaches_saturation() -> None:
    """Otherwise u1 and P_max could not be told apart."""
    data = brake_pressure_test()
    assert (data["u"] > EMBEDDED_BRAKE.u1).mean() > 0.05
    assert data["p_rear"].max() == pytest.approx(6e6 * 0.43 / 0.57, rel=0.01)


@pytest.mark.parametrize("test", TESTS)
def test_the_seed_decides_the_noise(test: object) -> None:
    assert callable(test)
    assert test().digest == test(seed=0).digest != test(seed=1).digest


def test_bad_settings_are_named() -> None:
    with pytest.raises(ValueError, match="axle is 'middle'; expected one of front, rear"):
        brake_torque_test("middle")
    with pytest.raises(ValueError, match="seed is -1"):
        brake_pressure_test(seed=-1)
    with pytest.raises(ValueError, match=r"noise is -1\.0; expected a number of at least 0"):
        brake_step_test(noise=-1.0)
    with pytest.raises(ValueError, match="steps is 1; expected a number of at least 2"):
        brake_torque_test(steps=1)
    with pytest.raises(ValueError, match=r"duration is 0\.0; expected a positive number"):
        brake_deceleration_test(duration=0.0)


@cache
def simulated_log(grade: float = 0.0) -> DrivingLog:
    """Three brakings with ramps of pressure, in steps of 0.02 s, by Euler steps of 1 ms."""
    time = np.arange(60_000) * 1e-3
    phase = time % 20.0
    p = np.clip(np.minimum(phase - 12.0, 19.0 - phase), 0.0, 1.0) * 4e5 * (1 + time // 20)
    throttle = np.where(phase < 11.5, 0.5, 0.0)
    vx = np.empty(time.size)
    speed = 30.0
    for i in range(time.size):
        vx[i] = speed
        if throttle[i]:
            rate = (45.0 - 5.0 * (time[i] // 20) - speed) / 3.0
        else:
            rate = -(LAW[0] * p[i] + LAW[1] * speed**2 + LAW[2] + 9.80665 * np.sin(grade))
        speed += 1e-3 * rate
    channels = {"time": time, "brake": p, "throttle": throttle, "vx": vx}
    if grade:
        channels["grade"] = np.full(time.size, grade)
    return DrivingLog("drive", {key: values[::20] for key, values in channels.items()})


def law_of(samples: Dataset, rows: slice | NDArray[np.intp] = slice(None)) -> Array:
    p, vx, deceleration = (samples[name][rows] for name in ("p", "vx", "deceleration"))
    A = BrakeDeceleration().jacobian(np.zeros(3), p, vx)
    scale = np.linalg.norm(A, axis=0)
    return np.asarray(np.linalg.lstsq(A / scale, deceleration)[0] / scale)


@pytest.mark.parametrize("grade", [0.0, 0.03])
def test_the_law_of_a_simulated_log(grade: float) -> None:
    """To 0.5 %, with ramps of pressure in every braking."""
    samples = braking_samples(simulated_log(grade), min_speed=5.0)
    assert set(samples["event"]) == {1.0, 2.0, 3.0}
    assert law_of(samples) == pytest.approx(LAW, rel=0.005)


def hard_driving(duration: float, turning: float = 0.0) -> DrivingLog:
    """Two minutes of full drive for 4 s, then constant pressure for some seconds, without noise.

    In turns of `turning` [rad/s] the steered wheels drag another 1 m/s^2, and vy is -0.05 vx.
    """
    dt, rng = 0.02, np.random.default_rng(0)
    rows, speed = [], 50.0
    while len(rows) < 120 / dt:
        pressure = rng.uniform(5e5, 3e6)
        for _ in range(200):
            rows.append((speed, 0.0, 0.6, 0.0))
            speed += dt * min(6.0, 3 * (70 - speed))
        yaw_rate = turning * rng.integers(2)
        for _ in range(int(duration / dt)):
            rows.append((speed, pressure, 0.0, yaw_rate))
            force = LAW @ [pressure, speed**2, 1] + (1.0 if yaw_rate else 0.0)
            speed -= dt * (force + 0.05 * speed * yaw_rate)
    channels = dict(zip(("vx", "brake", "throttle", "yaw_rate"), np.array(rows).T, strict=True))
    if turning:
        channels["vy"] = -0.05 * channels["vx"]
    else:
        del channels["yaw_rate"]
    return DrivingLog("hard", channels | {"time": dt * np.arange(len(rows))})


@pytest.mark.parametrize(
    ("duration", "cutoff", "tolerance"), [(3.0, 1.0, 0.02), (3.0, 3.0, 0.005), (1.5, 3.0, 0.05)]
)
def test_the_drive_does_not_leak_into_the_law(
    duration: float, cutoff: float, tolerance: float
) -> None:
    """Without the 1 / cutoff left out at both ends, 3 s at 1 Hz give a c_0 of 0.4."""
    samples = braking_samples(hard_driving(duration), cutoff)
    assert law_of(samples) == pytest.approx(LAW, rel=tolerance)
    t, event = samples["t"], samples["event"]
    longest = max(np.ptp(t[event == number]) for number in np.unique(event))
    assert longest == pytest.approx(duration - 2 / cutoff, abs=0.041)


def test_turns_are_left_out_and_their_speed_is_allowed_for() -> None:
    """The drag of steered wheels is dropped; allowed for at will, it is found in c_0."""
    log = hard_driving(3.0, turning=0.2)
    assert law_of(braking_samples(log)) == pytest.approx(LAW, rel=0.01)
    turning = np.abs(log["vx"] * log["yaw_rate"]) > 3.0
    t = braking_samples(log)["t"]
    assert not turning[np.searchsorted(log["time"], t)].any()
    slow = braking_samples(log, max_lateral=np.inf)
    assert len(slow) > len(t)
    in_turns = log["yaw_rate"][np.searchsorted(log["time"], slow["t"])] > 0
    expected = LAW @ np.array([slow["p"], slow["vx"] ** 2, np.ones(len(slow))]) + in_turns
    assert slow["deceleration"] == pytest.approx(expected, abs=0.1)


def test_only_braking_is_selected() -> None:
    """The pressure passes 200 kPa at 12.5 s: from there on count settle and 1 / cutoff."""
    log = simulated_log()
    for settle, first in ((0.0, 1 / 3), (0.6, 0.6)):
        samples = braking_samples(log, min_pressure=2e5, min_speed=12.0, settle=settle)
        rows = np.searchsorted(log["time"], samples["t"])
        assert (log["brake"][rows] > 2e5).all()
        assert (log["vx"][rows] > 12.0).all()
        assert (log["throttle"][rows] == 0.0).all()
        began = samples["t"][samples["event"] == 1.0][0]
        assert began == pytest.approx(12.5 + first, abs=0.041)
    with pytest.raises(ValueError, match=r"no sample of 3000 has brake above 9e\+09 Pa"):
        braking_samples(log, min_pressure=9e9)
    with pytest.raises(ValueError, match="cutoff is 0 Hz"):
        braking_samples(log, cutoff=0.0)
    with pytest.raises(ValueError, match=r"settle is -1"):
        braking_samples(log, settle=-1.0)


def test_a_log_file_in_other_units(tmp_path: Path) -> None:
    log = simulated_log()
    rows = np.column_stack(
        [log["time"], log["vx"] * 3.6, log["throttle"] * 100, log["brake"] / 1e3]
    )
    path = tmp_path / "my drive.csv"
    np.savetxt(path, rows, delimiter=",", header="t,v,thr,brk", comments="", fmt="%.12g")
    columns, headers = ["time", "vx", "throttle", "brake"], ["t", "v", "thr", "brk"]
    loaded = load_braking_samples(
        str(path), columns, ["s", "km/h", "%", "kPa"], headers, min_speed=5.0
    )
    assert loaded.name == "my_drive_braking"
    assert law_of(loaded) == pytest.approx(law_of(braking_samples(log, min_speed=5.0)), rel=1e-6)


def test_the_law_of_an_av21_at_putnam(reference_data: Path) -> None:
    """By vx: the pressure's figure within 10 %, and all known ones inside 95 % intervals.

    By the wheels that are not driven, c_p is 10 % high. The ten brakings of a second or two,
    resampled as a whole each, leave the speed's figure open: its interval is wider than three
    times the known value. Nor is c_0 known to 10 %; turns alone move it by a quarter. The figures
    are in docs/results.md.
    """
    path = reference_data / "av21_putnam" / "Putnam_park2023_run4_2.csv"
    columns = ["time", "vx", "vy", "yaw_rate", "throttle", "brake"]
    units = ["s", "m/s", "m/s", "rad/s", "%", "kPa"]
    headers = [
        "# time(s)", "vx(m/s)", "vy(m/s)", "omega(rad/s)", "throttle_ped_cmd(%)",
        "brake_ped_cmd(kPa)",
    ]  # fmt: skip
    log = load_driving_log(path, columns, units, headers, sensor_x=1.5)
    wheels = read_numbers(path, ["wheel_fl(kmph)", "wheel_fr(kmph)"], header=True)
    rolling = {"vx": np.mean(list(wheels.values()), axis=0) / 3.6}
    wheels_law = law_of(braking_samples(DrivingLog("wheels", dict(log.channels) | rolling)))
    assert wheels_law[0] == pytest.approx(LAW[0], rel=0.15)
    samples = braking_samples(log)
    assert (law_of(samples) / LAW)[[0, 2]] == pytest.approx([1.09, 0.95], abs=0.005)
    numbers, rng = np.unique(samples["event"]), np.random.default_rng(0)
    blocks = [np.flatnonzero(samples["event"] == number) for number in numbers]
    assert len(blocks) == 10
    draws = [
        law_of(samples, np.concatenate([blocks[i] for i in rng.integers(10, size=10)]))
        for _ in range(2000)
    ]
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    assert ((low < LAW) & (high > LAW)).all()
    assert (high - low)[1] > 3 * LAW[1]
    for k, interval in ((0, [0.97, 1.37]), (2, [0.39, 1.22])):
        assert [low[k] / LAW[k], high[k] / LAW[k]] == pytest.approx(interval, abs=0.005)
