"""Identify the parameters of one model from one dataset; with -m, sweep.

python -m experiments.identify model=pacejka dataset=tire_lf optimizer=miho seed=0
python -m experiments.identify -m optimizer=miho,pso_100 'seed=range(10)' sweep.processes=2
"""

from __future__ import annotations

from collections import Counter

import pandas as pd
from omegaconf import DictConfig

from experiments.build import build
from experiments.cli import OK, SOME_FAILED, command
from experiments.run import line, report, run
from experiments.sweep import Done, mirrors, sweep, wanted
from experiments.sweep_command import finished, sweep_settings
from miho.study import Status, Store
from miho.study.changes import refuse_changes

failed: list[str] = []


def identify(cfg: DictConfig) -> None:
    """Run one composed configuration and print what was identified.

    As a job of a launcher, with `sweep.seeds`, it does a run for each of these seeds.
    """
    settings = sweep_settings(cfg)
    if settings.seeds is not None or settings.dry_run:
        seeds = [cfg.seed] if settings.seeds is None else settings.seeds
        runs = wanted(cfg, "", seeds)
        sweep(runs, settings, fresh=cfg.fresh, tracking=cfg.tracking, ended=finished)
        return
    experiment = build(cfg)
    refuse_changes(Store(experiment.root), [experiment.identity], fresh=cfg.fresh)
    with mirrors([str(experiment.root)], cfg.tracking) as mirrored:
        execution = run(experiment)
        if execution.run is not None and mirrored:
            mirrored[str(experiment.root)].push(execution.run)
    told = line(experiment, execution)
    print(told, flush=True)
    if execution.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if execution.status is Status.FAILED:
        failed.append(told)
    if execution.run is not None:
        print("\n" + report(experiment, execution.run))


def summary() -> int:
    """Say what became of the runs of a sweep; the exit code of the command."""
    if not finished:
        return SOME_FAILED if failed else OK
    listed = all(done.status in (Status.TO_DO, Status.DONE_BEFORE) for done in finished)
    if listed:
        print("\n".join(done.line for done in finished if done.line))
    _tell_errors(finished)
    bad = [done for done in finished if done.reason is not None]
    for done in bad:
        print(f"{done.status}: {done.wanted.asked}: {done.reason}")
    roots = dict.fromkeys(done.wanted.root for done in finished if done.error is not None)
    for root in roots:
        print(f"how far to trust the best of them: python -m experiments.report {root}")
    counts = Counter(done.status for done in finished)
    told = ", ".join(f"{counts[status]} {status}" for status in Status if counts[status])
    print(f"{len(finished)} runs: {told}")
    return SOME_FAILED if bad else OK


def _tell_errors(runs: list[Done]) -> None:
    """A line per problem and method: how many runs, and their errors."""
    found = [
        (done.wanted.identity.problem, done.wanted.identity.optimizer, done.error)
        for done in runs
        if done.error is not None
    ]
    if found:
        table = pd.DataFrame(found, columns=["problem", "method", "error"])
        errors = table.groupby(["problem", "method"])["error"]
        print(errors.agg(["count", "min", "median", "max"]).to_string(float_format="%.5g"))


if __name__ == "__main__":
    command(identify, lambda cfg: wanted(cfg, "", [cfg.seed]), summary)
