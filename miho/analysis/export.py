"""Export runs to CSV and IOHprofiler's format."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from miho.analysis.text import csv_text
from miho.analysis.tidy import comparison, dimensions
from miho.study import read_run, write_text
from miho.study.identity import sha256
from miho.study.settings import is_setting

FORMAT = "0.3.22"
"""Version of IOHexperimenter (PyPI: ioh) with whose output this layout was compared."""
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


def write_ioh(runs: pd.DataFrame, curves: pd.DataFrame, folder: str | Path) -> list[Path]:
    """Write runs in the format of IOHprofiler, one folder per method.

    For each problem there are a JSON file with a row of facts per run and a .dat file with the
    improvements, one run after the other. Problems are numbered from 1 in the order of their names.
    The instance is the seed. `raw_y` is the error (root of the loss, in the problem's unit), not
    the loss. Evaluations on a part of the data count as fractions; the format requires integers, so
    they are rounded up. A run begins at evaluation 1, with inf until the first finite value, and
    ends with its last evaluation.

    Parameters
    ----------
    runs, curves : DataFrame
        See `miho.load_runs`.
    folder : path-like
        A new or empty folder.

    Returns
    -------
    list of Path
        The folders of the methods, sorted by name.

    Raises
    ------
    FileExistsError
        If `folder` is not empty, because readers load every JSON file in it.

    References
    ----------
    J. de Nobel et al., "IOHexperimenter: benchmarking platform for iterative optimization
    heuristics", 2024.
    """
    runs, curves = comparison(runs, curves)
    folder = Path(folder)
    if folder.exists() and any(folder.iterdir()):
        raise FileExistsError(f"{folder} is not empty; pass a new folder")
    # Number the problems, and group the curves by run.
    numbers = {problem: place for place, problem in enumerate(sorted(runs["problem"].unique()), 1)}
    sizes = dimensions(runs)
    steps = {str(run): rows for run, rows in curves.groupby("id")}
    # For each method on each problem a .dat file with all curves, and a JSON file about it.
    for key, group in runs.sort_values("seed").groupby(["optimizer", "problem"]):
        optimizer, problem = map(str, key)
        records = [_steps(steps[run["id"]], run["evaluations"]) for _, run in group.iterrows()]
        # Settings in a name may be paths, which must not lead out of the folder.
        name = f"f{numbers[problem]}_{problem}".replace("/", "_")
        data = Path(f"data_{name}") / f"IOHprofiler_f{numbers[problem]}_DIM{sizes[problem]}.dat"
        facts = {
            "version": FORMAT,
            "suite": "miho",
            "function_id": numbers[problem],
            "function_name": problem,
            "maximization": False,
            "algorithm": {"name": optimizer, "info": f"error in {group['unit'].iloc[0]}"},
            "attributes": ["evaluations", "raw_y"],
            "scenarios": [
                {
                    "dimension": sizes[problem],
                    "path": data.as_posix(),
                    "runs": [
                        _facts(run, record)
                        for (_, run), record in zip(group.iterrows(), records, strict=True)
                    ],
                }
            ],
        }
        path = folder / optimizer.replace("/", "_") / data
        path.parent.mkdir(parents=True)
        path.write_text("".join(map(_text, records)), encoding="utf-8")
        path.parents[1].joinpath(f"IOHprofiler_{name}.json").write_text(
            json.dumps(facts, indent=1, allow_nan=False), encoding="utf-8"
        )
    return sorted(folder.iterdir())


def _steps(curve: pd.DataFrame, spent: float) -> dict[int, float]:
    """Error by whole evaluation, from 1 to the last; the last value of each counts."""
    errors = curve["error"].fillna(math.inf)
    at = np.maximum(np.ceil(curve["evaluations"]), 1).astype(int)
    steps = {1: math.inf} | dict(zip(at.tolist(), errors.tolist(), strict=True))
    return steps | {max(1, math.ceil(spent)): float(errors.iloc[-1])}


def _facts(run: pd.Series[Any], steps: dict[int, float]) -> dict[str, Any]:
    best = min(steps.values())
    reached = next(at for at, error in steps.items() if error == best)
    theta = run.filter(regex=r"^theta\.").dropna()
    return {
        "instance": int(run["seed"]),
        "evals": max(steps),
        "best": {
            "evals": reached,
            "y": best if math.isfinite(best) else None,
            "x": [float(value) for value in theta],
        },
    }


def _text(steps: dict[int, float]) -> str:
    return "evaluations raw_y\n" + "".join(f"{at} {error!r}\n" for at, error in steps.items())
