"""Identify the parameters of a model from a dataset; with -m, sweep over several settings.

python -m experiments.identify model=pacejka dataset=tire_lf optimizer=miho_gn seed=0
python -m experiments.identify -m optimizer=miho_gn,least_squares 'seed=range(10)' sweep.workers=2
python -m experiments.identify -m experiment=paper_fig6    # the paper's comparison, 70 minutes
"""

import sys
from dataclasses import replace
from pathlib import Path

if not __package__:  # as python experiments/identify.py, like python -m experiments.identify
    sys.path[0] = str(Path(__file__).parents[1])

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from experiments.app.build import ConfigError, build
from experiments.app.compose import as_typed
from experiments.app.console import SOME_FAILED, EndedError, command
from experiments.app.forecast import announce
from experiments.app.plan import Trials, request_of, requests, sweep_settings
from experiments.app.run_text import print_summary, result_text
from experiments.app.runs import run
from miho.identification.line_wrapping import for_terminal
from miho.study import Status

SETTINGS = {
    "model, dataset, space": "the model, its data, and the box of the parameters",
    "problem.parts, problem.local": "several datasets or outputs at once; parameters of each part",
    "optimizer, loss": "the method, and the loss that it minimises",
    "budget.evaluations, budget.seconds": "limits of a run; it ends at the first one reached",
    "seed": "seed of the run; with -m several, as in 'seed=range(10)'",
    "workers, evaluation_limit": "processes for expensive evaluations; seconds allowed for one",
    "root, fresh": "folder of results; fresh=true sets outdated runs aside",
    "space.NAME.low, .high, .scale": "range of a parameter; 'space={a: {...}}' replaces the box",
    "sweep.workers, .dry_run": "with -m: simultaneous runs, or a cluster; only list the runs",
    "hydra/launcher, hydra/sweeper": "with -m: joblib, slurm; optuna tunes settings of a method",
    "tracking": "mlflow copies finished runs to MLflow",
}


def identify(cfg: DictConfig) -> float | None:
    """Run one composed configuration in this process and return its error.

    A single run prints its parameters and its report. A job of a sweep prints one line.
    """
    settings = sweep_settings(cfg.sweep)
    if settings.dry_run:
        with Trials(settings.time_limit) as trials:
            plan = requests(cfg, "", [cfg.seed], trials)
        print_summary(run(plan, settings).states)
        return None
    hydra = HydraConfig.get()
    is_job = hydra.mode is RunMode.MULTIRUN
    for text in as_typed(hydra.overrides.task):
        if text.lstrip("+").startswith("sweep."):
            raise ConfigError(
                f"{text}: is for a sweep, -m, with hydra/launcher=pool; workers=2 makes the "
                "evaluations of a run in two processes"
            )
    experiment = build(cfg)
    if not is_job:
        announce(experiment, cfg.dataset)
    folder = Path(hydra.runtime.output_dir) if hydra.job.chdir else None
    if folder is not None:
        experiment = replace(experiment, root=experiment.root.absolute())
    plan = [request_of(experiment, cfg)]
    runs = run(plan, settings, here=True, folder=folder, fresh=cfg.fresh, tracking=cfg.tracking)
    (state,) = runs.states
    if state.line:
        print(state.line, flush=True)
    runs.raise_if_stopped()
    if state.status is Status.FAILED:
        raise EndedError(SOME_FAILED)
    if state.run is not None and not is_job:
        print("\n" + for_terminal(result_text(experiment, state.run)))
    return state.error


def main() -> None:
    """The command."""
    command(identify, pool=True, settings=SETTINGS)


if __name__ == "__main__":
    main()
