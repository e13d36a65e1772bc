"""The text of a report: its best intervals, the statement on the optimum, and remarks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from miho.identification import flags
from miho.identification.alternatives import several_values
from miho.identification.curve_fit import CurveFit
from miho.identification.derived import is_held
from miho.identification.line_wrapping import with_digits, with_unit, wrapped
from miho.identification.parameters_file import KINDS, interval_kind
from miho.identification.prior import prior_notes
from miho.identification.report import rounding_of
from miho.identification.residuals import Square
from miho.identification.robust_loss import Cauchy, Huber
from miho.identification.stated import at_limits, reported_values
from miho.identification.uncertainty import Linearised
from miho.identification.validation import root_mean_square
from miho.models.joint import parts_of

if TYPE_CHECKING:
    from miho.identification.report import Report

HEDGE = (
    "these remarks on data and model hold for this optimum, and may not hold if every search "
    "missed a better one."
)
"""The starting points are the best of a screen, so all of them can miss a narrow basin."""
BIASED = (
    "with several optima the estimates are biased, so bootstrap intervals, which assume unbiased "
    "estimates, may be too narrow: use the profile intervals."
)
"""Measured coverage: 64 to 98 % for bootstrap intervals, 96 to 100 % for profile intervals
(`experiments.check.coverage --curvature`)."""
SUSPICIOUS = 2.0
"""An error is mentioned if it exceeds the upper end of the irreducible error by this factor."""
NORMAL = 0.6745
"""Median of the magnitude of normal errors of unit variance."""
HUBER = 1.345
"""Scale of Huber's loss in standard deviations: 95 % efficient for normal errors (Huber 1964)."""
FAR = 5.0
"""Rows beyond this many robust standard deviations may be outliers."""
MANY = 0.1
"""If more than this fraction of the rows is far, they are not outliers but a tail."""
RAISED = 1.3
"""Outliers matter if they raise the standard deviation of the errors by this factor."""
TREATED = 0.7
"""The scale of a robust loss is too small if it treats this fraction of the rows as outliers."""


def text_of(report: Report) -> str:
    """The parameters with their best intervals, the error, and the remarks."""
    problem, kind = report.problem, interval_kind(report.parameters)
    columns = ["parameter", "value", "unit", "standard error", f"{kind} low", f"{kind} high"]
    if kind != "bootstrap" and report.replicates is not None:
        columns += ["bootstrap low", "bootstrap high"]
    if report.uneven and not report.conclusion.doubt:
        columns += ["sandwich", "sandwich low", "sandwich high"]
    open_ends = dict.fromkeys(("profile low", "profile high"), _end)
    parts = [_printed(report.parameters[columns], open_ends)]
    quantities = _with_best_intervals(report.derived)
    if len(quantities):
        parts.append(_printed(quantities, dict.fromkeys(("low", "high"), _end)))
    error = with_unit(f"error: {report.error:.5g}", problem.unit)
    weights = "" if problem.weights is None else ", weighted by sigma"
    lines = [
        f"{error} (root mean square of {len(problem.dataset):,} rows{weights}); intervals of "
        f"{100 * report.level:g} %"
    ]
    if not report.conclusion.doubt:  # a doubt is the first note
        lines += report.conclusion.statement.replace(". ", ".\n").split("\n")
    lines += [f"- {note}" for note in report.notes]
    return "\n\n".join([*parts, "\n".join(map(wrapped, lines))])


def _with_best_intervals(derived: pd.DataFrame) -> pd.DataFrame:
    """The derived quantities that have a value, each with the best of its intervals."""
    rows = []
    for row in derived.to_dict("records"):
        if math.isnan(row["value"]):
            continue
        known = [kind for kind in KINDS if not math.isnan(row.get(f"{kind} low", math.nan))]
        kind = known[0] if known else KINDS[-1]
        common = {key: row[key] for key in ("quantity", "value", "unit", "standard error")}
        rows.append(
            {**common, "low": row[f"{kind} low"], "high": row[f"{kind} high"], "interval": kind}
        )
    return pd.DataFrame(rows)


def _printed(table: pd.DataFrame, formatters: Mapping[str, Callable[[Any], str]]) -> str:
    """The text of a table with five digits."""
    table = with_digits(table, "standard error")
    return table.to_string(index=False, float_format="{:.5g}".format, formatters=dict(formatters))


def _end(value: float | str) -> str:
    """The text of a profile end; "open" if the profile reached the bound without an end."""
    if isinstance(value, str):
        return value
    return "open" if math.isinf(value) else f"{value:.5g}"


