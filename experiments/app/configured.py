"""What conf/ says now of the problems of runs that are done."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import DictConfig, OmegaConf

from experiments.app import schema
from experiments.app.build import HELD, recorded_optimum
from experiments.app.compose import CONF, composed
from miho.analysis.compare.bootstrap import ENDED_BY_ITSELF
from miho.study import StoredRun, read_run

PROBLEM_PARTS = ("model", "dataset", "space", "loss")
"""What makes a problem, and with it its optimum."""


def as_configured(runs: pd.DataFrame) -> pd.DataFrame:
    """`runs` with `optimum` as conf/problem has it now, and the columns `family` and `cut`.

    An optimum is no part of a run's identity, so the store may hold one that was corrected since.
    What was run with another model, dataset, space or loss than conf/problem has, or has no file
    there, keeps what is stored. Where a problem has a resolution, smaller errors are equal to it,
    and so is the optimum. `cut` is true where a run had spent its seconds before its evaluations
    and had not ended by itself.
    """
    schema.register()
    pieces = []
    for name, on_problem in runs.groupby("problem", sort=False):
        stored = read_run(Path(on_problem["folder"].iloc[0]))
        family = str(name)
        if (CONF / "problem" / f"{name}.yaml").exists():
            cfg = composed([f"problem={name}"])
            family = cfg.problem.family or family
            optimum = recorded_optimum(cfg)
            if optimum is not None and _is_same(stored, cfg):
                error = on_problem["error"].clip(lower=cfg.problem.resolution)
                on_problem = on_problem.assign(optimum=optimum, error=error)
        pieces.append(on_problem.assign(family=family, cut=_cut(on_problem, stored)))
    return pd.concat(pieces).loc[runs.index]


def _is_same(stored: StoredRun, cfg: DictConfig) -> bool:
    if stored.config["problem"].get("parts"):  # no problem there has several
        return False
    return all(_resolved(stored.config[key]) == _resolved(cfg[key]) for key in PROBLEM_PARTS)


def _resolved(node: Any) -> Any:
    """Plain settings; a run stores what became of a box that is `scaled`, and not that it was."""
    plain = OmegaConf.to_container(node, resolve=True) if isinstance(node, DictConfig) else node
    if not isinstance(plain, Mapping):
        return plain
    unset = [key for key in ("scaled", *HELD) if key == "scaled" or plain.get(key) is None]
    return {key: _resolved(value) for key, value in plain.items() if key not in unset}


def _cut(runs: pd.DataFrame, stored: StoredRun) -> pd.Series:
    """All runs of a problem have the budget of the `stored` one."""
    budget = stored.config["budget"]
    late = pd.Series(budget["seconds"] is not None, index=runs.index)
    if budget["seconds"] is not None:
        late &= runs["seconds"] >= budget["seconds"]
    if budget["evaluations"] is not None:
        late &= runs["evaluations"] < budget["evaluations"]
    return late & ~runs["outcome"].isin(ENDED_BY_ITSELF)
