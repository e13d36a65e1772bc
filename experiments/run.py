"""Run one experiment, unless the store has it, and say in words what came of it."""

from __future__ import annotations

import math
import sys
from functools import cache

import pandas as pd

from baselines.least_squares import LeastSquares
from experiments.build import Experiment
from experiments.progress import progress
from miho.identification import CurveFit
from miho.optim import Budget, Parameter, RunRecord, minimize
from miho.study import Execution, Store, StoredRun, execute

BEST_KNOWN = "this run or multi-start least squares"
ENDINGS = {"converged": "itself", "budget": "its budget"}
SUSPICIOUS = 2.0


def run(experiment: Experiment) -> Execution:
    """Run it with a progress bar and store what it found."""
    identity, problem = experiment.identity, experiment.problem
    title = f"{identity.problem} {identity.optimizer} seed {identity.seed}"

    def job() -> RunRecord:
        if not sys.stderr.isatty():
            print(f"{title}: running", file=sys.stderr, flush=True)
        with progress(title, experiment.budget, problem.unit) as observer:
            return minimize(
                experiment.optimizer,
                problem,
                experiment.budget,
                identity.seed,
                observer=observer,
            )

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
    error = "no finite value" if result["loss"] is None else f"{math.sqrt(result['loss']):.2f}"
    return (
        f"{head}{error} {experiment.problem.unit}, {result['evaluations']:,.0f} evaluations, "
        f"{result['seconds']:.2f} s ({execution.status})"
    )


def report(experiment: Experiment, stored: StoredRun) -> str:
    """The identified parameters with units, and how good they are."""
    problem, result = experiment.problem, stored.result
    if result["theta"] is None:
        reasons = ", ".join(f"{n} x {reason}" for reason, n in result["rejected"].items())
        return f"no finite value was found: {reasons}"
    space = problem.space
    table = pd.DataFrame(
        {
            "parameter": space.names,
            "value": [f"{value:.6g}" for value in result["theta"]],
            "unit": [parameter.unit for parameter in space.parameters],
            "range": [f"[{p.low:g}, {p.high:g}]" for p in space.parameters],
            "": [_at_bound(v, p) for v, p in zip(result["theta"], space.parameters, strict=True)],
        }
    )
    error = math.sqrt(result["loss"])
    best = min(best_known_error(problem), error)
    unit = problem.unit
    rows = [
        ("error", f"{error:.2f} {unit} (root mean square)"),
        ("best known", f"{best:.2f} {unit}, gap {100 * (error / best - 1):.4f} % ({BEST_KNOWN})"),
        ("evaluations", f"{result['evaluations']:,.0f}"),
        ("seconds", f"{result['seconds']:.3f} (set-up {result['setup_seconds']:.3f})"),
        ("ended by", ENDINGS.get(result["outcome"], result["outcome"])),
        ("run", str(stored.folder)),
    ]
    irreducible = experiment.facts.get("irreducible")
    if irreducible is not None:
        estimate = f"about {irreducible:.2f} {unit} (estimated from neighbouring points)"
        rows.insert(2, ("irreducible", estimate))
    if irreducible is not None and error > SUSPICIOUS * irreducible:
        times = f"{error / irreducible:.1f} times the irreducible error"
        rows.append(("warning", f"the error is {times}: check units, signs and ranges"))
    if result["rejected"]:
        rows.append(("rejected", ", ".join(f"{n} x {r}" for r, n in result["rejected"].items())))
    tail = "\n".join(f"{name:<12} {text}" for name, text in rows)
    return f"{table.to_string(index=False)}\n\n{tail}"


def _at_bound(value: float, parameter: Parameter) -> str:
    close = 1e-6 * (parameter.high - parameter.low)
    if value - parameter.low <= close:
        return "at its lower bound"
    return "at its upper bound" if parameter.high - value <= close else ""


@cache
def best_known_error(problem: CurveFit) -> float:
    """Error of thorough multi-start least squares on this problem, in its unit."""
    solver = LeastSquares(screen=3000, starts=10, rounds=1)
    return math.sqrt(minimize(solver, problem, Budget(evaluations=200_000)).loss)