def notes_of(report: Report) -> list[str]:
    """Remarks on the search; and, if the optimum is not in doubt, on the data and the model."""
    problem, at, conclusion = report.problem, report.at, report.conclusion
    before, after = (root_mean_square(problem.residuals(theta)) for theta in (report.run, at.theta))
    run = reported_values(problem, report.run[None])[0]
    gain = 1 - after / before if before else 0.0
    held = [quantity.name for quantity in report.quantities if is_held(quantity, at)]
    sentences = flags.run_differs(run, report.reported, report.space, gain)
    sentences += flags.held_quantities(held)
    several = several_values(problem, (at, *report.others))
    if several and report.replicates is not None:
        several.append(BIASED)
    sentences = several + sentences
    if conclusion.doubt:
        doubt = flags.doubtful(conclusion.doubt, report.remedy) + on_computation(problem, at)
        sentences = doubt + flags.ended_at_bounds(report.reported, report.space) + sentences
    else:
        remarks = _on_data_and_model(report)
        if remarks and not conclusion.certain:
            remarks.append(HEDGE)
        sentences += remarks
    return [*sentences, *report.omitted]


def on_computation(problem: CurveFit, at: Linearised) -> list[str]:
    """Remarks on numerical errors of the model at an optimum."""
    noise = at.noise if problem.weights is None else at.noise / problem.weights
    return problem.model.remarks(at.theta, noise, *problem.inputs)


def _on_data_and_model(report: Report) -> list[str]:
    problem, at, space = report.problem, report.reported, report.space

    # Parameters: do the data determine them, and how well?
    sentences = flags.identifiability(at, space) + flags.too_few(problem)
    if report.at.noise <= rounding_of(problem):
        return [*sentences, "every row is reproduced to rounding: the data have no error."]
    sentences += flags.maybe_zero(at, space, report.profiles, report.level)
    ends = report.parameters[["linearised low", "linearised high"]].to_numpy()
    sentences += flags.profile_shapes(ends, space, report.profiles)
    sentences += flags.wrong_signs(report.derived, report.quantities)
    # Errors: do the assumptions of the standard errors hold?
    sentences += flags.uneven_spread(at, space) if report.uneven else []
    sentences += flags.sigma_disagrees(problem, report.at)
    sentences += prior_notes(report.priors)
    sentences += [f"{text}." for text in at_limits(problem, report.at.theta)]
    sentences += flags.independence(problem, report.at, at)
    sentences += too_small_scale(problem, report.at)
    followed = flags.followed(problem, report.trends)
    if not (followed or report.uneven or at.dependence is not None):
        sentences += outliers(problem, report.at)
    # Model: are its errors larger than the noise, or do they follow a column?
    sentences += on_computation(problem, at)
    irreducible = report.irreducible
    if irreducible.resolved and 0 < SUSPICIOUS * irreducible.high < report.error:
        sentences.append(
            f"the error is {report.error / irreducible.value:.1f} times the irreducible error: "
            "check units, signs, ranges and the model."
        )
    return sentences + followed


def too_small_scale(problem: CurveFit, at: Linearised) -> list[str]:
    """A sentence if a robust loss treats most rows as outliers."""
    rho, errors = problem.rho, np.abs(problem.errors(at.theta))
    if not isinstance(rho, Huber | Cauchy) or np.mean(errors > rho.scale) < TREATED:
        return []
    usual = HUBER * float(np.median(errors)) / NORMAL
    return [
        f"{100 * np.mean(errors > rho.scale):.0f} % of the errors exceed the scale of the loss, so "
        f"the standard errors are unreliable: choose a larger scale, for example {usual:.2g} "
        f"{problem.unit}."
    ]


def outliers(problem: CurveFit, at: Linearised) -> list[str]:
    """A sentence if few rows are so far from the curve that they widen all intervals.

    With a known sigma intervals do not depend on the errors, so no row widens them. Fits with
    priors and joint fits have no sentence either, because they cannot have a robust loss.
    """
    if at.noise_known or problem.prior is not None or parts_of(problem.model):
        return []
    errors, unit = np.abs(problem.errors(at.theta)), problem.unit
    usual = float(np.median(errors)) / NORMAL * math.sqrt(errors.size / at.freedom)
    far = int(np.count_nonzero(errors > FAR * usual))
    few = 0 < far <= MANY * errors.size
    if not isinstance(problem.rho, Square) or not few or at.noise < RAISED * usual:
        return []
    size, scale = (with_unit(f"{x:.2g}", unit) for x in (usual, HUBER * usual))
    verbs = ("is", "widens") if far == 1 else ("are", "widen")
    return [
        f"{far} of {errors.size:,} rows {verbs[0]} more than {FAR:.0f} standard deviations of the "
        f"others, {size}, from the curve and {verbs[1]} all intervals. If these readings are "
        f"wrong, choose a robust loss, for example Huber's with the scale {scale}."
    ]
