"""Optimal experimental design: the choice of rows to measure next.

The expected covariance follows from the linearised model with the present and the chosen rows
(Fedorov, Theory of Optimal Experiments, 1972). D-optimal rows minimise its determinant, c-optimal
rows the variance of one parameter or derived quantity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.identification.candidates import Candidates, candidate_rows, derivatives, group_numbers
from miho.identification.curve_fit import CurveFit
from miho.identification.derived import derived, gradient
from miho.identification.design_words import advice, assumptions, table_text
from miho.identification.exchange import Information, best_groups
from miho.identification.inverse_root import inverse_root
from miho.identification.line_wrapping import wrapped
from miho.identification.report import Report, Reporting, report_of, rounding_of
from miho.identification.stated import reported_slopes, reported_space, reported_uncertainty
from miho.identification.uncertainty import Linearised, with_rows
from miho.models.layout import PART
from miho.quantities import Array
from miho.validate import whole

CERTAIN = 1e4
"""Largest change of a candidate along a direction, in standard deviations of its error. Larger
changes are scaled down, because rounding would lose the other directions."""


@dataclass(frozen=True, eq=False)
class Design:
    """Rows to measure next, and the intervals to expect; `optimal_design` makes it.

    Printing shows the advice, a table of intervals, and the assumptions.

    Parameters
    ----------
    report : Report
        The report on the present data.
    candidates : DataFrame
        The m candidate rows with all inputs of the model, in SI units.
    group : ndarray of shape (m,)
        The group of each candidate, from 0. A group is measured as a whole.
    counts : ndarray of shape (G,)
        Number of times that each group is chosen.
    goal : str
        The parameter or derived quantity of interest; empty for all parameters.
    groups : str, optional
        The column that numbers the groups; None if each row is a group.
    quantities : DataFrame
        The q quantities of interest, one per row: free parameters and derived quantities.
    gradients : ndarray of shape (q, d)
        Derivatives of the quantities with respect to the parameters.
    """

    report: Report
    candidates: pd.DataFrame
    group: NDArray[np.intp]
    counts: NDArray[np.intp]
    goal: str
    groups: str | None
    quantities: pd.DataFrame
    gradients: Array

    @cached_property
    def chosen(self) -> pd.DataFrame:
        """The rows to measure, with row numbers of the candidates as index; rows may repeat."""
        return self.candidates.iloc[np.repeat(np.arange(len(self.group)), self._times)]

    @property
    def _times(self) -> NDArray[np.intp]:
        """Number of times (m,) that each candidate row is measured."""
        return np.asarray(self.counts[self.group])

    @cached_property
    def undeterminable(self) -> list[str]:
        """The quantities that all candidates together do not determine."""
        at_best = self._after(np.ones(len(self.group))).spread(self.gradients)
        return list(self.quantities["quantity"][np.isinf(at_best)])

    @cached_property
    def _derivatives(self) -> tuple[Array, Array]:
        """Derivatives of weighted predictions, for present rows (N, d) and candidates (m, d)."""
        problem, at = self.report.problem, self.report.at
        return (
            problem.error_slopes(at.theta),
            self._weights[:, None]
            * derivatives(problem.model, at.theta, self.candidates, self.group),
        )

    @property
    def _weights(self) -> Array:
        """Weights (m,) of the errors of candidates: in a joint model, the weights of their part."""
        problem, rows = self.report.problem, self.candidates
        if problem.weights is None or PART not in rows:
            return np.ones(len(rows))
        part, index = problem.dataset[PART], rows[PART].to_numpy()
        known = np.unique(part)
        strange = index[~np.isin(index, known)]
        if strange.size:
            raise ValueError(
                f"candidates: {PART!r} is {strange[0]:g}; expected the number of a part, 0 to "
                f"{known[-1]:g}"
            )
        squares = np.array([np.mean(problem.weights[part == k] ** 2) for k in known])
        return np.asarray(np.sqrt(squares)[np.searchsorted(known, index)])

    @cached_property
    def expected(self) -> Linearised:
        """The uncertainty of the optimum after the chosen rows, for independent errors."""
        return self._after(self._times.astype(float))

    def _after(self, weights: Array) -> Linearised:
        """The uncertainty after each candidate was measured `weights` (m,) times."""
        present, candidates = self._derivatives
        used = weights > 0
        rows = np.sqrt(weights[used])[:, None] * candidates[used]
        return with_rows(self.report.at, np.vstack([present, rows]), round(weights.sum()))

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row per derived quantity and per parameter that is not at a bound.

        Columns: value, and half widths of the interval at the level of the report: `present`,
        `expected` after the chosen rows, and `evenly` after the same number of rows, spread evenly
        over all candidates. Further columns give half widths in % of the value, NaN unless the
        value is larger than the half width. Present half widths are the linearised ones of the
        report. Expected ones are narrower by the factor that holds for independent errors.
        """
        at, level = self.report.at, self.report.level
        size = self._times.sum()
        even = self._after(np.full(len(self.group), size / len(self.group)))
        plain = with_rows(at, self._derivatives[0], 0)
        present, before, after, evenly = (
            state.quantile(level) * state.spread(self.gradients)
            for state in (at, plain, self.expected, even)
        )
        trusted = np.isfinite(present) & (before > 0)
        factor = np.divide(present, before, out=np.ones_like(before), where=trusted)
        widths = {"present": present, "expected": factor * after, "evenly": factor * evenly}
        frame = self.quantities.assign(**{f"{key} half width": w for key, w in widths.items()})
        size_of_value = np.abs(frame["value"].to_numpy())
        for key, half in widths.items():
            percent = np.full(half.size, np.nan)
            np.divide(100 * half, size_of_value, out=percent, where=half < size_of_value)
            frame[f"{key} %"] = percent
        return frame

    @cached_property
    def gains(self) -> pd.DataFrame:
        """Reduction in % of the half width of each quantity by each candidate (or group) alone.

        Rows are the first candidates of the groups. For directions that the present data do not
        determine, the reduction is relative to the range in the space.
        """
        blocks, root = _whitened(self.report, *self._derivatives, self.group)
        frame = self.candidates.iloc[np.unique(self.group, return_index=True)[1]].copy()
        for name, slope in zip(self.quantities["quantity"], self.gradients, strict=True):
            target = root.T @ slope
            fall = Information(blocks, target).gains()
            left = 1 - np.divide(fall, target @ target, out=np.zeros_like(fall), where=fall > 0)
            frame[f"narrows {name} by %"] = 100 * (1 - np.sqrt(np.maximum(0.0, left)))
        return frame

    @property
    def rows(self) -> pd.DataFrame:
        """Inputs of present, candidate and chosen rows, for a figure; names include the units."""
        inputs = self.report.problem.model.inputs
        parts = {
            "present": pd.DataFrame(dict(zip(inputs, self.report.problem.inputs, strict=True))),
            "candidate": self.candidates[list(inputs)],
            "chosen": self.chosen[list(inputs)],
        }
        frame = pd.concat([part.assign(row=name) for name, part in parts.items()])
        names = {name: f"{name} [{unit}]" if unit else name for name, unit in inputs.items()}
        return frame.rename(columns=names).reset_index(drop=True)

    def __str__(self) -> str:
        """The advice, the table, and the assumptions."""
        notes = "\n".join(wrapped(f"- {sentence}") for sentence in assumptions(self))
        return "\n\n".join([wrapped(advice(self)), table_text(self), notes])


