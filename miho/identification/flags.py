"""What the numbers of a report mean, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from miho.identification.profile import Profile
from miho.identification.uncertainty import Linearised
from miho.optim.space import Space

Array = NDArray[np.float64]

CORRELATED = 0.9
LOPSIDED = 0.2
"""An end of a profile this far from the linearised one, as a fraction of the interval's half."""
UNEVEN = 0.25
"""A sandwich standard error this far from the usual one, as a fraction of it."""
RESEMBLING = 0.1
"""Correlation of neighbouring rows' errors from which on they are not independent."""
NEAR_OPTIMUM = 0.1
"""A run that stopped within this many standard errors of the optimum has found it."""


def identifiability(at: Linearised, space: Space, level: float) -> list[str]:
    """Sentences on bounds, directions the data do not see, vague and entangled parameters."""
    sentences = []
    names, theta, errors = space.names, at.theta, at.standard_errors
    for i in np.flatnonzero(at.at_bound):
        p = space.parameters[i]
        low = theta[i] - p.low < p.high - theta[i]
        end, bound = ("lower", p.low) if low else ("upper", p.high)
        sentences.append(
            f"{p.name} is at its {end} bound {bound:g} {p.unit}: widen the space, or the data do "
            "not determine it. It is held there, so it has no standard error and the others' are "
            "too small."
        )
    for direction in at.unseen:
        touched = [names[i] for i in np.flatnonzero(np.abs(direction) > 1e-6)]
        if len(touched) == 1:
            sentences.append(f"{touched[0]} is not identifiable: the data do not depend on it.")
        else:
            sentences.append(
                f"{_listed(touched)} are not identifiable one by one: they can change together "
                "and leave every prediction as it is. Fix one of them."
            )
    for together in _entangled(at.correlation):
        block = at.correlation[np.ix_(together, together)]
        strongest = block[np.triu_indices(len(together), 1)]
        r = float(strongest[np.abs(strongest).argmax()])
        who = _listed([names[i] for i in together])
        one_up = "a larger one with a smaller other" if r < 0 else "both larger or both smaller"
        if len(together) > 2:
            told = f"correlations reach {r:.2f}, one can make up for the others"
        else:
            told = f"their correlation is {r:.2f}, {one_up} fits almost as well"
        sentences.append(
            f"{who} are hard to tell apart: {told}. Trust what they make together more than each."
        )
    reach = at.quantile(level)
    sentences += [
        f"{names[i]} cannot be told from 0: its {100 * level:g} % interval contains it."
        for i in np.flatnonzero(np.isfinite(errors))
        if errors[i] * reach >= abs(theta[i])
    ]
    return sentences


def _entangled(correlation: Array) -> list[list[int]]:
    """Groups of parameters that strong correlations connect, in the order of the parameters."""
    strong = np.abs(np.nan_to_num(correlation)) >= CORRELATED
    count, label = connected_components(strong, directed=False)
    groups = [np.flatnonzero(label == group).tolist() for group in range(count)]
    return [group for group in groups if len(group) > 1]


def trustworthiness(
    at: Linearised, space: Space, profiles: Sequence[Profile | None], level: float
) -> list[str]:
    """Sentences on where the linearised standard errors mislead."""
    sentences = []
    for name, value, half, found in zip(
        space.names, at.theta, at.quantile(level) * at.standard_errors, profiles, strict=True
    ):
        if found is None:
            continue
        open_ends = [
            side for side, end in (("below", found.low), ("above", found.high)) if np.isinf(end)
        ]
        if open_ends:
            sentences.append(
                f"{name} is not bounded {' or '.join(open_ends)}: the profile reaches the edge of "
                "the space before the fit becomes significantly worse."
            )
            continue
        off = max(abs(value - half - found.low), abs(found.high - value - half)) / half
        if off > LOPSIDED:
            sentences.append(
                f"{name}: its linearised interval is off by {100 * off:.0f} % of its half width; "
                "use the profile interval."
            )
    errors, usable = at.standard_errors, np.isfinite(at.standard_errors)
    usable &= errors > 0
    ratio = np.full(errors.size, np.nan)
    ratio[usable] = np.sqrt(np.diag(at.sandwich)[usable]) / errors[usable]
    uneven = [
        f"{name} (times {r:.2f})"
        for name, r in zip(space.names, ratio, strict=True)
        if np.isfinite(r) and abs(r - 1) > UNEVEN
    ]
    if uneven:
        sentences.append(
            "the errors do not have the same spread everywhere: standard errors that allow for it "
            f"differ for {_listed(uneven)}. Prefer the bootstrap."
        )
    return sentences


def independence(errors: Array) -> list[str]:
    """A sentence if the errors (N,) of neighbouring rows resemble each other."""
    centred = errors - errors.mean()
    total = float(centred @ centred)
    r = float(centred[1:] @ centred[:-1]) / total if total > 0 else 0.0
    if r <= max(RESEMBLING, 3 / np.sqrt(errors.size)):
        return []
    factor = np.sqrt((1 + r) / (1 - r)) if r < 1 else np.inf
    return [
        f"the errors of neighbouring rows are alike (correlation {r:.2f}), so the rows say less "
        f"than their number: standard errors are too small by a factor of about {factor:.1f}, "
        "unless the model's shape is at fault."
    ]


def convergence(found: Array, at: Linearised, space: Space, gain: float) -> list[str]:
    """A sentence if the run ended away from the optimum at which the uncertainty is taken.

    `gain` is the fraction by which the error falls from the run to the optimum.
    """
    usable = np.isfinite(at.standard_errors) & (at.standard_errors > 0)
    away = np.abs(found - at.theta)[usable] / at.standard_errors[usable]
    if not away.size or away.max() <= NEAR_OPTIMUM:
        return []
    name = np.array(space.names)[usable][away.argmax()]
    return [
        f"the run ended {away.max():.2g} standard errors of {name} away from the optimum nearby "
        f"(error {100 * gain:.2g} % lower); the intervals are those of the optimum."
    ]


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
