"""All runs of a root as tidy tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from miho.study.store import RESULT, DamagedRun, StoredRun, read_run

RUN_COLUMNS = [
    "id", "problem", "optimizer", "seed", "outcome", "error", "unit", "evaluations", "seconds",
    "cpu_seconds", "setup_seconds", "irreducible", "optimum", "dimension", "folder",
]  # fmt: skip
CURVE_COLUMNS = [
    "id", "problem", "optimizer", "seed", "evaluations", "seconds", "cpu_seconds", "error"
]  # fmt: skip


@dataclass(frozen=True)
class Runs:
    """What a root holds.

    `runs`: a row per finished run; `error` is the root of its loss in `unit`, `irreducible` an
    estimate of the error that no model of the same inputs can beat, `optimum` the smallest error in
    the space where it is known (else NaN), `dimension` the number of parameters and `theta.<name>`
    their values.
    `curves`: a row per improvement and one at the end of each run; a step function.
    `damaged`: folders that were skipped, with the reason.
    """

    runs: pd.DataFrame
    curves: pd.DataFrame
    damaged: pd.DataFrame


def load_runs(root: str | Path) -> Runs:
    """Read every finished run below `root`; what is damaged is listed and skipped.

    Raises FileNotFoundError if the root does not exist.
    """
    root = Path(root)
    if not root.is_dir():
        raise FileNotFoundError(f"{root}: no such folder of runs; run something first")
    runs: list[dict[str, Any]] = []
    curves: dict[str, list[Any]] = {column: [] for column in CURVE_COLUMNS}
    damaged: list[dict[str, str]] = []
    for path in sorted(root.rglob(RESULT)):
        try:
            stored = read_run(path.parent)
        except DamagedRun as error:
            damaged.append({"folder": str(path.parent), "reason": str(error)})
            continue
        runs.append(_run_row(stored))
        _extend(curves, stored)
    return Runs(
        pd.DataFrame(runs) if runs else pd.DataFrame(columns=RUN_COLUMNS),
        pd.DataFrame(curves),
        pd.DataFrame(damaged, columns=["folder", "reason"]),
    )


def _run_row(stored: StoredRun) -> dict[str, Any]:
    result = stored.result
    facts: Mapping[str, Any] = result["facts"]
    loss = result["loss"]
    row = {
        **{key: result[key] for key in ("id", "problem", "optimizer", "seed", "outcome")},
        "error": _root(loss),
        "unit": facts.get("unit"),
        **{key: result[key] for key in ("evaluations", "seconds", "cpu_seconds", "setup_seconds")},
        "irreducible": facts.get("irreducible", math.nan),
        "optimum": _root(facts.get("optimum")),
        "dimension": len(result["parameters"]),
        "folder": str(stored.folder),
    }
    theta = result["theta"] or [math.nan] * len(result["parameters"])
    names = [parameter["name"] for parameter in result["parameters"]]
    return row | {f"theta.{name}": value for name, value in zip(names, theta, strict=True)}


def _root(loss: float | None) -> float:
    """The error that belongs to a loss, NaN where there is none."""
    return math.nan if loss is None or loss < 0 else math.sqrt(loss)


def _extend(curves: dict[str, list[Any]], stored: StoredRun) -> None:
    curve, result = stored.curve, stored.result
    for key in ("evaluations", "seconds", "cpu_seconds"):
        curves[key].extend(curve[key])
    curves["error"].extend(map(_root, curve["loss"]))
    for key in ("id", "problem", "optimizer", "seed"):
        curves[key].extend([result[key]] * len(curve["loss"]))