def optimal_design(
    report: Report | Reporting,
    candidates: Candidates,
    size: int,
    *,
    goal: str | None = None,
    groups: str | None = None,
    repeats: int = 1,
) -> Design:
    """Choose the rows whose measurement narrows the intervals of a report most.

    The model is linearised at the optimum of the report, and new errors have the present standard
    deviation. For a large campaign, choose a part of the rows, measure, fit, and choose again.

    Parameters
    ----------
    report : Report or Fit
        The report on the present data, or a fit, whose report is made.
    candidates : DataFrame, Dataset, mapping of str to array_like, or array_like
        Possible rows with all inputs of the model, in its units. A mapping gives the levels of each
        input, and every combination is a candidate. An array has the levels of a single input.
    size : int
        Number of rows to choose, or of groups with `groups`.
    goal : str, optional
        The parameter or derived quantity of interest. By default all parameters, by the
        determinant of their covariance (D-optimality).
    groups : str, optional
        A column of the candidates. Rows with the same value are measured together, for example one
        sweep.
    repeats : int, optional
        Largest number of times that each row or group is chosen.

    Returns
    -------
    Design
        The chosen rows, and the half widths to expect.

    Raises
    ------
    ValueError
        If candidates lack an input or have numbers that are not finite, if the goal is unknown, if
        there are fewer candidates than `size`, or if the data have no noise.

    References
    ----------
    Fedorov, Theory of Optimal Experiments, 1972.
    Cook and Nachtsheim, Technometrics 22, 1980, p. 315.

    Examples
    --------
    >>> import numpy as np
    >>> import miho
    >>> from miho.identification import optimal_design
    >>> t = np.linspace(0, 2, 50)
    >>> y = 2 * np.exp(-1.5 * t) + 0.05 * np.random.default_rng(1).standard_normal(50)
    >>> fit = miho.fit(lambda t, a, b: a * np.exp(-b * t), t, y, {"a": (0, 5), "b": (0, 10)})
    >>> optimal_design(fit, {"t": np.linspace(0, 2, 21)}, 5).chosen["t"].round(1).tolist()
    [0.0, 0.1, 0.2, 0.3, 0.7]
    """
    report = report_of(report)
    problem, at = report.problem, report.at
    frame = candidate_rows(problem.model, candidates)
    group = group_numbers(problem.model, frame, groups)
    _check(problem, at, int(group.max()) + 1, size, repeats)
    quantities, gradients = _quantities(problem, at)
    names = list(quantities["quantity"])
    if not names:
        raise ValueError(f"{problem.name}: every parameter is at a bound; widen the bounds")
    if goal is not None and goal not in names:
        held = ", which is at a bound" * (goal in problem.space.names)
        raise ValueError(f"goal is {goal!r}{held}; choose from {'; '.join(names)}; or None for all")
    nothing = np.zeros(int(group.max()) + 1, dtype=np.intp)
    design = Design(report, frame, group, nothing, goal or "", groups, quantities, gradients)
    blocks, root = _whitened(report, *design._derivatives, group)
    target = None if goal is None else root.T @ gradients[names.index(goal)]
    return replace(design, counts=best_groups(blocks, size, target, repeats))


