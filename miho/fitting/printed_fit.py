"""The printed form of a fit, the sentences on its limits, and its figure."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, cast

import numpy as np

from miho.identification.alternatives import several_values
from miho.identification.dependence import serial_correlation_beside_priors, widening
from miho.identification.flags import (
    REMEDY,
    doubtful,
    ended_at_bounds,
    held_at_bounds,
    not_identifiable,
)
from miho.identification.line_wrapping import with_digits, with_unit
from miho.identification.stated import at_limits, marked, reported_space, reported_uncertainty

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from miho.fitting.fit_result import Fit
    from miho.identification.uncertainty import Linearised

WIDE = 10.0
"""The printed fit says how much correlated errors widen the intervals from this factor on."""


def printed(fit: Fit) -> tuple[str, list[str]]:
    """The table of parameters as text, and the lines below it, of any length."""
    table = with_digits(fit.parameters, "standard_error").to_string(float_format="{:.5g}".format)
    rows = len(fit.problem.dataset)
    error = with_unit(f"error {fit.error:.5g}", fit.problem.unit)
    weights = "" if fit.problem.weights is None else ", weighted by sigma"
    narrow = (
        "; errors of neighbouring rows are correlated, and intervals do not allow for them "
        "together with priors"
    )
    priors = bool(serial_correlation_beside_priors(fit.problem, fit.theta))
    at = None
    with contextlib.suppress(ValueError):  # too few rows
        at = fit.uncertainty
    marks = marked(fit.problem, fit.theta, at)
    size = "; ".join([f"{error} (root mean square of {rows:,} rows{weights})", *marks])
    doubt = fit._conclusion.doubt
    size += f"{_dependent(at, explained=not doubt)}{narrow * priors}"
    # The caveats explain an optimum in doubt.
    limits = " ".join(f"{limit}." for limit in at_limits(fit.problem, fit.theta))
    known = limits if doubt else fit.optimum.replace(". ", ".\n")
    limited = (f"- {sentence}" for sentence in fit.caveats)
    lines = "\n".join(filter(None, [size, known, *limited])).split("\n")
    return table, lines


def _dependent(at: Linearised | None, *, explained: bool) -> str:
    """The remark on correlated errors, with the widening of the intervals if it is large.

    A report has `explained` it, unless the optimum is in doubt.
    """
    if at is None or at.dependence is None:
        return ""
    usable = np.isfinite(at.standard_errors) & (at.standard_errors > 0)
    widest = float(widening(at, np.eye(usable.size)[usable]).max(initial=1.0))
    much = f", up to {widest:.0f} times as wide{': fit.report() gives the reason' * explained}"
    return f"; intervals allow for correlated errors of neighbouring rows{much * (widest >= WIDE)}"


def caveats(fit: Fit) -> list[str]:
    """Sentences on the limits of the results."""
    conclusion = fit._conclusion
    sentences = doubtful(conclusion.doubt, REMEDY) if conclusion.doubt else []
    try:
        at = reported_uncertainty(fit.problem, fit.uncertainty)
    except ValueError as error:
        return [*sentences, f"there are no standard errors: {error}."]
    sentences += several_values(fit.problem, fit._optima)
    if fit.problem.model.ordered:  # it may be a simulation
        from miho.identification.report_text import on_computation

        sentences += on_computation(fit.problem, fit.uncertainty)
    space = reported_space(fit.problem.space)
    sentences += (ended_at_bounds if conclusion.doubt else held_at_bounds)(at, space)
    return sentences + not_identifiable(at, space, everywhere=False)


def figure_of(fit: Fit, ax: object = None) -> Figure:
    """The data and the curve with its interval, or measured over predicted values."""
    from miho.figures.report import Column, curve_of, fit_figure, plot_fit
    from miho.models.joint import rows_of_parts

    if ax is not None:
        from matplotlib.axes import Axes

        if not isinstance(ax, Axes):
            kind = "an array of axes" if isinstance(ax, np.ndarray) else f"a {type(ax).__name__}"
            raise TypeError(f"ax is {kind}; the fit has one panel: pass one axes, such as axes[0]")
    problem, dataset = fit.problem, fit.problem.dataset
    parts = rows_of_parts(problem.model, problem.inputs)
    shown = "output" if parts else dataset.output
    measured = Column(shown, problem.unit, dataset[dataset.output])
    predicted = problem.model.predict(fit.theta[None], *problem.inputs)[0]
    inputs = [Column(name, dataset.units[name], dataset[name]) for name in problem.model.inputs]
    x, band = curve_of(inputs, problem.model.ordered, fit._band)
    if ax is None:
        return fit_figure(measured, predicted, x, band, parts)
    plot_fit(measured, predicted, x, band, parts, ax)
    return cast("Figure", ax.get_figure(root=True))
