"""Identify the parameters of one model from one dataset; with -m, sweep.

python -m experiments.identify model=pacejka dataset=tire_lf optimizer=miho_gn seed=0
python -m experiments.identify -m optimizer=miho_gn,least_squares 'seed=range(10)' sweep.workers=2
python -m experiments.identify -m experiment=paper_fig6    # the paper's comparison, 70 minutes
"""

from __future__ import annotations

import sys
from pathlib import Path

if not __package__:  # as python experiments/identify.py, like python -m experiments.identify
    sys.path[0] = str(Path(__file__).parents[1])

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from experiments.app.build import build
from experiments.app.console import SOME_FAILED, EndedError, command
from experiments.app.forecast import announce
from experiments.app.plan import request_of, requests, sweep_settings
from experiments.app.run_text import print_summary, result_text
from experiments.app.runs import HERE, run
from miho.study import Status

SETTINGS = {
    "model, dataset, space": "what is identified, from which data, and where to search",
    "problem.parts, problem.local": "several datasets or outputs at once; what is each one's",
    "optimizer, loss": "with which method, and what it minimises",
    "budget.evaluations, budget.seconds": "what a run may spend; it ends at the first of them",
    "seed": "the repetition; with -m several, as in 'seed=range(10)'",
    "workers, evaluation_limit": "what makes evaluations that take long; seconds for one at most",
    "root, fresh": "where results go; fresh=true sets aside what is outdated",
    "space.NAME.low, .high, .scale": "the box of a parameter; 'space={a: {...}}' is a whole one",
    "sweep.workers, .dry_run": "with -m: runs at a time, or their cluster; list them only",
    "hydra/launcher, hydra/sweeper": "with -m: joblib, slurm; optuna tunes settings of a method",
    "tracking": "mlflow: mirror finished runs there",
}


def identify(cfg: DictConfig) -> float | None:
    """Run one composed configuration in this process; gives the error that it reached.

    A single run prints its parameters and its report; a job of a sweep prints one line.
    """
    settings = sweep_settings(cfg.sweep)
    if settings.dry_run:
        plan = requests(cfg, "", [cfg.seed], settings.time_limit)
        print_summary(run(plan, settings).states)
        return None
    is_job = HydraConfig.get().mode is RunMode.MULTIRUN
    experiment = build(cfg)
    if not is_job:
        announce(experiment, cfg.dataset)
    plan = [request_of(experiment, cfg)]
    runs = run(plan, settings, processes=HERE, fresh=cfg.fresh, tracking=cfg.tracking)
    (state,) = runs.states
    if state.line:
        print(state.line, flush=True)
    runs.raise_if_stopped()
    if state.status is Status.FAILED:
        raise EndedError(SOME_FAILED)
    if state.run is not None and not is_job:
        print("\n" + result_text(experiment, state.run))
    return state.error


def main() -> None:
    """The command."""
    command(identify, pool=True, settings=SETTINGS)


if __name__ == "__main__":
    main()