def _check(problem: CurveFit, at: Linearised, count: int, size: int, repeats: int) -> None:
    """Raise ValueError if there are fewer than `size` choices, or if the data have no noise."""
    whole("size", size, 1)
    whole("repeats", repeats, 1)
    if size > count * repeats:
        raise ValueError(
            f"size is {size}; expected at most {count * repeats}, as each of {count} candidates is "
            f"chosen up to {repeats} times; choose fewer, or raise repeats"
        )
    if at.noise <= rounding_of(problem):
        raise ValueError(
            f"{problem.name}: every row is reproduced to rounding; expected data with noise, which "
            "further rows average out"
        )


def _whitened(
    report: Report, present: Array, candidates: Array, group: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Blocks (G, k, r) for `Information`, and the root (d, r) with parameters = root @ z.

    The present estimates of z are independent and have unit variance. The standard deviation along
    a direction that the present rows do not determine is its length from bound to bound. No
    direction changes a candidate by more than CERTAIN standard deviations of its error.
    """
    at, space = report.at, report.problem.space
    half, _, null, moved = inverse_root(present, np.flatnonzero(~at.at_bound))
    ranges = np.array([p.high - p.low for p in space.parameters])
    reach = np.divide(ranges, np.abs(null), out=np.full(null.shape, np.inf), where=moved)
    room = reach.min(axis=1)
    root = np.hstack([at.noise * half, (room[:, None] * null).T])
    rows = candidates @ root / at.noise
    changes = np.abs(rows).max(axis=0, initial=0.0)
    shorter = np.minimum(1.0, CERTAIN / np.where(changes > 0, changes, 1.0))
    rows, root = rows * shorter, root * shorter
    parts = np.split(rows[np.argsort(group, kind="stable")], np.cumsum(np.bincount(group))[:-1])
    most = max(len(part) for part in parts)
    if most == 1:
        return rows[np.argsort(group, kind="stable")][:, None, :], root
    # The triangular factor of a group, of at most r rows, has the information of all its rows.
    blocks = np.zeros((len(parts), min(most, root.shape[1]), root.shape[1]))
    for block, part in zip(blocks, parts, strict=True):
        triangle = np.linalg.qr(part, mode="r")
        block[: len(triangle)] = triangle
    return blocks, root


def _quantities(problem: CurveFit, at: Linearised) -> tuple[pd.DataFrame, Array]:
    """Free parameters and derived quantities as a table, and their gradients (q, d)."""
    rows, gradients = [], []
    space, reported = reported_space(problem.space), reported_uncertainty(problem, at)
    slopes = reported_slopes(problem, at.theta)
    for i in np.flatnonzero(~reported.at_bound):
        p = space.parameters[i]
        rows.append((p.name, "parameter", float(reported.theta[i]), p.unit))
        gradients.append(slopes[i])
    for quantity in derived(problem.model, problem.dataset):
        if quantity.tied in space.names:
            continue
        value, slope = float(quantity.evaluate(at.theta[None])[0]), gradient(quantity, at)
        if np.isfinite(value) and np.isfinite(slope).all() and slope.any():
            rows.append((quantity.name, "derived", value, quantity.unit))
            gradients.append(slope)
    return pd.DataFrame(rows, columns=["quantity", "kind", "value", "unit"]), np.array(gradients)
