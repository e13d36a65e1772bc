"""Compare methods: on one problem on the clock, or on many problems at once; then draw and judge.

On one problem a comparison is a multirun, as by experiments.identify -m: runs come one at a time,
on one thread, one repetition after the other. On many problems several run at a time, so that
evaluations are compared, and seconds are those of a machine in full use. Runs have processes of
their own, so that one that is killed ends alone.

python -m experiments.compare                        # reduced size, some three minutes
python -m experiments.compare experiment=paper_fig6  # full size, some 70 minutes
python -m experiments.compare experiment=torque_gap  # gaps to a known optimum, half a minute
python -m experiments.compare experiment=arena       # many methods on many problems, 41 minutes
python -m experiments.compare experiment=arena_small # the same, small, two minutes
python -m experiments.compare experiment=arena_sets  # two sets of the literature on optimization
"""

from __future__ import annotations

import sys
from pathlib import Path

if not __package__:  # as python experiments/compare.py, like python -m experiments.compare
    sys.path[0] = str(Path(__file__).parents[1])

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from experiments.app.comparing import draw, note_on_size, planned_arena
from experiments.app.console import OK, EndedError, command
from experiments.app.launch import Sweep
from experiments.app.plan import sweep_settings
from experiments.app.runs import run

SETTINGS = {
    "experiment": "what is compared; experiment --help lists them",
    "seed, optimizer": "both swept over: 'seed=range(5)' optimizer=miho,random",
    "comparison.repetitions, .methods": "repetitions and methods of an arena",
    "comparison.processes": "runs at a time, where several problems are compared",
    "comparison.target": "runs on several problems end at so many times the optimum",
    "budget.evaluations, budget.seconds": "what a run may spend; it ends at the first of them",
    "root, fresh": "where results go; fresh=true sets aside what is outdated",
}


def compare(cfg: DictConfig) -> None:
    """Run an arena: every method on every problem for each repetition, then draw and judge."""
    overrides = [o for o in HydraConfig.get().overrides.task if not o.startswith("seed=")]
    plan, note = planned_arena(cfg, overrides)
    runs = run(
        plan, sweep_settings(cfg.sweep), processes=cfg.comparison.processes, fresh=cfg.fresh,
        overrides=overrides, tracking=cfg.tracking,
    )  # fmt: skip
    code = draw(cfg, plan, runs.states, overrides, note)
    runs.raise_if_stopped()
    if code != OK:
        raise EndedError(code)


def draw_sweep(sweep: Sweep) -> int:
    """Draw and judge the multirun of a comparison on one problem; gives the exit code."""
    seeds = {request.identity.seed for request in sweep.plan}
    note = note_on_size(sweep.cfg, [], len(seeds))
    return draw(sweep.cfg, sweep.plan, sweep.states, sweep.typed, note)


def main() -> None:
    """The command."""
    command(compare, config_name="compare", pool=True, afterwards=draw_sweep, settings=SETTINGS)


if __name__ == "__main__":
    main()
