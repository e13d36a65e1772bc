"""Accuracy of the brake models: round trips, recovered parameters, a law from a driving log.

    python -m experiments.check.brake [FOLDER]

The embedded brake test is identified by multistart least squares and compared with the true brake.
The driving log is av21_putnam in FOLDER, else in MIHO_DATA_DIR, else in ../shared/data next to the
checkout; without it, that part is left out. Its law is linear, so the fit is ordinary least
squares. Samples of one braking are not independent; the table therefore has the standard errors of
independent samples, and intervals of a bootstrap over whole brakings.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.console import run_and_exit
from experiments.app.schema import register
from experiments.check import reference_data
from miho.data import Dataset
from miho.data.csv import read_numbers
from miho.optim import minimize
from miho.quantities import Array
from miho.vehicle.data import DrivingLog, load_driving_log
from miho.vehicle.data.braking_samples import braking_samples
from miho.vehicle.data.synthetic_brake import DRAG, EMBEDDED_BRAKE, MASS, RESISTANCE
from miho.vehicle.models import Brake, BrakeDeceleration

FILE = "av21_putnam/Putnam_park2023_run4_2.csv"
PUBLISHED = np.array([2.52e-6, 5.9e-4, 1.24])  # the AV-21's law on this log, c_p per Pa
RESAMPLES = 2000


def main() -> None:
    """Print all figures."""
    register()
    print("Embedded test: parameters")
    table, identified = embedded_test()
    print(table.to_string(index=False, float_format="%.4g"))
    print(f"{'bias':>20} {identified.bias:.5f}, true {EMBEDDED_BRAKE.bias:.5f}")
    round_trips(identified)

    path = reference_data() / FILE
    if not path.is_file():
        print(f"\nDriving log: none at {path}; set MIHO_DATA_DIR to the folder of av21_putnam")
        return
    driving(path)


CURVE = ("u0", "u1", "P_max", "n")
RESPONSE = ("delay", "tau_rise", "tau_fall")


def embedded_test() -> tuple[pd.DataFrame, Brake]:
    """All parameters with the true values, and the resulting brake."""
    fits = [
        fit("brake_pressure", {name: getattr(EMBEDDED_BRAKE, name) for name in CURVE}),
        fit("brake_torque", {"K": EMBEDDED_BRAKE.K_front, "P0": EMBEDDED_BRAKE.P0_front}),
        fit(
            "brake_torque",
            {"K": EMBEDDED_BRAKE.K_rear, "P0": EMBEDDED_BRAKE.P0_rear},
            "dataset.axle=rear",
        ),
        fit("brake_step", {name: getattr(EMBEDDED_BRAKE, name) for name in RESPONSE}),
        fit("brake_deceleration", true_law()),
    ]
    curve, front, rear, response = (frame["found"] for frame in fits[:4])
    identified = replace(
        EMBEDDED_BRAKE,
        **dict(zip((*CURVE, *RESPONSE), (*curve, *response), strict=True)),
        **dict(zip(("K_front", "P0_front", "K_rear", "P0_rear"), (*front, *rear), strict=True)),
        bias=bias(build(composed(["dataset=brake_pressure"])).problem.dataset),
    )
    return pd.concat(fits), identified


def true_law() -> dict[str, float]:
    """Coefficients c_p, c_v, c_0 of the embedded car, from its brake and resistances."""
    high, low = (float(EMBEDDED_BRAKE.force_of_pressure(p)) for p in (2e6, 1e6))
    offset = low - (high - low)
    return {
        "c_p": (high - low) / 1e6 / MASS,
        "c_v": DRAG / MASS,
        "c_0": (offset + RESISTANCE) / MASS,
    }


def fit(dataset: str, true: dict[str, float], *overrides: str) -> pd.DataFrame:
    """Parameters by least squares with standard errors and true values."""
    experiment = build(composed([f"dataset={dataset}", "optimizer=least_squares", *overrides]))
    problem = experiment.problem
    record = minimize(experiment.optimizer, problem, experiment.budget)
    theta = np.array(record.theta)
    errors = standard_errors(problem.jacobian(theta), problem.residuals(theta))
    names = list(problem.space.names)
    values = np.array([true[name] for name in names])
    return pd.DataFrame(
        {
            "dataset": problem.dataset.name,
            "parameter": names,
            "true": values,
            "found": theta,
            "standard error": errors,
            "error %": 100 * (theta - values) / values,
            "in errors": (theta - values) / errors,
        }
    )


def standard_errors(jacobian: Array, residuals: Array) -> Array:
    """Standard errors (d,) of a least-squares fit, for independent residuals."""
    rows, columns = jacobian.shape
    variance = residuals @ residuals / (rows - columns)
    scale = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.inv((jacobian / scale).T @ (jacobian / scale))
    return np.asarray(np.sqrt(variance * np.diag(inverse)) / scale)


def bias(dataset: Dataset) -> float:
    """Share of the front pressure, from the slope of the rear over the front pressure through 0."""
    front, rear = dataset["p"], dataset["p_rear"]
    return float(1 / (1 + rear @ front / (front @ front)))


def round_trips(identified: Brake) -> None:
    """Print the errors of force to command to force, of the model and against the true brake."""
    forces, model_error, error = round_trip_errors(identified)
    largest = forces[-1]
    print("\nRound trip force -> command -> force")
    alone = f"at most {model_error.max():.1e} relative"
    print(f"  model alone, {forces[0]:.0f} to {largest:.0f} N: {alone}")
    for share in (0.005, 0.01, 0.02, 0.05, 0.1):
        selected = forces >= share * largest
        print(
            f"  identified command, true force, from {share * largest:.0f} N "
            f"({100 * share:g} % of the largest): at most {100 * error[selected].max():.2f} %"
        )
    above = forces[np.flatnonzero(error > 0.01)[-1] + 1] if (error > 0.01).any() else forces[0]
    print(f"  within 1 % from {above:.0f} N, {100 * above / largest:.2f} % of {largest:.0f} N")
    print(f"  largest error {(error * forces).max():.1f} N; beyond, the brake is saturated")


def round_trip_errors(identified: Brake) -> tuple[Array, Array, Array]:
    """Forces [N] (n,), and relative errors after a round trip of the model and the true brake."""
    largest = min(EMBEDDED_BRAKE.largest_force, identified.largest_force)
    forces = np.geomspace(1e-3 * largest, largest, 20_000)
    command = identified.command(forces)
    model_error, true_error = (
        np.abs(brake.force(command.u) / forces - 1) for brake in (identified, EMBEDDED_BRAKE)
    )
    return forces, model_error, true_error


def driving(path: Path) -> None:
    """The law of a driving log, from each source of its deceleration."""
    columns = ["time", "vx", "vy", "yaw_rate", "ax", "throttle", "brake"]
    units = ["s", "m/s", "m/s", "rad/s", "m/s^2", "%", "kPa"]
    headers = [
        "# time(s)", "vx(m/s)", "vy(m/s)", "omega(rad/s)", "ax(m/s^2)", "throttle_ped_cmd(%)",
        "brake_ped_cmd(kPa)",
    ]  # fmt: skip
    # In this log vy rises with the yaw rate as it would 1.5 m ahead of the centre of gravity.
    logged = load_driving_log(path, columns, units, headers, sensor_x=1.5, accelerometer=False)
    # Two sources of the speed, and with them of the deceleration; the logged ax lags.
    channels = {key: logged[key] for key in columns if key != "ax"}
    wheels = read_numbers(path, ["wheel_fl(kmph)", "wheel_fr(kmph)"], header=True)
    front = channels | {"vx": np.mean(list(wheels.values()), axis=0) / 3.6}
    speeds = {"vx": DrivingLog("vx", channels), "front wheels": DrivingLog("front", front)}
    rate = speeds["vx"].rate("vx", 1.0)
    ax = logged.filtered("ax", 1.0)
    lag = best_lag(rate, ax)
    print("\nDriving log: deceleration = c_p p + c_v vx^2 + c_0, as ratios to the known law")
    print(
        f"  logged ax lags the rate of vx by {lag * logged.dt:.2f} s (correlation "
        f"{correlation(rate, ax, 0):.2f} as it is, {correlation(rate, ax, lag):.2f} shifted) "
        f"and reaches {ax.min():.1f} m/s^2, the rate {rate.min():.1f}"
    )
    print(f"  known: {PUBLISHED[0]:.2e} per Pa, {PUBLISHED[1]:.1e}, {PUBLISHED[2]:.2f}")
    logs = {"ax": logged, **speeds}
    print(pd.DataFrame(law(source, log) for source, log in logs.items()).to_string(index=False))


def law(source: str, log: DrivingLog) -> dict[str, object]:
    """Row with estimates, naive standard errors and intervals, relative to the known law."""
    samples = braking_samples(log)
    inputs = samples["p"], samples["vx"]
    A = BrakeDeceleration().jacobian(np.zeros(3), *inputs)
    scale = np.linalg.norm(A, axis=0)
    y = samples["deceleration"]
    theta = np.linalg.lstsq(A / scale, y)[0] / scale
    errors = standard_errors(A, A @ theta - y) / PUBLISHED
    events = samples["event"]
    blocks = [np.flatnonzero(events == event) for event in np.unique(events)]
    rng = np.random.default_rng(0)
    draws = np.array(
        [
            np.linalg.lstsq(A[rows] / scale, y[rows])[0] / scale
            for rows in (
                np.concatenate([blocks[i] for i in rng.integers(len(blocks), size=len(blocks))])
                for _ in range(RESAMPLES)
            )
        ]
    )
    low, high = np.quantile(draws, [0.025, 0.975], axis=0) / PUBLISHED
    row: dict[str, object] = {"speed": source, "n": len(y), "brakings": len(blocks)}
    for name, value, error, a, b in zip(
        ("c_p", "c_v", "c_0"), theta / PUBLISHED, errors, low, high, strict=True
    ):
        row[name] = f"{value:.2f} +- {error:.2f} [{a:.2f}, {b:.2f}]"
    row["rmse"] = f"{np.std(y - A @ theta):.2f}"
    return row


def best_lag(first: Array, second: Array) -> int:
    """Number of samples by which the second signal lags the first."""
    return max(range(60), key=lambda lag: correlation(first, second, lag))


def correlation(first: Array, second: Array, lag: int) -> float:
    """Correlation of the first signal with the second moved back by `lag` samples."""
    return float(np.corrcoef(first[: first.size - lag], second[lag:])[0, 1])


if __name__ == "__main__":
    run_and_exit(main)
