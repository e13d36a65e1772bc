"""Console output about finished runs, and the exit code."""

import math
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from textwrap import wrap
from typing import Any

import numpy as np
import pandas as pd

from experiments.app.build import Experiment
from experiments.app.console import OK, SOME_FAILED
from experiments.app.parts import model_files
from experiments.app.working import State
from miho.analysis.text import cell, is_numeric
from miho.analysis.variants import named_apart
from miho.identification import Square, linear_optimum
from miho.identification.line_wrapping import with_unit
from miho.identification.stated import marked
from miho.identification.validation import root_mean_square
from miho.optim import Descents, in_optimum
from miho.parallel.usage import Usage
from miho.study import Status, StoredRun
from miho.study.identity import Identity, canonical
from miho.study.settings import RunRequest, differing, parts_of

ENDINGS = {
    "converged": "itself",
    "brackets": "its largest number of brackets",
    "budget": "its budget",
}


def print_summary(states: Sequence[State]) -> int:
    """Print a summary of the runs of a sweep; return the exit code of the command."""
    if all(state.status in (Status.TO_DO, Status.DONE_BEFORE) for state in states):
        for line in filter(None, (state.line for state in states)):
            print(line)
    _print_errors(states)
    bad = [state for state in states if state.reason is not None]
    _print_reasons(bad)
    for root in dict.fromkeys(state.request.root for state in states if state.error is not None):
        print(_report_command(root, states))
    counts = Counter(state.status for state in states)
    text = ", ".join(f"{counts[status]} {status}" for status in Status if counts[status])
    print(f"{len(states)} run{'s' * (len(states) != 1)}: {text}")
    return SOME_FAILED if bad else OK


def _print_reasons(bad: Sequence[State]) -> None:
    """Print the runs without a result, the seeds of one setting with one reason in one line."""
    seeds: dict[tuple[str, str], list[str]] = {}
    for state in bad:
        setting, _, seed = state.request.words.rpartition("seed=")
        why = "" if state.reason == state.status else f": {state.reason}"
        seeds.setdefault((f"{state.status}: {setting}", why), []).append(seed)
    for (setting, why), numbers in seeds.items():
        print(f"{setting}seed={','.join(numbers)}{why}")


def _report_command(root: str, states: Sequence[State]) -> str:
    """Command that reports on the runs of a root, with --trust if their model is a file."""
    identities = (state.request.identity for state in states if state.request.root == root)
    files = sorted({file for identity in identities for file in model_files(identity.config)})
    files_run = f" (--trust allows it to run {', '.join(files)})" if files else ""
    trust = " --trust" if files else ""
    return f"how far to trust the best of them{files_run}: " + (
        f"python -m experiments.report {shlex.quote(root)}{trust}"
    )


def _print_errors(states: Sequence[State]) -> None:
    """Print the number of runs and their errors, one line per problem, method and setting.

    A run that several jobs requested, as trials of a study can, counts once.
    """
    by_key = {state.request.key: state for state in states if state.error is not None}
    ended = list(by_key.values())
    if ended:
        names = [state.request.identity for state in ended]
        rows = [
            (name.problem, name.optimizer, state.error, state.unit)
            for name, state in zip(names, ended, strict=True)
        ]
        runs = pd.DataFrame(rows, columns=["problem", "optimizer", "error", "unit"])
        runs = named_apart(runs.join(differing([_run_request(name) for name in names])))
        groups = runs.rename(columns={"optimizer": "method"}).groupby(["problem", "method"])
        table = groups["error"].agg(["count", "min", "median", "max"])
        table["unit"] = groups["unit"].first()
        lines = table.to_string(float_format="%.5g").splitlines()
        print("\n".join(["errors by problem and method:", *map(str.rstrip, lines)]))


def _run_request(name: Identity) -> RunRequest:
    parts = parts_of(canonical(name.config).encode())
    return RunRequest(name.problem, name.optimizer, name.seed, parts, name.code, name.data)


NARROWEST, WIDEST = 12, 28
"""Widths of columns: numbers whose name is long, and long text [characters]."""


def table_text(table: pd.DataFrame) -> str:
    """A table for terminals: names and text wrapped inside their columns, numbers on the right."""
    names = [str(name) for name in table.columns]
    rows = [[cell(value) for value in row] for row in table.itertuples(index=False)]
    right = [is_numeric(table[name]) for name in table.columns]
    widths = []
    for name, numbers, *cells in zip(names, right, *rows, strict=True):
        longest = max(map(len, cells), default=0)
        words = max(map(len, name.split()), default=0)
        content = max(longest, min(len(name), NARROWEST)) if numbers else min(longest, WIDEST)
        widths.append(max(words, content))
    lines = []
    for row in [names, *rows]:
        wrapped = [wrap(text, width) for text, width in zip(row, widths, strict=True)]
        for parts in zip_longest(*wrapped, fillvalue=""):
            padded = (
                text.rjust(width) if numbers else text.ljust(width)
                for text, width, numbers in zip(parts, widths, right, strict=True)
            )  # fmt: skip
            lines.append("  ".join(padded).rstrip())
    return "\n".join(lines)


