"""Optimal experimental design: which of many possible rows to measure next.

The expected covariance after a choice is that of the linearised model with the present rows and the
chosen ones (Fedorov, Theory of Optimal Experiments, 1972): D-optimal rows make its determinant
small, c-optimal ones the variance of one parameter or derived quantity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.identification.candidates import (
    Candidates,
    candidate_rows,
    derivatives,
    group_numbers,
)
from miho.identification.curve_fit import CurveFit
from miho.identification.derived import derived, gradient
from miho.identification.design_words import advice, assumptions, table_text
from miho.identification.exchange import Information, best_groups
from miho.identification.inverse_root import inverse_root
from miho.identification.report import Report, rounding_of
from miho.identification.stated import reported_slopes, reported_space, reported_uncertainty
from miho.identification.uncertainty import Linearised
from miho.models.joint import PART
from miho.quantities import Array
from miho.validate import whole


@dataclass(frozen=True, eq=False)
class Design:
    """Rows to measure next, and what they would tell.

    `candidates` (m rows) has the model's inputs in their SI units, `group` (m,) the number of the
    group, from 0, that is measured as a whole, and `counts` (G,) how often each is chosen. `groups`
    is the column that numbers the groups, None if each row is one; `goal` the parameter or derived
    quantity that the choice is for, "" for all parameters. `gradients` (q, d) are the derivatives
    of the `quantities` (q rows).
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
        """The candidates to measure, with their row numbers as the index; repeated ones again."""
        return self.candidates.iloc[np.repeat(np.arange(len(self.group)), self._times)]

    @property
    def _times(self) -> NDArray[np.intp]:
        """How often each candidate row is measured, (m,)."""
        return np.asarray(self.counts[self.group])

    @cached_property
    def undeterminable(self) -> list[str]:
        """The quantities that stay open even if every candidate is measured."""
        at_best = self._after(np.ones(len(self.group))).spread(self.gradients)
        return list(self.quantities["quantity"][np.isinf(at_best)])

    @cached_property
    def _derivatives(self) -> tuple[Array, Array]:
        """Those of the present rows (N, d) and of the candidates (m, d)."""
        problem, at = self.report.problem, self.report.at
        return (
            problem.error_slopes(at.theta),
            self._weights[:, None]
            * derivatives(problem.model, at.theta, self.candidates, self.group),
        )

    @property
    def _weights(self) -> Array:
        """What errors of the candidates are multiplied by, (m,): in a joint model as its part's."""
        problem, rows = self.report.problem, self.candidates
        if problem.weights is None or PART not in rows:
            return np.ones(len(rows))
        part, index = problem.dataset[PART], rows[PART].to_numpy()
        known = np.unique(part)
        strange = index[~np.isin(index, known)]
        if strange.size:
            raise ValueError(
                f"candidates: {PART!r} is {strange[0]:g}; expected 0 to {known[-1]:g}, a "
                "part's place among them"
            )
        squares = np.array([np.mean(problem.weights[part == k] ** 2) for k in known])
        return np.asarray(np.sqrt(squares)[np.searchsorted(known, index)])

    @cached_property
    def expected(self) -> Linearised:
        """The uncertainty of the optimum after the chosen rows, errors being independent."""
        return self._after(self._times.astype(float))

    def _after(self, weights: Array) -> Linearised:
        """The same with each candidate (m,) measured so many times."""
        present, candidates = self._derivatives
        used = weights > 0
        rows = np.sqrt(weights[used])[:, None] * candidates[used]
        return with_rows(self.report.at, np.vstack([present, rows]), round(weights.sum()))

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row per parameter that is not at a bound and per derived quantity.

        Its value, and half widths of the interval at the report's level: `present`, `expected`
        after the chosen rows, and `evenly` after as many that are spread evenly over all
        candidates. The same in % of the value, NaN where that is not larger than the half width.
        Present half widths are the report's linearised ones; the expected ones are narrower by the
        factor that holds for errors that are independent.
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
        """By how many % each candidate alone (or each group) would narrow each quantity.

        Rows are the first candidates of the groups. Of what the present data do not determine: of
        the range in the space.
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
        """Present, candidate and chosen rows below each other, to draw: the inputs, with units."""
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
        """The advice in words, the table, and what they rest on."""
        notes = "\n".join(f"- {sentence}" for sentence in assumptions(self))
        return "\n\n".join([advice(self), table_text(self), notes])


def optimal_design(
    report: Report,
    candidates: Candidates,
    size: int,
    *,
    goal: str | None = None,
    groups: str | None = None,
    repeats: int = 1,
) -> Design:
    """The `size` of the candidates that tell the most, in addition to the data of the report.

    Candidates are rows with all inputs of the model, in its units: a table or a dataset, or a
    mapping of each input to its levels, of which every combination is a candidate. `goal` names
    the parameter or the derived quantity that is to be known better; by default it is all
    parameters. Rows with the same value in the column `groups` are measured together, such as one
    sweep; `size` counts groups then. Each is chosen up to `repeats` times.

    Linearised at the report's optimum, with errors as large as the present ones: choose a part of
    a large campaign, measure, fit, and choose again. Raises ValueError for candidates or a goal
    that do not fit.
    """
    problem, at = report.problem, report.at
    frame = candidate_rows(problem.model, candidates)
    group = group_numbers(problem.model, frame, groups)
    _check(problem, at, int(group.max()) + 1, size, repeats)
    quantities, gradients = _quantities(problem, at)
    names = list(quantities["quantity"])
    if goal is not None and goal not in names:
        raise ValueError(f"goal is {goal!r}; choose from {'; '.join(names)}; or None for all")
    nothing = np.zeros(int(group.max()) + 1, dtype=np.intp)
    design = Design(report, frame, group, nothing, goal or "", groups, quantities, gradients)
    blocks, root = _whitened(report, *design._derivatives, group)
    target = None if goal is None else root.T @ gradients[names.index(goal)]
    return replace(design, counts=best_groups(blocks, size, target, repeats))


def _check(problem: CurveFit, at: Linearised, count: int, size: int, repeats: int) -> None:
    """Raise ValueError if so many cannot be chosen of `count`, or if there is nothing to gain."""
    whole("size", size, 1)
    whole("repeats", repeats, 1)
    if size > count * repeats:
        raise ValueError(
            f"size is {size}, more than the {count} candidates, each up to {repeats} times; choose "
            "fewer, or set repeats"
        )
    if at.noise <= rounding_of(problem):
        raise ValueError(
            f"{problem.name}: every row is reproduced to rounding, so there is no noise that "
            "further rows could average out"
        )


def with_rows(at: Linearised, J: Array, more: int) -> Linearised:
    """The uncertainty of an optimum by derivatives J (N, d) of all rows, `more` of them new.

    Errors are independent and as large as `at` has them.
    """
    root = inverse_root(J, np.flatnonzero(~at.at_bound))
    covariance = at.noise**2 * root.half @ root.half.T
    return replace(
        at,
        covariance=covariance,
        sandwich=covariance,
        freedom=at.freedom if at.events else at.freedom + more,
        null_directions=root.null,
        unidentifiable=np.asarray(root.moved.any(axis=0)),
    )


def _whitened(
    report: Report, present: Array, candidates: Array, group: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Blocks (G, k, r) for `Information`, and the root (d, r): parameters are root @ z.

    The present estimates of z are independent and of unit variance. A direction that the present
    rows do not see is known within the space only, as far as it leads from bound to bound.
    """
    at, space = report.at, report.problem.space
    half, _, null, moved = inverse_root(present, np.flatnonzero(~at.at_bound))
    ranges = np.array([p.high - p.low for p in space.parameters])
    reach = np.divide(ranges, np.abs(null), out=np.full(null.shape, np.inf), where=moved)
    room = reach.min(axis=1)
    root = np.hstack([at.noise * half, (room[:, None] * null).T])
    rows = candidates @ root / at.noise
    parts = np.split(rows[np.argsort(group, kind="stable")], np.cumsum(np.bincount(group))[:-1])
    most = max(len(part) for part in parts)
    if most == 1:
        return rows[np.argsort(group, kind="stable")][:, None, :], root
    # The triangular factor of a group tells as much as its rows, in r rows at most.
    blocks = np.zeros((len(parts), min(most, root.shape[1]), root.shape[1]))
    for block, part in zip(blocks, parts, strict=True):
        triangle = np.linalg.qr(part, mode="r")
        block[: len(triangle)] = triangle
    return blocks, root


def _quantities(problem: CurveFit, at: Linearised) -> tuple[pd.DataFrame, Array]:
    """What can be asked for, and its gradients (q, d): free parameters and derived quantities."""
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
