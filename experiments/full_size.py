"""In what a comparison that is done differs from the paper's at full size."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import pandas as pd
from omegaconf import DictConfig, OmegaConf

from experiments.app.build import stored_part
from experiments.app.compose import CONF
from miho.analysis.compare.claims import Differences
from miho.study import read_run

FULL_SIZE = "paper_fig6"
"""The experiment that has the size of the paper's comparison."""


def differences(runs: pd.DataFrame) -> Differences:
    """In what stored runs of one comparison differ from the paper's at full size.

    Of methods that have no part in that comparison nothing is said.
    """
    full = cast(DictConfig, OmegaConf.load(CONF / "experiment" / f"{FULL_SIZE}.yaml"))
    methods, budget = {}, ""
    for name, folder in runs.groupby("optimizer")["folder"].first().items():
        stored = read_run(Path(folder))
        budget = _sooner(stored_part(stored, "budget"), full.budget)
        if name not in full.comparison.methods:
            continue
        node = OmegaConf.load(CONF / "optimizer" / f"{name}.yaml")
        expected = OmegaConf.merge(node, full.comparison.methods[name])
        mine = {**stored_part(stored, "optimizer"), "name": name}
        settings = [
            f"{key!s} = {mine.get(str(key))} instead of {value}"
            for key, value in expected.items()
            if mine.get(str(key)) != value
        ]
        if settings:
            methods[str(name)] = f"{name!s} has {', '.join(settings)}"
    return Differences(methods, budget)


def _sooner(budget: Mapping[str, Any], full: DictConfig) -> str:
    """What of a budget ends a run sooner than the full one, in words."""
    parts = []
    for key, unit in (("seconds", "s"), ("evaluations", "evaluations")):
        most, expected = budget.get(key), full[key]
        if isinstance(most, int | float) and (expected is None or most < expected):
            instead = "" if expected is None else f" instead of {expected:,g}"
            parts.append(f"at most {most:,g} {unit} per run{instead}")
    return ", ".join(parts)
