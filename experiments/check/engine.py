"""Accuracy of the identified curves and map of the engine, and the best that a cubic can reach.

    python -m experiments.check.engine [FOLDER]

First, the embedded data, whose truth is known: the three identified curves, and the map with and
without them. Then, if there is a measured engine in the folder engine of FOLDER (else of
MIHO_DATA_DIR, else of ../shared/data next to the checkout), the residuals of the best cubic.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.check import reference_data
from experiments.driving.car import identified_engine
from miho.quantities import Array
from miho.vehicle.data.synthetic_engine import true_torque
from miho.vehicle.driving.assembly.engine import IdentifiedEngine, truth_error
from miho.vehicle.models import EngineMap, TorqueCubic
from miho.vehicle.models.engine import RPM

RANGES = ((1000, 7000), (3500, 7000))
REGIONS = {"learned, 5 to 20 %": (0.05, 0.2), "0 to 30 %": (0.0, 0.3), "30 to 100 %": (0.3, 1.0)}


def closed_form(omega: Array, torque: Array) -> tuple[Array, float]:
    """Parameters (4,) of the least-squares cubic by QR, and its RMSE [Nm]."""
    J = TorqueCubic().jacobian(np.zeros(4), omega)
    Q, R = np.linalg.qr(J)
    theta = np.linalg.solve(R, Q.T @ torque)
    return theta, float(np.sqrt(np.mean((J @ theta - torque) ** 2)))


def curves(engine: IdentifiedEngine) -> pd.DataFrame:
    """One row per identified curve: errors [Nm], and the distance from the closed form."""
    rows = []
    for throttle, curve in engine.curves.items():
        omega, torque = engine.samples(throttle)
        theta, best = closed_form(omega, torque)
        error = float(np.sqrt(np.mean((curve.torque(omega) - torque) ** 2)))
        rows.append(
            {
                "throttle [%]": 100 * throttle,
                "samples": omega.size,
                "from [rpm]": curve.valid[0] / RPM,
                "to [rpm]": curve.valid[1] / RPM,
                "RMSE": error,
                "gap to closed form": error - best,
                "largest parameter gap": float(np.abs(theta - curve.parameters).max()),
                "RMSE against truth": truth_error(curve),
            }
        )
    return pd.DataFrame(rows)


def maps(engine: IdentifiedEngine) -> pd.DataFrame:
    """A row per map: RMSE against the truth by region, correction, order, inverse; all in Nm."""
    speeds = np.linspace(1300, 6500, 261) * RPM
    every = np.linspace(1000, 7000, 601) * RPM
    openings = np.linspace(0, 1, 1001)[:, None]
    rows = []
    by_name: dict[str, EngineMap] = {"dyno": engine.trusted, "integrated": engine.integrated}
    for name, table in by_name.items():
        row: dict[str, object] = {"map": name}
        for region, (low, high) in REGIONS.items():
            throttle = np.linspace(low, high, 101)[:, None]
            miss = table.torque(speeds, throttle) - true_torque(speeds, throttle)
            row[region] = float(np.sqrt(np.mean(miss**2)))
        row["correction"] = float(np.abs(table.correction).max())
        row["least rise"] = float(np.diff(table.torque(every, openings), axis=0).min())
        lowest, highest = table.limits(every)
        torques = lowest + (highest - lowest) * openings
        inside = table.invertible(every, torques)
        row["inverse residual"] = float(table.throttle(every, torques).residual[inside].max())
        rows.append(row)
    return pd.DataFrame(rows)


def measured(path: Path) -> pd.DataFrame:
    """RMSE [Nm] of the best cubic on a measured engine, a row per throttle, a column per range."""
    data = pd.read_csv(path)
    rpm = data["rpm"].to_numpy(dtype=float)
    rows = []
    for column in data.columns.drop("rpm"):
        torque = data[column].to_numpy(dtype=float)
        row: dict[str, object] = {"throttle [%]": column.rpartition("_")[2]}
        for low, high in RANGES:
            part = (low <= rpm) & (rpm <= high)
            row[f"{low} to {high} rpm"] = closed_form(rpm[part] * RPM, torque[part])[1]
        rows.append(row)
    return pd.DataFrame(rows)


def show(title: str, table: pd.DataFrame) -> None:
    """Print one table."""
    print(f"{title}\n\n{table.to_string(index=False, float_format='%.3g')}\n")


def main() -> None:
    """Print the tables."""
    with tempfile.TemporaryDirectory() as root:
        engine = identified_engine(Path(root))
    show("Learned curves, embedded drive [Nm]", curves(engine))
    show("Maps against the true engine, 1300 to 6500 rpm [Nm]", maps(engine))
    folder = reference_data() / "engine"
    files = sorted(folder.glob("*.csv"))
    for file in files:
        show(f"What the best cubic leaves of {file.stem} [Nm]", measured(file))
    if not files:
        print(f"no measured engine in {folder}; set MIHO_DATA_DIR to the folder of engine")


if __name__ == "__main__":
    main()
