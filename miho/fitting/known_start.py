"""The best configuration in a journal of evaluations, as a starting point."""

from __future__ import annotations

import math

import numpy as np

from miho.fitting.expensive_fit import JournalPath
from miho.identification.constraints import free_values
from miho.identification.curve_fit import CurveFit
from miho.models.model import expensive_leaves
from miho.models.spread import SpreadModel

CLOSE = 1e-9
"""Relative difference between values of a tied parameter that counts as rounding."""
JOURNAL = "journal"
"""The name of the start at the best configuration in the journal."""


def check_start(start: str, journal: JournalPath) -> None:
    """Raise ValueError for a named start that is not "journal", or without a journal."""
    if start != JOURNAL:
        raise ValueError(f"start is {start!r}; expected numbers by name, or {JOURNAL!r}")
    if journal is None:
        raise ValueError(f"start is {JOURNAL!r}; expected a file as journal as well")


def best_known(problem: CurveFit) -> dict[str, float]:
    """The configuration in the journal with the smallest loss, without priors.

    The evaluations of `problem` are journaled. Raises ValueError if no configuration in the journal
    satisfies bounds and constraints, and for a model with several parts.
    """
    leaves = expensive_leaves(problem.model)
    if len(leaves) != 1 or not isinstance(leaves[0], SpreadModel):
        raise ValueError(
            f"start: expected a single model whose evaluations are journaled, got {problem.name}; "
            "give numbers"
        )
    thetas, outputs = leaves[0].known(*problem.inputs)
    for k in np.argsort(problem.losses_of(outputs), kind="stable") if len(thetas) else ():
        values = dict(zip(leaves[0].parameters, thetas[k].tolist(), strict=True))
        if _is_allowed(problem, values):
            return values
    raise ValueError(
        f"start: the journal has no configuration of {problem.name} within the bounds with a "
        "finite value; give numbers, or no start to search"
    )


def _is_allowed(problem: CurveFit, values: dict[str, float]) -> bool:
    """Whether parameters can have these values within bounds, ties and constraints."""
    ties, space = problem.model.ties, problem.space
    try:
        theta = free_values(space, ties, values)
    except (KeyError, ValueError):  # its ties differ
        return False
    if ties is not None:
        whole = dict(zip(ties.names, ties.values(theta[None])[0], strict=True))
        if not all(math.isclose(whole[name], values[name], rel_tol=CLOSE) for name in values):
            return False
    return bool(((theta >= space.low) & (theta <= space.high)).all())
