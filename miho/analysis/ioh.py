"""Runs in the format of IOHprofiler, for iohinspector and IOHanalyzer."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from miho.analysis.tidy import comparison, dimensions

FORMAT = "0.3.22"
"""Version of IOHexperimenter (PyPI: ioh) whose output this layout was compared with."""


def write_ioh(runs: pd.DataFrame, curves: pd.DataFrame, folder: str | Path) -> list[Path]:
    """Write one folder per method below `folder`; returns them, sorted by name.

    Layout (de Nobel et al. 2024, "IOHexperimenter"): per problem a JSON file with a row of facts
    per run, and a .dat file with the improvements, runs one after the other. Problems are numbered
    from 1 in the order of their names; the instance is the seed; `raw_y` is the error (root of the
    loss, in the problem's unit), not the loss. Evaluations on a part of the data count as that
    part of one, the format knows whole ones: they are rounded up. A run's file begins at
    evaluation 1, with inf where nothing finite was seen yet, and ends with what was spent.

    Raises FileExistsError if `folder` holds anything: readers take every JSON file they find.
    """
    runs, curves = comparison(runs, curves)
    folder = Path(folder)
    if folder.exists() and any(folder.iterdir()):
        raise FileExistsError(f"{folder} is not empty; pass a new folder")
    numbers = {problem: place for place, problem in enumerate(sorted(runs["problem"].unique()), 1)}
    sizes = dimensions(runs)
    steps = {str(run): rows for run, rows in curves.groupby("id")}
    for key, mine in runs.sort_values("seed").groupby(["optimizer", "problem"]):
        optimizer, problem = map(str, key)
        records = [_steps(steps[run["id"]], run["evaluations"]) for _, run in mine.iterrows()]
        name = f"f{numbers[problem]}_{problem}"
        data = Path(f"data_{name}") / f"IOHprofiler_f{numbers[problem]}_DIM{sizes[problem]}.dat"
        facts = {
            "version": FORMAT,
            "suite": "miho",
            "function_id": numbers[problem],
            "function_name": problem,
            "maximization": False,
            "algorithm": {"name": optimizer, "info": f"error in {mine['unit'].iloc[0]}"},
            "attributes": ["evaluations", "raw_y"],
            "scenarios": [
                {
                    "dimension": sizes[problem],
                    "path": data.as_posix(),
                    "runs": [
                        _facts(run, record)
                        for (_, run), record in zip(mine.iterrows(), records, strict=True)
                    ],
                }
            ],
        }
        path = folder / optimizer / data
        path.parent.mkdir(parents=True)
        path.write_text("".join(map(_text, records)), encoding="utf-8")
        path.parents[1].joinpath(f"IOHprofiler_{name}.json").write_text(
            json.dumps(facts, indent=1, allow_nan=False), encoding="utf-8"
        )
    return sorted(folder.iterdir())


def _steps(curve: pd.DataFrame, spent: float) -> dict[int, float]:
    """Error by whole evaluation, the last one of each; from 1 to what was spent."""
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
