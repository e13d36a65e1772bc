"""Engine of the paper from the embedded data: three learned curves, dyno, integrated map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from miho.data import Dataset
from miho.identification import CurveFit
from miho.quantities import Array
from miho.vehicle.data import dyno_test
from miho.vehicle.data.synthetic_engine import DYNO_TRUSTED, true_torque
from miho.vehicle.models import EngineMap, TorqueCubic, TorqueCurve
from miho.vehicle.models.engine import RPM

DATASETS = MappingProxyType({0.05: "torque_05", 0.15: "torque_15", 0.2: "torque_20"})
"""Embedded datasets of the throttles with torque learned from driving."""


@dataclass(frozen=True)
class IdentifiedEngine:
    """Problems and learned curves of an engine by throttle opening, all dyno points, and maps.

    One map is of the reliable dyno points only, and one is blended with the learned curves.
    """

    problems: Mapping[float, CurveFit]
    curves: Mapping[float, TorqueCurve]
    dyno: Dataset
    trusted: EngineMap
    integrated: EngineMap

    def samples(self, throttle: float) -> tuple[Array, Array]:
        """Return the engine speeds [rad/s] and torques [Nm] in the data of a curve."""
        dataset = self.problems[throttle].dataset
        return dataset["omega"], dataset["torque"]


def engine_of(
    problems: Mapping[float, CurveFit], thetas: Mapping[float, Array], seed: int = 0
) -> IdentifiedEngine:
    """Return the engine of identified parameters (4,) per throttle, with the dyno of a seed."""
    curves = {
        throttle: learned_curve(problem, thetas[throttle], throttle)
        for throttle, problem in problems.items()
    }
    dyno = dyno_test(seed)
    trusted = trusted_map(dyno)
    integrated = trusted.integrate(list(curves.values()))
    return IdentifiedEngine(problems, curves, dyno, trusted, integrated)


def trusted_map(dyno: Dataset, ratio: float = 1.0) -> EngineMap:
    """Return the map of the reliable dyno points, with `ratio` times the torque of openings."""
    throttle, high = dyno["throttle"], dyno["throttle"] >= DYNO_TRUSTED
    rows, torque = (throttle == 0) | high, dyno["torque"] * np.where(high, ratio, 1.0)
    return EngineMap.from_points(throttle[rows], dyno["omega"][rows], torque[rows])


def learned_curve(problem: CurveFit, theta: Array, throttle: float) -> TorqueCurve:
    """Return the curve of `theta` (4,), valid over the speeds of the problem's data."""
    model, omega = problem.model, problem.dataset["omega"]
    if not isinstance(model, TorqueCubic):
        raise TypeError(f"the model is {type(model).__name__}; expected a TorqueCubic")
    p0, p1, p2, p3 = theta.tolist()
    valid = float(omega.min()), float(omega.max())
    return TorqueCurve((p0, p1, p2, p3), model.omega_max, throttle, valid)


def truth_error(curve: TorqueCurve) -> float:
    """Return the RMSE [Nm] of a curve against the synthetic engine over its valid speeds."""
    omega = np.linspace(*curve.valid, 1000)
    miss = curve.torque(omega) - true_torque(omega, curve.throttle)
    return float(np.sqrt(np.mean(miss**2)))


def fig5_data(engine: IdentifiedEngine) -> dict[str, Any]:
    """Return the arguments of `fig5`, in rpm, percent and Nm."""
    samples, curves, truth, dyno, errors = {}, {}, {}, {}, {}
    for throttle, curve in engine.curves.items():
        percent = 100 * throttle
        omega, torque = engine.samples(throttle)
        valid = np.linspace(*curve.valid, 400)
        samples[percent] = omega / RPM, torque
        curves[percent] = valid / RPM, curve.torque(valid)
        truth[percent] = valid / RPM, true_torque(valid, throttle)
        errors[percent] = float(np.sqrt(np.mean((curve.torque(omega) - torque) ** 2)))
        row = engine.dyno["throttle"] == throttle
        dyno[percent] = engine.dyno["omega"][row] / RPM, engine.dyno["torque"][row]
    misses = ", ".join(f"{truth_error(curve):.1f}" for curve in engine.curves.values())
    table = engine.integrated
    return {
        "samples": samples,
        "curves": curves,
        "rpm": table.speeds / RPM,
        "throttle": 100 * table.openings,
        "torque": table.table,
        "learned": table.learned,
        "truth": truth,
        "dyno": dyno,
        "errors": errors,
        "note": "left: torque from a simulated drive (Eq. 6-7) and learned cubics, whose RMSE is "
        f"over the samples, and {misses} Nm from the true curves; right: dyno rows at 0 % and from "
        "30 % on, learned rows at 5, 15 and 20 %",
    }
