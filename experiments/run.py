"""Run one experiment, unless the store has it, and say in words what came of it."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from experiments.build import Experiment
from experiments.progress import progress
from miho.identification import Square, linear_optimum
from miho.identification.evidence import kind_of
from miho.identification.validation import root_mean_square
from miho.optim import Descents, RunRecord, agreement, in_optimum, minimize
from miho.study import Execution, Identity, Status, Store, StoredRun, execute

ENDINGS = {
    "converged": "itself",
    "brackets": "its largest number of brackets",
    "budget": "its budget",
}


def run(experiment: Experiment, *, quiet: bool = False) -> Execution:
    """Run it, unless quiet with a progress bar, and store what it found."""
    identity, problem = experiment.identity, experiment.problem
    title = f"{identity.problem} {identity.optimizer} seed {identity.seed}"

    def job() -> RunRecord:
        settings = experiment.optimizer, problem, experiment.budget, identity.seed
        if quiet:
            return minimize(*settings)
        if not sys.stderr.isatty():
            print(f"{title}: running", file=sys.stderr, flush=True)
        with progress(title, experiment.budget, problem.unit) as observer:
            return minimize(*settings, observer=observer)

    return execute(Store(experiment.root), identity, job, problem.space, experiment.facts)


def line(experiment: Experiment, execution: Execution) -> str:
    """One line: which run, its error and what it spent, or why there is none."""
    identity = experiment.identity
    head = f"{identity.problem} {identity.optimizer} seed {identity.seed}: "
    if execution.run is None:
        last = (execution.error or "").strip().splitlines()[-1:]
        kept = f"; the next call starts it again (best so far in {execution.partial})"
        return head + ": ".join([str(execution.status), *last]) + kept * bool(execution.partial)
    return result_line(identity, execution.run.result, execution.status)


def result_line(identity: Identity, result: Mapping[str, Any], status: Status) -> str:
    """One line: which run, its error and what it spent."""
    found = "no finite value" if result["rejected"] else "no value on all rows of data"
    if result["loss"] is not None:
        found = f"{math.sqrt(result['loss']):.5g} {result['facts']['unit']}"
    outside = result.get("outside", 0)
    remark = f", at least {outside:,} of them outside of the box" if outside else ""
    return (
        f"{identity.problem} {identity.optimizer} seed {identity.seed}: {found}, "
        f"{result['evaluations']:,.0f} evaluations{remark}, {result['seconds']:.2f} s ({status})"
    )


def report(experiment: Experiment, stored: StoredRun) -> str:
    """The identified parameters, how far to trust them and how good they are; writes the page."""
    # Here, because figures take longer to import than a small run takes: only who draws them waits.
    from experiments.optimum import descents_of, larger_budget
    from experiments.report import report_folder, reported, write
    from experiments.report_tables import error_rows, text

    problem, result = experiment.problem, stored.result
    if result["theta"] is None:
        reasons = ", ".join(f"{n} x {reason}" for reason, n in result["rejected"].items())
        if not reasons:
            return (
                "no configuration was looked at on all rows of data before the budget was spent; "
                f"search again with a larger one: {larger_budget(stored)}"
            )
        return f"no finite value was found: {reasons}"
    unit = problem.unit
    rows: list[tuple[str, str]] = []
    of_run = None
    try:
        of_run = reported(problem, stored)
    except ValueError as reason:
        theta = np.array(result["theta"])
        values = zip(problem.space.parameters, result["theta"], strict=True)
        listed = "\n".join(f"{p.name:<12} {value:.6g} {p.unit}" for p, value in values)
        findings = f"{listed}\n\n- no standard errors: {reason}"
        error = root_mean_square(problem.errors(theta))
        rows.append(("error", f"{error:.5g} {unit} (root mean square)"))
    else:
        theta, findings = of_run.at.theta, text(of_run)
        rows += error_rows(of_run)
        rows.append(("optimum", of_run.standing.evidence))
    loss = float(problem.loss(theta[None])[0])
    if not isinstance(problem.rho, Square):
        name = type(problem.rho).__name__
        rows.append(("loss", f"{math.sqrt(loss):.5g} {unit} (root of the mean {name} loss)"))
    optimum, linear = experiment.facts.get("optimum"), linear_optimum(problem)
    exact = None if linear is None else linear[1]
    if optimum is not None:
        best = min(optimum, loss, result["loss"])
        source = "recorded" if exact is None else "closed form"
        gap, of_the_run = (_gap(each, best) for each in (loss, result["loss"]))
        if gap != of_the_run:
            gap += f"; of the run itself {of_the_run}"
        rows.append(("best known", f"{math.sqrt(best):.5g} {unit} ({source}), gap {gap}"))
    rows += [
        ("evaluations", f"{result['evaluations']:,.0f}"),
        ("seconds", f"{result['seconds']:.3f} (set-up {result['setup_seconds']:.3f})"),
        ("ended by", _ending(result, descents_of(stored), problem.resolution, exact)),
    ]
    if result["rejected"]:
        rows.append(("rejected", ", ".join(f"{n} x {r}" for r, n in result["rejected"].items())))
    if result.get("outside"):
        rows.append(("outside", f"at least {result['outside']:,} evaluations, beyond the box"))
    rows.append(("run", str(stored.folder)))
    if of_run is not None:
        rows.append(("report", str(write(of_run, stored, report_folder(stored)))))
    return findings + "\n\n" + "\n".join(f"{name:<12} {value}" for name, value in rows)


def _gap(loss: float, best: float) -> str:
    """How much larger an error is than the best one."""
    return f"{100 * (math.sqrt(loss / best) - 1) if best else 0.0:.4f} %"


def _ending(
    result: Mapping[str, Any], descents: Descents | None, resolution: float, exact: float | None
) -> str:
    """What ended a run, and how far its descents were; losses closer than `resolution` are one.

    `exact` is the loss of the only optimum, where the problem is linear in all its parameters.
    """
    outcome, loss = str(result["outcome"]), float(result["loss"])
    ending = ENDINGS.get(outcome, outcome)
    if exact is not None and in_optimum(exact, loss, resolution):
        return f"{ending}, in the only optimum: the problem is linear in all its parameters"
    if descents is None:
        return ending
    finished, kind = descents.finished, kind_of([descents])
    agreed = agreement(
        descents.ends, resolution, best=loss, finished=finished, dropped=descents.dropped
    )
    ending += f", {'after' if agreed.enough else 'before'} enough of its {kind} agreed"
    if descents.converged < finished:
        moving = finished - descents.converged
        ending += f"; {moving} of {finished} {kind} were still moving at their end"
    return ending
