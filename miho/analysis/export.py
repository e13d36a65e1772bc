"""Export runs to CSV."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd

from miho.analysis.text import csv_text
from miho.study import read_run, write_text
from miho.study.identity import sha256
from miho.study.settings import is_setting

COLUMNS = "columns.json"
MEANING = {
    "id": ("", "hash of configuration, code, data and seed"),
    "problem": ("", "model and data"),
    "optimizer": ("", "method"),
    "seed": ("", "repetition; one seed gives all methods the same start"),
    "outcome": ("", "how the run ended: budget, converged, brackets or no_finite_value"),
    "error": ("see column unit of the runs", "root of the loss, best so far"),
    "unit": ("", "unit of the error"),
    "evaluations": ("evaluations of the loss", "used so far, including fractions"),
    "seconds": ("s", "wall clock of the method alone"),
    "cpu_seconds": ("s", "processor time of the method alone"),
    "setup_seconds": ("s", "imports and tracing before the clock starts, not in seconds"),
    "irreducible": ("see column unit", "estimated smallest error of any model of these inputs"),
    "irreducible_low": ("see column unit", "lower end of that estimate's 95 % interval"),
    "irreducible_high": ("see column unit", "upper end of it"),
    "optimum": ("see column unit", "smallest error in the space, if it is known"),
    "dimension": ("", "number of parameters"),
    "timing_valid": ("", "whether the machine was quiet enough for the seconds to be compared"),
    "folder": ("", "folder of the run"),
}
"""Unit and meaning of the columns of `miho.load_runs`."""


def write_csv(runs: pd.DataFrame, curves: pd.DataFrame, folder: Path) -> None:
    """Write runs.csv and curves.csv in UTF-8, with the shortest text that restores each number.

    Python's `float` restores numbers bit for bit, and so does `pandas.read_csv` from pandas 3.1 on;
    older versions need `float_precision="round_trip"`. An empty field is an unknown number. Text
    that a spreadsheet would run as a formula gets a leading apostrophe, because results can come
    from others.

    Parameters
    ----------
    runs, curves : DataFrame
        See `miho.load_runs`.
    folder : Path
        Folder of the files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / COLUMNS).unlink(missing_ok=True)
    files: dict[str, Any] = {}
    units = _units(runs)
    for name, table in {"runs.csv": runs, "curves.csv": curves}.items():
        columns = {str(key): _column(str(key), kind, units) for key, kind in table.dtypes.items()}
        text = csv_text(table)
        write_text(folder / name, text)
        files[name] = {"sha256": sha256(text), "rows": len(table), "columns": columns}
    reader = 'pandas.read_csv(path), before pandas 3.1 with float_precision="round_trip"'
    write_text(folder / COLUMNS, json.dumps({"read with": reader, "files": files}, indent=1) + "\n")


def _column(name: str, kind: object, units: dict[str, dict[str, str]]) -> dict[str, Any]:
    if name.startswith("theta."):
        meaning = "value of the parameter at the best point; empty if the problem lacks it"
        return {"type": str(kind), "unit": units.get(name, {}), "meaning": meaning}
    if is_setting(name):
        meaning = "setting of the run, by its name on the command line; empty if there is none"
        return {"type": str(kind), "unit": "", "meaning": meaning}
    unit, meaning = MEANING.get(name, ("", ""))
    return {"type": str(kind), "unit": unit, "meaning": meaning}


def _units(runs: pd.DataFrame) -> dict[str, dict[str, str]]:
    """The unit of each parameter by problem, from one run of each."""
    units: dict[str, dict[str, str]] = {}
    for problem, folder in runs.drop_duplicates("problem")[["problem", "folder"]].to_numpy():
        for parameter in read_run(Path(folder)).result["parameters"]:
            units.setdefault(f"theta.{parameter['name']}", {})[problem] = parameter["unit"]
    return units
