"""Before a search on the user's data: a preview of the file, and a forecast of the run time."""

import sys
import time
from collections.abc import Mapping
from typing import Any

from experiments.app.build import Experiment
from miho import Budget, CurveFit
from miho.data.preview import preview
from miho.models.function_model import FunctionModel
from miho.models.model import ExternalModel, expensive_leaves
from miho.parallel.worth import span
from miho.study import Store

LONG = 60.0
"""Run time [s] above which the forecast suggests fewer rows."""
ENOUGH, MOST_CALLS = 0.05, 20


def announce(experiment: Experiment, dataset: Mapping[str, Any]) -> None:
    """Print a preview and a forecast on stderr, if data come from a file and the run is not stored.

    `dataset` has the settings of the dataset. A function or program of the user is not timed,
    because it may be expensive.
    """
    problem = experiment.problem
    preview_text = preview(problem.dataset)
    if preview_text is None or Store(experiment.root).has_result(experiment.identity):
        return
    print(preview_text, file=sys.stderr, flush=True)
    if any(isinstance(m, FunctionModel | ExternalModel) for m in expensive_leaves(problem.model)):
        return
    seconds = seconds_of_evaluation(problem)
    print(forecast(seconds, experiment.budget, len(problem.dataset), dataset), file=sys.stderr)


def seconds_of_evaluation(problem: CurveFit) -> float:
    """Seconds of one evaluation of the loss, the fastest of several."""
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
    """Forecast of the run time within the budget, and advice on how to shorten a long search.

    The run time is an upper limit without the computations of the method; a run that converges may
    take far less.
    """
    cost = f"{rows:,} rows, {span(seconds)} an evaluation"
    if budget.evaluations is None:
        if budget.seconds is None:
            return f"{cost}; no budget"
        return (
            f"{cost}: at most {budget.seconds / seconds:,.0f} in the {budget.seconds:g} s allowed"
        )
    whole = budget.evaluations * seconds
    text = f"{cost}: at most {span(whole)} for the {budget.evaluations:,} allowed"
    limit = budget.seconds
    if limit is not None and whole > limit:
        text += f", but budget.seconds={limit:g} ends it after some {limit / seconds:,.0f}"
    if whole > (LONG if limit is None else min(limit, LONG)) and rows > 3000:
        which = ["dataset.every=10"] if "every" in dataset else []
        which += ["'dataset.where={COLUMN: [FROM, TO]}'"] if "where" in dataset else []
        text += f"; fewer rows are faster: {' or '.join(which)}" if which else ""
    return text
