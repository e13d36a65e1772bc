"""Current facts in conf/ about the problems of finished runs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import DictConfig, OmegaConf

from experiments.app.build import HELD, recorded_optimum
from experiments.app.compose import composed, option_folders, searching
from experiments.app.options import options_of
from miho.analysis.compare.bootstrap import ENDED_BY_ITSELF
from miho.study import StoredRun, read_run

PROBLEM_PARTS = ("model", "dataset", "space", "loss")
"""Nodes that define a problem, and hence its optimum."""


def as_configured(runs: pd.DataFrame, folder: Path | None = None) -> pd.DataFrame:
    """Add the current `optimum` of conf/problem and the columns `family` and `cut` to `runs`.

    An optimum is not part of a run's identity, so a stored one may have been corrected since. Runs
    with another model, dataset, space or loss than conf/problem, or that it does not name, keep the
    stored optimum. Problems of `folder`, and inside a command of its --config-dir, count too. If a
    problem has a resolution, smaller errors and optima are set to it. `cut` is true if a run used
    up its seconds before its evaluations and did not converge.
    """
    folders = [*option_folders(), *([] if folder is None else [folder])]
    pieces = []
    for name, on_problem in runs.groupby("problem", sort=False):
        stored = read_run(Path(on_problem["folder"].iloc[0]))
        family = str(name)
        if family in options_of("problem", folders):
            cfg = composed([f"problem={family}", *searching(folder)])
            family = cfg.problem.family or family
            optimum = recorded_optimum(cfg)
            if optimum is not None and _is_same(stored, cfg):
                error = on_problem["error"].clip(lower=cfg.problem.resolution)
                on_problem = on_problem.assign(optimum=optimum, error=error)
        pieces.append(on_problem.assign(family=family, cut=_cut(on_problem, stored)))
    return pd.concat(pieces).loc[runs.index]


def _is_same(stored: StoredRun, cfg: DictConfig) -> bool:
    if stored.config["problem"].get("parts"):  # conf/problem has no joint problems
        return False
    return all(_resolved(stored.config[key]) == _resolved(cfg[key]) for key in PROBLEM_PARTS)


def _resolved(node: Any) -> Any:
    """Plain settings without `scaled`: a run stores only the resulting numbers of a scaled box."""
    plain = OmegaConf.to_container(node, resolve=True) if isinstance(node, DictConfig) else node
    if not isinstance(plain, Mapping):
        return plain
    unset = [key for key in ("scaled", *HELD) if key == "scaled" or plain.get(key) is None]
    return {key: _resolved(value) for key, value in plain.items() if key not in unset}


def _cut(runs: pd.DataFrame, stored: StoredRun) -> pd.Series:
    """Column `cut` of runs that all have the budget of the `stored` one."""
    budget = stored.config["budget"]
    late = pd.Series(budget["seconds"] is not None, index=runs.index)
    if budget["seconds"] is not None:
        late &= runs["seconds"] >= budget["seconds"]
    if budget["evaluations"] is not None:
        late &= runs["evaluations"] < budget["evaluations"]
    return late & ~runs["outcome"].isin(ENDED_BY_ITSELF)
