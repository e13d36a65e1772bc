"""The report of a stored run, and advice if its optimum is in doubt."""

import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np

from experiments.app.parts import model_files
from experiments.app.progress import at_work, progress
from miho.analysis.pages.run import report_folder, save_report
from miho.identification import CurveFit, Report, make_report
from miho.identification.report_steps import SECONDS
from miho.methods.variable_projection import VariableProjection
from miho.optim import Budget, Descents, Outcome, Parameter, RunRecord, minimize
from miho.study import StoredRun, single_thread

CHECK_SECONDS = 60.0
CHECK = VariableProjection(screen=20, starts=1, rounds=100)
"""Up to 100 descents, each from the best of 20 new configurations, so starts are independent."""
OTHER_SEEDS = 2**32
"""Added to the seed of a run, so that the check uses other random numbers than any run."""
OTHER_METHODS = "miho_gn", "variable_projection"
"""Methods to suggest: the first one that the run did not use."""
MORE_SCREEN, MORE_STARTS = 10, 5
DECADES = 100.0
"""For a positive range wider than this factor, a log scale is suggested."""
MOST_HINTS = 3


LEAST_SECONDS = 10.0
"""A report may take as long as the budget of the run, but between this and `SECONDS` [s]."""


def report_of(problem: CurveFit, stored: StoredRun, **settings: Any) -> Report:
    """Report on a finished run of a problem; `settings` are settings of `make_report`."""
    if not sys.stderr.isatty():
        print(f"report of {problem.name}: running", file=sys.stderr, flush=True)
    result = stored.result
    budget = stored.config["budget"].get("seconds")
    defaults = {
        "seconds": SECONDS if budget is None else min(SECONDS, max(LEAST_SECONDS, budget)),
        "descents": descents_of(stored),
        "best_known": result.get("facts", {}).get("optimum"),
        "remedy": remedy(problem, stored, checked="check" in settings),
    }
    with at_work("report") as show_stage, single_thread():
        theta = np.array(result["theta"])
        return make_report(problem, theta, progress=show_stage, **defaults | settings)


def save_run(report: Report, stored: StoredRun, folder: Path | None = None) -> Path:
    """Write the report of a stored run, by default below its root; return the path of its page."""
    with at_work("report") as show_stage:
        return save_report(report, folder or report_folder(stored), stored, show_stage)


def descents_of(stored: StoredRun) -> Descents | None:
    """Ends of the descents of a stored run; None without descents or from an older version."""
    record = stored.result.get("descents")
    if not record:
        return None
    try:
        return Descents.from_stored(record)
    except (TypeError, ValueError, LookupError):
        return None


def check_optimum(problem: CurveFit, seconds: float, seed: int) -> RunRecord:
    """Descend from independent starts for `seconds`, with a progress bar; Ctrl-C ends the check."""
    budget = Budget(seconds=seconds)
    with single_thread(), progress("check", budget, problem.unit) as observer:
        record = minimize(CHECK, problem, budget, OTHER_SEEDS + seed, observer=observer)
    if record.outcome is Outcome.INTERRUPTED:
        raise KeyboardInterrupt
    return record


def remedy(problem: CurveFit, stored: StoredRun, *, checked: bool = False) -> str:
    """Advice (overrides to type) if the optimum of a run is in doubt, also after it was `checked`.

    A run that the budget ended may only need a larger one. A run that converged would end in the
    same optimum: it needs other starts, another method or another box.
    """
    settings = stored.config["optimizer"]
    ways = []
    if stored.result["outcome"] == Outcome.BUDGET and (budget := larger_budget(stored)):
        ways.append(f"a larger budget: {budget}")
    if stored.result["outcome"] == Outcome.BRACKETS:
        ways.append(f"more brackets: optimizer.max_brackets={10 * settings['max_brackets']}")
    if "screen" in settings and "starts" in settings:
        screen, starts = MORE_SCREEN * settings["screen"], MORE_STARTS * settings["starts"]
        ways.append(f"more starts: optimizer.screen={screen} optimizer.starts={starts}")
    else:
        other = next(name for name in OTHER_METHODS if name != stored.result["optimizer"])
        ways.append(f"another method: optimizer={other}")
        ways.append(f"another seed: seed={stored.result['seed'] + 1}")
    ends = zip(problem.space.parameters, stored.result["theta"], strict=True)
    lowest = sorted(
        ((theta / p.high, p) for p, theta in ends if p.stands_for is None and _wide(p)),
        key=lambda end: end[0],
    )
    log = " ".join(_logarithmic(p) for _, p in lowest[:MOST_HINTS])
    name = problem.space.names[0]
    box = f"a narrower box: space.{name}.low=... space.{name}.high=..."
    ways.append(f"{box} or a logarithmic one: {log}" if log else box)
    again = f"search again with {'; '.join(ways)}."
    if checked:
        return again
    trust = " --trust" if model_files(stored.config) else ""
    folder = shlex.quote(str(stored.folder))
    command = f"python -m experiments.report {folder} --check{trust}"
    return f"{again} Or look for a better optimum: {command}"


def larger_budget(stored: StoredRun) -> str:
    """Override with ten times the limit that ended the run; empty if it had only a target."""
    evaluations, seconds = (stored.config["budget"].get(key) for key in ("evaluations", "seconds"))
    if seconds is not None and (evaluations is None or stored.result["seconds"] >= seconds):
        return f"budget.seconds={10 * seconds:g}"
    return "" if evaluations is None else f"budget.evaluations={10 * evaluations}"


def _wide(p: Parameter) -> bool:
    return p.scale == "linear" and p.low >= 0 and p.high > DECADES * p.low


def _logarithmic(p: Parameter) -> str:
    low = f" space.{p.name}.low={1e-6 * p.high:g}" if p.low == 0 else ""
    return f"space.{p.name}.scale=log{low}"