def result_text(experiment: Experiment, stored: StoredRun) -> str:
    """Text on the parameters, their uncertainty and the run; also writes the page of the report."""
    # Imported here, because the import of figures takes longer than a small run.
    from experiments.app.optimum import descents_of, larger_budget, report_of, save_run
    from miho.analysis.pages.run_tables import error_rows, report_text

    problem, result = experiment.problem, stored.result
    if result["theta"] is None:
        reasons = ", ".join(f"{n} x {reason}" for reason, n in result["rejected"].items())
        if not result["evaluations"]:
            return (
                "the method ended without an evaluation; its `run` calls oracle(thetas), and the "
                "budget must allow one"
            )
        if not reasons:
            return (
                "no configuration was evaluated on all rows of data within the budget; "
                f"search again with a larger one: {larger_budget(stored)}"
            )
        return f"no finite value was found: {reasons}"
    unit = problem.unit
    rows: list[tuple[str, str]] = []
    report, found_by = None, ""
    # Parameters with intervals and notes, or only their values if the report fails.
    try:
        report = report_of(problem, stored)
    except ValueError as reason:
        theta = np.array(result["theta"])
        values = zip(problem.space.parameters, result["theta"], strict=True)
        marks = marked(problem, theta, None)
        lines = "\n".join(f"{p.name:<12} {value:.6g} {p.unit}" for p, value in values)
        findings = f"{lines}\n\n- no standard errors: {reason}"
        error = root_mean_square(problem.errors(theta))
        rows.append(("error", f"{with_unit(f'{error:.5g}', unit)} (root mean square)"))
    else:
        theta, findings = report.at.theta, report_text(report)
        marks = marked(problem, theta, report.at)
        rows += error_rows(report)
        found_by = report.found_by
        rows.append(("optimum", report.conclusion.statement))
    if marks:
        rows.append(("limits", ", ".join(marks)))
    # The loss of the optimum, and its gap to the best known optimum.
    loss = float(problem.loss(theta[None])[0])
    if not isinstance(problem.rho, Square):
        name = type(problem.rho).__name__
        rows.append(
            ("loss", f"{with_unit(f'{math.sqrt(loss):.5g}', unit)} (root of the mean {name} loss)")
        )
    optimum, linear = experiment.facts.get("optimum"), linear_optimum(problem)
    exact = None if linear is None else linear[1]
    if optimum is not None:
        best = min(optimum, loss, result["loss"])
        source = "recorded" if exact is None else "closed form"
        gap, gap_of_run = _gap(loss, best), _gap(result["loss"], best)
        if gap != gap_of_run:
            gap += f"; of the run itself {gap_of_run}"
        rows.append(
            ("best known", f"{with_unit(f'{math.sqrt(best):.5g}', unit)} ({source}), gap {gap}")
        )
    # Cost, ending and folder of the run.
    rows += [
        ("evaluations", f"{result['evaluations']:,.0f}"),
        ("seconds", f"{result['seconds']:.3f} (set-up {result['setup_seconds']:.3f})"),
        ("ended by", _ending(result, descents_of(stored), problem.resolution, exact, found_by)),
    ]
    if result["rejected"]:
        rows.append(("rejected", ", ".join(f"{n} x {r}" for r, n in result["rejected"].items())))
    if result.get("outside"):
        rows.append(("outside", f"at least {result['outside']:,} evaluations outside the box"))
    if result.get("usage"):
        rows.append(("workers", str(Usage(**result["usage"]))))
    rows.append(("run", str(stored.folder)))
    if report is not None:
        rows.append(("report", str(save_run(report, stored))))
    return findings + "\n\n" + "\n".join(f"{name:<12} {value}" for name, value in rows)


def _gap(loss: float, best: float) -> str:
    """Difference of the roots of a loss and the best loss, in percent of the latter."""
    return f"{100 * (math.sqrt(loss / best) - 1) if best else 0.0:.4f} %"


def _ending(
    result: Mapping[str, Any],
    descents: Descents | None,
    resolution: float,
    exact: float | None,
    found_by: str = "",
) -> str:
    """Text on the ending of a run and on its descents; losses closer than `resolution` are equal.

    `exact` is the loss of the only optimum, if the problem is linear in all parameters. `found_by`
    is the later step that found a better optimum, if there is one.
    """
    outcome, loss = str(result["outcome"]), float(result["loss"])
    ending = ENDINGS.get(outcome, outcome)
    if exact is not None and in_optimum(exact, loss, resolution):
        return f"{ending}, in the only optimum: the problem is linear in all its parameters"
    if descents is None:
        return ending
    finished, kind = descents.finished, descents.kind(2)
    enough = descents.agreement(loss, resolution).enough and descents.settled
    ending += f", {'after' if enough else 'before'} enough of its {kind} agreed"
    if found_by:
        ending += f"; {found_by} found a better optimum"
    if descents.converged < finished:
        moving = finished - descents.converged
        ending += f"; {moving} of {finished} {kind} were still moving at their end"
    return ending
