"""Identify the parameters of one model from one dataset; with -m, sweep.

python -m experiments.identify model=pacejka dataset=tire_lf optimizer=miho_gn seed=0
python -m experiments.identify -m optimizer=miho_gn,least_squares 'seed=range(10)' sweep.workers=2
"""

from __future__ import annotations

from collections.abc import Sequence

from hydra.core.override_parser.types import Override
from hydra.types import HydraContext
from omegaconf import DictConfig

from experiments.app.build import build
from experiments.app.console import OK, SOME_FAILED, command
from experiments.app.forecast import announce
from experiments.app.launch import BASIC, FOR_EVERY_JOB, launch_plan
from experiments.app.plan import is_of, planned_sweep, request_of, requests, sweep_settings
from experiments.app.run_text import print_summary, result_text
from experiments.app.runs import HERE, PlanOutcome, run
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
    "tracking": "mlflow: mirror finished runs there",
}


def identify(cfg: DictConfig) -> int:
    """Run one composed configuration in this process and print what was identified.

    As a job of a launcher, with `sweep.seeds`, it does a run for each of these seeds in others.
    """
    settings = sweep_settings(cfg)
    if settings.seeds is not None:
        plan = requests(cfg, "", settings.seeds, settings.time_limit)
        runs = run(plan, settings, fresh=cfg.fresh)
        runs.raise_if_stopped()
        return OK
    if settings.dry_run:
        return _summed_up(run(requests(cfg, "", [cfg.seed], settings.time_limit), settings))
    experiment = build(cfg)
    announce(experiment, cfg.dataset)
    plan = [request_of(experiment, cfg)]
    runs = run(plan, settings, processes=HERE, fresh=cfg.fresh, tracking=cfg.tracking)
    (state,) = runs.states
    if state.line:
        print(state.line, flush=True)
    runs.raise_if_stopped()
    if state.run is not None:
        print("\n" + result_text(experiment, state.run))
    return SOME_FAILED if state.status is Status.FAILED else OK


def sweep(context: HydraContext, cfg: DictConfig, overrides: Sequence[Override]) -> int:
    """Do the runs that the overrides of -m ask for, here or by a launcher."""
    plan, settings = planned_sweep(cfg, overrides), sweep_settings(cfg)
    if cfg.hydra.launcher._target_ != BASIC and not settings.dry_run:
        return _summed_up(launch_plan(plan, identify, context, cfg, overrides))
    words = [str(o.input_line) for o in overrides if not is_of(o.key_or_group, FOR_EVERY_JOB)]
    return _summed_up(run(plan, settings, fresh=cfg.fresh, overrides=words, tracking=cfg.tracking))


def _summed_up(runs: PlanOutcome) -> int:
    code = print_summary(runs.states)
    runs.raise_if_stopped()
    return code


def main() -> None:
    """The command."""
    command(identify, sweep=sweep, settings=SETTINGS)


if __name__ == "__main__":
    main()
