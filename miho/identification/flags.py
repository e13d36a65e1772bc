"""Remarks of a report: sentences that warn when its numbers need care."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy  # loads its subpackages at first use: importing them takes a second
from numpy.typing import NDArray

from miho.identification.curve_fit import CurveFit
from miho.identification.dependence import EVENT, serial_correlation_beside_priors, widening
from miho.identification.uncertainty import parameters_at_bounds
from miho.optim.space import Space
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd

    from miho.identification.dependence import Dependence
    from miho.identification.profile_likelihood import Profile
    from miho.identification.uncertainty import Linearised
    from miho.models.derived import Derived

REMEDY = "search from more starting points, within narrower bounds or on a logarithmic scale."
"""Advice on an optimum in doubt, for fits from Python."""
CORRELATED = 0.9
"""Parameters whose absolute correlation reaches this are hard to distinguish."""
LOPSIDED = 0.2
"""A profile end is mentioned if it differs from the linearised end by this share of the half
width."""
UNEVEN = 0.1
"""A sandwich standard error is mentioned if it differs from the usual one by this share of it."""
FEWEST_FREE = 4
"""With fewer degrees of freedom, intervals of dependent rows may be too narrow."""
SURPRISING = 5e-4
"""A sum of squares is mentioned if a known sigma gives one as extreme with a smaller probability,
on either side."""
CHANCE = 0.01
"""Uneven spread is mentioned if chance produces it with at most this probability."""
NEAR_OPTIMUM = 0.1
"""A run has found the optimum if it stopped within this many standard errors of it."""
NOTICEABLE = 1e-4
"""A relative difference between the errors of run and optimum up to this is not mentioned."""
ANOTHER = 10.0
"""A run that ended more standard errors away was probably at another optimum."""


def doubtful(doubt: str, remedy: str) -> list[str]:
    """Sentences on an optimum in doubt: the reason, and a remedy."""
    return [
        f"the optimum is in doubt: {doubt}. Values, standard errors and intervals describe this "
        "local optimum only; they do not judge the data or the model.",
        remedy,
    ]


def ended_at_bounds(at: Linearised, space: Space) -> list[str]:
    """Sentences on parameters at a bound, for an optimum in doubt."""
    return [
        f"the search ended at the {end} bound of {name}, {bound}: {name} is fixed there and has no "
        "standard error, and the other standard errors are too small."
        for name, end, bound in parameters_at_bounds(space, at.theta, at.at_bound)
    ]


def held_quantities(names: Sequence[str]) -> list[str]:
    """A sentence on derived quantities that depend only on parameters at a bound."""
    return [
        f"{name} depends only on parameters at a bound, so it has no standard error."
        for name in names
    ]


def lost_effect(at: Linearised, space: Space, everywhere: NDArray[np.bool_]) -> str:
    """The doubt about an optimum at which parameters lost the effect that they have elsewhere.

    Empty if there is no such parameter. `everywhere` (d,) marks the parameters without an effect
    anywhere in the box.
    """
    names = [space.names[i] for i in np.flatnonzero(at.unidentifiable & ~everywhere)]
    if not names:
        return ""
    return (
        f"at the end of the search the predictions do not depend on {_listed(names)}, although "
        "they do elsewhere in the box"
    )


def identifiability(at: Linearised, space: Space) -> list[str]:
    """Sentences on active bounds, unidentifiable parameters and strong correlations."""
    return held_at_bounds(at, space) + not_identifiable(at, space) + strongly_correlated(at, space)


def held_at_bounds(at: Linearised, space: Space) -> list[str]:
    """Sentences on parameters at a bound."""
    return [
        f"{name} is at its {end} bound {bound}: widen the bounds, unless the data do not determine "
        f"{name}. It is fixed there and has no standard error, and the other standard errors are "
        "too small."
        for name, end, bound in parameters_at_bounds(space, at.theta, at.at_bound)
    ]


def not_identifiable(at: Linearised, space: Space, everywhere: bool = True) -> list[str]:
    """A sentence on parameters that can change without changing any prediction.

    `everywhere` says that this holds at any configuration, not only at this optimum.
    """
    sentences = []
    free = [space.names[i] for i in np.flatnonzero(at.unidentifiable)]
    if free and len(free) == len(at.null_directions):
        place = "whatever the method" if everywhere else "at this optimum"
        sentences.append(f"the data do not depend on {_listed(free)}: not identifiable, {place}.")
    elif free:
        sentences.append(
            f"{_listed(free)} are not identifiable one by one: they can change together without "
            f"changing any prediction. Fix {len(at.null_directions)} of them."
        )
    return sentences


def strongly_correlated(at: Linearised, space: Space) -> list[str]:
    """Sentences on strongly correlated parameters."""
    sentences, names = [], space.names
    for members in _correlated_groups(at.correlation):
        block = at.correlation[np.ix_(members, members)]
        strongest = block[np.triu_indices(len(members), 1)]
        r = float(strongest[np.abs(strongest).argmax()])
        group = _listed([names[i] for i in members])
        change = "increasing one and decreasing the other" if r < 0 else "changing both alike"
        if len(members) > 2:
            finding = f"correlations reach {r:.2f}, and one can compensate for the others"
        else:
            finding = f"their correlation is {r:.2f}, and {change} fits almost as well"
        sentences.append(
            f"{group} are hard to distinguish: {finding}. Trust their combinations more than the "
            "single values."
        )
    return sentences


def too_few(problem: CurveFit) -> list[str]:
    """A sentence if the only input of a model has fewer values than the model has parameters."""
    values = np.unique(problem.inputs[0]).size
    if len(problem.inputs) > 1 or values >= len(problem.space):
        return []
    name = next(iter(problem.model.inputs))
    return [
        f"{name} has {values} distinct values for {len(problem.space)} parameters: is it the right "
        "column?"
    ]


def maybe_zero(
    at: Linearised, space: Space, profiles: Sequence[Profile | None], level: float
) -> list[str]:
    """Sentences on parameters whose interval contains 0; profile intervals take precedence.

    A 0 outside the box, or beyond the range that a profile with an open end has tried, gives no
    sentence.
    """
    sentences = []
    for p, error, ends, curve in zip(
        space.parameters, at.standard_errors, at.intervals(level), profiles, strict=True
    ):
        low, high = ends if curve is None else curve.tried
        if np.isfinite(error) and max(low, p.low) <= 0 <= min(high, p.high):
            sentences.append(
                f"{p.name} does not differ significantly from 0: its {100 * level:g} % interval "
                "contains it."
            )
    return sentences


def wrong_signs(table: pd.DataFrame, quantities: Sequence[Derived]) -> list[str]:
    """Sentences on rows of `Report.derived` with the opposite of the sign that they always have."""
    declared = {quantity.name: quantity for quantity in quantities}
    wrong: dict[str, list[str]] = {}
    for row in table.to_dict("records"):
        quantity = declared[row["quantity"]]
        if quantity.sign * row["value"] < 0:
            error = row["standard error"]
            spread = f" ± {error:.2g}" if np.isfinite(error) else ""
            value = f"{quantity.name} ({row['value']:.3g}{spread} {row['unit']})"
            wrong.setdefault(quantity.remark, []).append(value)
    return [
        f"{_listed(values)} {'has' if len(values) == 1 else 'have'} {remark}"
        for remark, values in wrong.items()
    ]


def profile_shapes(
    linearised: Array, space: Space, profiles: Sequence[Profile | None]
) -> list[str]:
    """Sentences on open profile intervals, and on profiles unlike `linearised` (d, 2) intervals."""
    sentences = []
    for p, (low, high), curve in zip(space.parameters, linearised, profiles, strict=True):
        if curve is None:
            continue
        name, sides, reach = p.name, [], []
        for side, end, tried, edge in zip(
            ("below", "above"), (curve.low, curve.high), curve.tried, (p.low, p.high), strict=True
        ):
            if np.isinf(end):
                place = "the bound" if tried == edge else "the end of the profile"
                sides.append(side)
                reach.append(f"{'down' if side == 'below' else 'up'} to {tried:.4g}, {place}")
        if sides:
            sentences.append(
                f"the data do not limit {name} {' or '.join(sides)}: the fit is not significantly "
                f"worse {', and '.join(reach)}; values beyond were not tried."
            )
            continue
        half = (high - low) / 2
        off = max(abs(low - curve.low), abs(curve.high - high)) / half if half < np.inf else 0.0
        if off > LOPSIDED:
            sentences.append(
                f"{name}: the linearised interval differs from the profile interval by "
                f"{100 * off:.0f} % of its half width; use the profile interval."
            )
    return sentences


def spread_is_uneven(problem: CurveFit, at: Linearised, reported: Linearised) -> bool:
    """Whether the spread of the errors changes enough to change a standard error `reported`."""
    changed = bool((np.abs(reported.sandwich_ratios - 1) > UNEVEN).any())
    return changed and _chance_of_spread(problem, at) <= CHANCE


def uneven_spread(at: Linearised, space: Space) -> list[str]:
    """A sentence on the intervals that are too wide or too narrow because of an uneven spread."""
    ratios, sentences = at.sandwich_ratios, []
    for kind, off in (("wide", ratios < 1 - UNEVEN), ("narrow", ratios > 1 + UNEVEN)):
        those = [f"{space.names[i]} (times {ratios[i]:.2f})" for i in np.flatnonzero(off)]
        if those:
            sentences.append(f"too {kind} for {_listed(those)}")
    return [
        "the standard deviation of the errors changes along the data, but linearised and profile "
        f"intervals assume a constant one: they are {' and '.join(sentences)}. Prefer the sandwich "
        "intervals, which remain valid, or the bootstrap."
    ]


def _chance_of_spread(problem: CurveFit, at: Linearised) -> float:
    """P value of the test for an even spread (White 1980, without cross products)."""
    errors = problem.errors(at.theta)
    if at.dependence is not None:
        errors = at.dependence.model.innovations(errors)
    squares = (errors / (np.abs(errors).max() or 1.0)) ** 2
    if not np.var(squares):
        return 1.0
    J = problem.model.jacobian(at.theta, *problem.inputs)[-errors.size :, at.standard_errors > 0]
    size = np.abs(J).max(axis=0)
    J = (J / np.where(size > 0, size, 1.0)) ** 2
    columns = np.column_stack([np.ones(squares.size), J])
    fitted = columns @ np.linalg.lstsq(columns, squares, rcond=None)[0]
    explained = np.var(fitted) / np.var(squares)
    rank = int(np.linalg.matrix_rank(columns)) - 1
    return float(scipy.special.chdtrc(rank, squares.size * explained)) if rank else 1.0


def independence(problem: CurveFit, at: Linearised, reported: Linearised) -> list[str]:
    """Sentences on rows that are not independent: rows of events, or correlated neighbours.

    `at` describes the free parameters, `reported` the parameters with widened intervals.
    """
    if at.events:
        return [
            "rows of one event are not independent: standard errors, intervals and the bootstrap "
            f"count {at.events} events instead of rows, and there are no profiles."
        ]
    sentences = []
    if EVENT in problem.dataset.columns:
        sentences.append(
            "the rows come from too few events to allow for the dependence within an event."
        )
    usable = np.isfinite(reported.standard_errors) & (reported.standard_errors > 0)
    if reported.dependence is not None and usable.any():
        sentences.append(_alike(reported, reported.dependence, np.eye(usable.size)[usable]))
    correlation = serial_correlation_beside_priors(problem, at.theta)
    if correlation:
        sentences.append(
            f"the errors of neighbouring rows are correlated ({correlation:.2f}): with priors, "
            "standard errors and intervals do not allow for that and are too narrow."
        )
    return sentences


def _alike(at: Linearised, dependence: Dependence, axes: Array) -> str:
    """A sentence on correlated neighbours, and the widening of intervals along `axes` (n, d)."""
    factors = list(dict.fromkeys(f"{f:.1f}" for f in np.sort(widening(at, axes))[[0, -1]]))
    sentence = (
        f"the errors of neighbouring rows are correlated ({dependence.correlation:.2f}), so the "
        "rows carry less information than independent rows would: standard errors and intervals "
        f"allow for that and are {' to '.join(factors)} times as wide. If the correlation comes "
        "from a wrong shape of the model, a better model narrows them."
    )
    if at.freedom < FEWEST_FREE:
        unknown = at.quantile() / at.independent.quantile()
        degrees = f"{at.freedom} degree{'s' * (at.freedom > 1)} of freedom"
        sentence += (
            " The correlation reaches over so much of the data that its length is hardly known "
            f"({degrees}), which alone makes intervals up to {unknown:.1f} times as wide; even "
            "these may be too narrow. A longer measurement helps, or a term of the model for the "
            "drift; more rows in the same time do not."
        )
    return sentence


def followed(problem: CurveFit, trends: pd.DataFrame) -> list[str]:
    """Sentences on columns that the errors follow.

    The cause is a wrong shape of the model, a missing input, or correlated noise.
    """
    from miho.identification.validation import OR_DRIFT, in_a_sweep, is_finding

    sentences = []
    for row in trends.to_dict("records"):
        if not is_finding(row["explained"], row["p of independent rows"]):
            continue
        name = row["column"]
        share = f"{100 * row['explained']:.0f} % of the errors' variance follows {name}"
        if not is_finding(row["explained"], row["p"]):
            sentences.append(
                f"{share}, but correlated noise, such as drift, would do so too: these data cannot "
                f"distinguish it from a wrong model. Repeat the measurement with {name} in another "
                f"order: errors of the model follow {name} again, and drift does not."
            )
        elif row["an input"] == "yes":
            drift = f", {OR_DRIFT.format(name=name)}" if in_a_sweep(problem, name) else ""
            sentences.append(f"{share}: the model has the wrong shape{drift}.")
        else:
            sentences.append(
                f"{share}, which is not an input of the model: this part is not noise, and only a "
                "model with that input can remove it."
            )
    return sentences


def run_differs(run: Array, at: Linearised, space: Space, gain: float) -> list[str]:
    """A sentence if the result (d,) of the run is not the optimum that the report describes.

    `gain` is the fraction by which the error falls from the run to the optimum.
    """
    usable = np.isfinite(at.standard_errors) & (at.standard_errors > 0)
    away = np.abs(run - at.theta)[usable] / at.standard_errors[usable]
    if gain <= NOTICEABLE and (not away.size or away.max() <= NEAR_OPTIMUM):
        return []
    percent = 100 * gain / (1 - gain) if gain < 1 else np.inf
    higher = f"{percent:.2g}" if percent < 100 else f"{percent:.0f}"
    place = "far from it" if away.size and away.max() > ANOTHER else "near it"
    return [
        f"the report describes the optimum found after the run; the run itself ended {place}, at "
        f"an error {higher} % higher."
    ]


def _correlated_groups(correlation: Array) -> list[list[int]]:
    """Groups of parameters connected by strong correlations, in the order of the parameters."""
    strong = np.abs(np.nan_to_num(correlation)) >= CORRELATED
    count, label = scipy.sparse.csgraph.connected_components(strong, directed=False)
    groups = [np.flatnonzero(label == group).tolist() for group in range(count)]
    return [group for group in groups if len(group) > 1]


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def sigma_disagrees(problem: CurveFit, at: Linearised) -> list[str]:
    """A sentence if the errors contradict a known sigma."""
    if not (at.noise_known and at.freedom):
        return []
    squares, freedom = float(np.sum(problem.errors(at.theta) ** 2)) / at.noise**2, at.freedom
    tails = scipy.special.chdtr(freedom, squares), scipy.special.chdtrc(freedom, squares)
    if min(tails) >= SURPRISING:
        return []
    times = math.sqrt(squares / freedom)
    meaning = "too small, or the model is wrong" if times > 1 else "too large"
    return [
        f"the errors are {times:.3g} times as large as sigma states (chi-squared {squares:.4g}, "
        f"{freedom} degrees of freedom): sigma is {meaning}. Standard errors use sigma as given; "
        "sigma_known=False estimates a common factor."
    ]
