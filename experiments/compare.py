"""Compare methods on one problem by seconds, or on many problems by evaluations.

On one problem, a comparison is a multirun like `experiments.identify -m`: runs follow one another
on one thread, repetition by repetition. On many problems, several runs share the machine, so
evaluations are compared and seconds are indicative only. Each run has a separate process; if one
is killed, the others continue. The figures, tables and tests follow the last run.

python -m experiments.compare                        # reduced size, about three minutes
python -m experiments.compare experiment=paper_fig6  # full size, about 70 minutes
python -m experiments.compare experiment=torque_gap  # gaps to a known optimum, half a minute
python -m experiments.compare experiment=arena       # many methods on many problems, two hours
python -m experiments.compare experiment=arena_small # the same, small, two minutes
python -m experiments.compare experiment=arena_sets  # two published sets of test problems
"""

import sys
from pathlib import Path

if not __package__:  # as python experiments/compare.py, like python -m experiments.compare
    sys.path[0] = str(Path(__file__).parents[1])

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from experiments.app.comparing import draw, note_on_size, planned_arena
from experiments.app.console import OK, EndedError, command
from experiments.app.explain import ConfigError
from experiments.app.launch import Sweep, typed
from experiments.app.plan import sweep_settings
from experiments.app.run_text import print_summary
from experiments.app.runs import run

CONFIG = "compare"
"""Configuration of the command."""
SETTINGS = {
    "problem, or dataset and model": "what the methods are compared on",
    "experiment": "the comparison; experiment --help lists them",
    "seed, optimizer": "values to sweep over: 'seed=range(5)' optimizer=miho,random",
    "comparison.repetitions, .methods": "repetitions and methods of an arena",
    "sweep.workers, .dry_run": "simultaneous runs, or a cluster; only list the runs",
    "comparison.target": "an arena's run ends at this multiple of the recorded optimum",
    "budget.evaluations, budget.seconds": "limits of a run; it ends at the first one reached",
    "root, fresh": "folder of results; fresh=true sets outdated runs aside",
}


def compare(cfg: DictConfig) -> None:
    """Run an arena (every method on every problem for each repetition), then draw and judge it."""
    if HydraConfig.get().mode is RunMode.MULTIRUN:
        raise ConfigError(
            "hydra/launcher: makes no comparison; leave it out, or write python -m "
            "experiments.identify -m experiment=compare and then python -m experiments.figures fig6"
        )
    words = typed(HydraConfig.get(), CONFIG)
    settings = sweep_settings(cfg.sweep)
    plan, note = planned_arena(cfg, list(HydraConfig.get().overrides.task))
    runs = run(
        plan,
        settings,
        fresh=cfg.fresh,
        command="experiments.compare",
        overrides=words,
        tracking=cfg.tracking,
    )
    if settings.dry_run:
        print_summary(runs.states)
        return
    code = draw(cfg, plan, runs.states, words, note)
    runs.raise_if_stopped()
    if code != OK:
        raise EndedError(code)


def draw_sweep(sweep: Sweep) -> int:
    """Draw and judge the multirun of a comparison on one problem; return the exit code."""
    seeds = {request.identity.seed for request in sweep.plan}
    note = note_on_size(sweep.cfg, [], len(seeds))
    return draw(sweep.cfg, sweep.plan, sweep.states, sweep.typed, note)


def main() -> None:
    """Run the command."""
    command(compare, config_name=CONFIG, pool=True, afterwards=draw_sweep, settings=SETTINGS)


if __name__ == "__main__":
    main()
