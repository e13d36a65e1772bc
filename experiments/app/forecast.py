"""Before a search of a user's own data: what was read of the file, and how long it will take."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import Any

from experiments.app.build import Experiment
from miho.data.preview import preview
from miho.identification import CurveFit
from miho.models.function_model import FunctionModel
from miho.models.leaves import dear_leaves
from miho.models.model import ExternalModel
from miho.optim import Budget
from miho.study import Store

LONG = 60.0
"""Seconds from which on fewer rows are worth a thought."""
ENOUGH, MOST_CALLS = 0.05, 20


def announce(experiment: Experiment, dataset: Mapping[str, Any]) -> None:
    """Print a preview and a forecast on stderr, if data come from a file and the run is not done.

    dataset: its settings. A function or program of the user's is not timed: it may be dear.
    """
    problem = experiment.problem
    preview_text = preview(problem.dataset)
    if preview_text is None or Store(experiment.root).has_result(experiment.identity):
        return
    print(preview_text, file=sys.stderr, flush=True)
    if any(isinstance(m, FunctionModel | ExternalModel) for m in dear_leaves(problem.model)):
        return
    seconds = seconds_of_evaluation(problem)
    print(forecast(seconds, experiment.budget, len(problem.dataset), dataset), file=sys.stderr)


def seconds_of_evaluation(problem: CurveFit) -> float:
    """Seconds that one evaluation of the loss takes, the fastest of some."""
    thetas = problem.space.decode(problem.space.initial(1))
    problem.loss(thetas)
    best, started = float("inf"), time.perf_counter()
    for _ in range(MOST_CALLS):
        before = time.perf_counter()
        problem.loss(thetas)
        now = time.perf_counter()
        best = min(best, now - before)
        if now - started > ENOUGH:
            break
    return best


def forecast(seconds: float, budget: Budget, rows: int, dataset: Mapping[str, Any]) -> str:
    """How long the budget lasts at so many seconds an evaluation, and what shortens a long search.

    That is the most a run takes, besides its method's own computations: one that ends by itself may
    take far less.
    """
    cost = f"{rows:,} rows, {_short(seconds)} an evaluation"
    if budget.evaluations is None:
        if budget.seconds is None:
            return f"{cost}; no budget"
        return (
            f"{cost}: at most {budget.seconds / seconds:,.0f} in the {budget.seconds:g} s allowed"
        )
    whole = budget.evaluations * seconds
    text = f"{cost}: at most {_short(whole)} for the {budget.evaluations:,} allowed"
    limit = budget.seconds
    if limit is not None and whole > limit:
        text += f", but budget.seconds={limit:g} ends it after some {limit / seconds:,.0f}"
    if whole > (LONG if limit is None else min(limit, LONG)) and rows > 3000:
        which = ["dataset.every=10"] if "every" in dataset else []
        which += ["'dataset.where={COLUMN: [FROM, TO]}'"] if "where" in dataset else []
        text += f"; fewer rows are faster: {' or '.join(which)}" if which else ""
    return text


def _short(seconds: float) -> str:
    for factor, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= factor:
            return f"{seconds / factor:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} µs"
