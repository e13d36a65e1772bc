"""Run one experiment, unless the store has it, and say in words what came of it."""

from __future__ import annotations

import math
import sys
from functools import cache

import numpy as np

from experiments.build import Experiment
from experiments.progress import progress
from miho.identification import CurveFit, Square, linear_optimum
from miho.identification.validation import error_on, root_mean_square
from miho.methods.least_squares import LeastSquares
from miho.optim import Budget, RunRecord, minimize
from miho.study import Execution, Store, StoredRun, execute

ENDINGS = {"converged": "itself", "budget": "its budget"}


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
    result = execution.run.result
    found = "no finite value"
    if result["loss"] is not None:
        found = f"{math.sqrt(result['loss']):.5g} {experiment.problem.unit}"
    outside = result.get("outside", 0)
    remark = f", at least {outside:,} of them outside of the box" if outside else ""
    return (
        f"{head}{found}, {result['evaluations']:,.0f} evaluations{remark}, "
        f"{result['seconds']:.2f} s ({execution.status})"
    )


def report(experiment: Experiment, stored: StoredRun) -> str:
    """The identified parameters, how far to trust them and how good they are; writes the page."""
    # Here, because figures take longer to import than a small run takes: only who draws them waits.
    from experiments.report import report_folder, reported, write
    from experiments.report_tables import text

    problem, result = experiment.problem, stored.result
    if result["theta"] is None:
        reasons = ", ".join(f"{n} x {reason}" for reason, n in result["rejected"].items())
        return f"no finite value was found: {reasons}"
    error, unit = math.sqrt(result["loss"]), problem.unit
    known, source = best_known_error(problem)
    best = min(known, error)
    gap = f"gap {100 * (error / best - 1) if best else 0:.4f} % ({source})"
    rows = []
    measured = root_mean_square(problem.errors(np.array(result["theta"])))
    rows.append(("error", f"{measured:.5g} {unit} (root mean square)"))
    held_out = problem.dataset.held_out
    if held_out is not None:
        unseen = error_on(problem, np.array(result["theta"]), held_out)
        rows.append(("held out", f"{unseen:.5g} {unit} ({len(held_out)} rows)"))
    irreducible = experiment.facts.get("irreducible")
    if irreducible is not None:
        reached = "; this fit reaches it" if measured < 1.02 * irreducible else ""
        rows.append(
            ("irreducible", f"about {irreducible:.4g} {unit}, from neighbouring points{reached}")
        )
    if not isinstance(problem.rho, Square):
        name = type(problem.rho).__name__
        rows.append(("loss", f"{error:.5g} {unit} (root of the mean {name} loss)"))
    rows += [
        ("best known", f"{best:.5g} {unit}, {gap}"),
        ("evaluations", f"{result['evaluations']:,.0f}"),
        ("seconds", f"{result['seconds']:.3f} (set-up {result['setup_seconds']:.3f})"),
        ("ended by", ENDINGS.get(result["outcome"], result["outcome"])),
    ]
    if result["rejected"]:
        rows.append(("rejected", ", ".join(f"{n} x {r}" for r, n in result["rejected"].items())))
    if result.get("outside"):
        rows.append(("outside", f"at least {result['outside']:,} evaluations, beyond the box"))
    rows.append(("run", str(stored.folder)))
    try:
        made = reported(problem, stored)
        findings = text(made)
        rows.append(("report", str(write(made, stored, report_folder(stored)))))
    except ValueError as problem_of_report:
        values = zip(problem.space.parameters, result["theta"], strict=True)
        found = "\n".join(f"{p.name:<12} {value:.6g} {p.unit}" for p, value in values)
        findings = f"{found}\n\n- no standard errors: {problem_of_report}"
    return findings + "\n\n" + "\n".join(f"{name:<12} {told}" for name, told in rows)


@cache
def best_known_error(problem: CurveFit) -> tuple[float, str]:
    """The smallest error known of a problem, in its unit, and whence it is known.

    The closed-form optimum of a model linear in all its parameters; of other models, that of
    thorough multi-start least squares.
    """
    exact = linear_optimum(problem)
    if exact is not None:
        return math.sqrt(exact[1]), "closed form"
    solver = LeastSquares(screen=3000, starts=10, rounds=1)
    found = minimize(solver, problem, Budget(evaluations=200_000)).loss
    return math.sqrt(found), "this run or multi-start least squares"
