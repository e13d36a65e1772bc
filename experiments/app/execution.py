"""Execution of one run, unless it is stored, and its result in one line."""

import math
import sys
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from experiments.app.build import Experiment
from experiments.app.progress import Observer, progress
from miho.identification.line_wrapping import with_unit
from miho.optim import RunRecord, minimize
from miho.parallel import Journal, JournalError, UncheckedJournalError, calls_of
from miho.parallel.usage import Usage
from miho.study import Execution, Identity, Status, Store, execute


def execution_of(experiment: Experiment, *, quiet: bool = False) -> Execution:
    """Execute one run, unless it is stored, with a progress bar unless `quiet`."""
    identity = experiment.identity
    title = name_of(identity)
    store = Store(experiment.root)
    problem = experiment.problem.called(calls_of(store.journal(identity)) or ())  # as it was begun
    facts = replace(experiment, problem=problem).facts

    def job() -> RunRecord:
        path = store.journal(identity)
        try:
            return journaled(path)
        except UncheckedJournalError:  # the journal may be right
            raise
        except JournalError as error:
            aside = path.with_name(f"{path.name}.damaged")
            path.replace(aside)
            print(f"{title}: {error}; set aside as {aside.name}", file=sys.stderr, flush=True)
            return journaled(path)

    def journaled(path: Path) -> RunRecord:
        with closing(Journal(path, problem)) as journal:
            if journal.status:
                print(f"{title}: {journal.status}", file=sys.stderr, flush=True)
            if quiet:
                return search(journal)
            if not sys.stderr.isatty():
                print(f"{title}: running", file=sys.stderr, flush=True)
            with progress(title, experiment.budget, problem.unit) as observer:
                return search(journal, observer)

    def search(journal: Journal, observer: Observer | None = None) -> RunRecord:
        return minimize(
            experiment.optimizer,
            problem,
            experiment.budget,
            identity.seed,
            observer=observer,
            workers=experiment.workers,
            evaluation_limit=experiment.evaluation_limit,
            journal=journal,
        )

    try:
        return execute(store, identity, job, problem.space, facts)
    except UncheckedJournalError as error:
        return Execution(Status.FAILED, error=str(error))


def name_of(identity: Identity) -> str:
    """Problem, method and seed of a run."""
    return f"{identity.problem} {identity.optimizer} seed {identity.seed}"


def result_line(identity: Identity, result: Mapping[str, Any], status: Status) -> str:
    """One line with the run, its error and its cost."""
    error = "no finite value" if result["rejected"] else "no value on all rows of data"
    if result["loss"] is not None:
        error = with_unit(f"{math.sqrt(result['loss']):.5g}", result["facts"]["unit"])
    outside = result.get("outside", 0)
    remark = f", at least {outside:,} of them outside the box" if outside else ""
    usage = Usage(**(result.get("usage") or {"workers": 1}))
    ending = f"({status})" + (f"; {usage}" if usage.workers > 1 else "")
    return (
        f"{name_of(identity)}: {error}, "
        f"{result['evaluations']:,.0f} evaluations{remark}, {result['seconds']:.2f} s {ending}"
    )


def result_error(result: Mapping[str, Any]) -> float | None:
    """Root of the loss, in the unit of the problem; None without a value."""
    return None if result["loss"] is None else math.sqrt(result["loss"])
