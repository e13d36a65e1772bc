"""Identify the parameters of one model from one dataset; with -m, sweep.

python -m experiments.identify model=pacejka dataset=tire_lf optimizer=miho_gn seed=0
python -m experiments.identify -m optimizer=miho_gn,least_squares 'seed=range(10)' sweep.processes=2
"""

from __future__ import annotations

import shlex
from collections import Counter
from functools import partial

import pandas as pd
from omegaconf import DictConfig

from experiments.build import build
from experiments.cli import OK, SOME_FAILED, command
from experiments.forecast import announce
from experiments.run import line, report, run
from experiments.sweep import Done, mirrors, sweep, wanted
from experiments.sweep_command import finished, run_sweep, sweep_settings
from miho.study import Status, Store
from miho.study.changes import refuse_changes

SETTINGS = {
    "model, dataset, space": "what is identified, from which data, and where to search",
    "optimizer, loss": "with which method, and what it minimises",
    "budget.evaluations, budget.seconds": "what a run may spend; it ends at the first of them",
    "seed": "the repetition; with -m several, as in 'seed=range(10)'",
    "root, fresh": "where results go; fresh=true sets aside what is outdated",
    "space.NAME.low, .high, .scale": "the box of a parameter; 'space={a: {...}}' is a whole one",
    "sweep.processes, .dry_run": "with -m: how many runs at a time; list the runs and do none",
    "tracking": "mlflow: mirror finished runs there",
}
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
    announce(experiment, cfg.dataset)
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
    for root in dict.fromkeys(done.wanted.root for done in finished if done.error is not None):
        print(_report_of(root))
    counts = Counter(done.status for done in finished)
    told = ", ".join(f"{counts[status]} {status}" for status in Status if counts[status])
    print(f"{len(finished)} runs: {told}")
    return SOME_FAILED if bad else OK


def _report_of(root: str) -> str:
    """The command that reports on the runs of a root; --trust where their model is a file."""
    models = (done.wanted.identity.config["model"] for done in finished if done.wanted.root == root)
    files = sorted({str(model["path"]) for model in models if "path" in model})
    what = f" (--trust runs {', '.join(files)})" if files else ""
    trust = " --trust" if files else ""
    return f"how far to trust the best of them{what}: " + (
        f"python -m experiments.report {shlex.quote(root)}{trust}"
    )


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


def main() -> None:
    """The command."""
    command(identify, summary, sweep=partial(run_sweep, identify), settings=SETTINGS)


if __name__ == "__main__":
    main()
