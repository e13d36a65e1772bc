"""How far the Magic Formula is from the reference values, per file and slip-angle mode.

    python -m experiments.benchmarks.magic_formula_check [FOLDER]

The reference is the folder mf_reference of FOLDER, else of MIHO_DATA_DIR, else of ../shared/data
beside the checkout. Errors are the largest over all points, relative to the largest force (or
moment) in the file.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from miho.models.tir import load_tir

MODES = {"alpha": ("mfeval111", False), "alpha*": ("mfeval121", True)}


def relative_errors(tir: Path) -> pd.DataFrame:
    """Largest relative error of Fx, Fy, Mz, one row per mode; the values stand in tir's .csv."""
    tire = load_tir(tir)
    points = pd.read_csv(tir.with_suffix(".csv"))
    inputs = {name: points[name].to_numpy() for name in ("Fz", "kappa", "alpha", "gamma", "Vx")}
    pressure = points["p"].to_numpy()
    rows = []
    for mode, (suffix, alpha_star) in MODES.items():
        forces = tire.forces(**inputs, pressure=pressure, alpha_star=alpha_star)._asdict()
        expected = {name: points[f"{name}_{suffix}"].to_numpy() for name in forces}
        errors = {
            name: np.abs(forces[name] - expected[name]).max() / np.abs(expected[name]).max()
            for name in forces
        }
        rows.append({"file": tir.stem, "mode": mode, "points": len(points), **errors})
    return pd.DataFrame(rows)


def main() -> int:
    """Print the table; 2 if the reference is not there."""
    default = Path(__file__).parents[3] / "shared" / "data"
    named = sys.argv[1] if len(sys.argv) > 1 else os.environ.get("MIHO_DATA_DIR", default)
    files = sorted((Path(named) / "mf_reference").glob("*.tir"))
    if not files:
        print(f"error: no reference in {named}; set MIHO_DATA_DIR to the folder of mf_reference")
        return 2
    table = pd.concat([relative_errors(file) for file in files], ignore_index=True)
    print(table.to_string(index=False, float_format="%.1e"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
