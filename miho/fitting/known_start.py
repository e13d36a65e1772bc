"""A start from what is known: the best configuration that stands in a journal."""

from __future__ import annotations

import math

import numpy as np

from miho.fitting.dear_fit import JournalPath
from miho.identification.constraints import free_values
from miho.identification.curve_fit import CurveFit
from miho.models.leaves import dear_leaves
from miho.models.spread import SpreadModel
from miho.models.tied import Tied

CLOSE = 1e-9
"""Tied parameters have a value if theirs differs by less than this share: by rounding."""
JOURNAL = "journal"
"""What a start is called that is the best known one."""


def check_start(start: str, journal: JournalPath) -> None:
    """Refuse a start by name that is not one of a journal."""
    if start != JOURNAL:
        raise ValueError(f"start is {start!r}; expected numbers by name, or {JOURNAL!r}")
    if journal is None:
        raise ValueError(f"start is {JOURNAL!r}; give the journal's file as well")


def best_known(problem: CurveFit) -> dict[str, float]:
    """The configuration of the smallest loss, without priors, whose evaluation is known.

    The `problem` is one whose evaluations are journaled. Raises ValueError where none is known that
    keeps bounds and constraints, and for a model that is made of several.
    """
    leaves = dear_leaves(problem.model)
    if len(leaves) != 1 or not isinstance(leaves[0], SpreadModel):
        raise ValueError(f"start: {problem.name} is not one model that may be dear; give numbers")
    thetas, outputs = leaves[0].known(*problem.inputs)
    for k in np.argsort(problem.losses_of(outputs), kind="stable") if len(thetas) else ():
        values = dict(zip(leaves[0].parameters, thetas[k].tolist(), strict=True))
        if _is_allowed(problem, values):
            return values
    raise ValueError(
        f"start: the journal knows no configuration of {problem.name} within the bounds that has a "
        "value; give numbers, or none to search"
    )


def _is_allowed(problem: CurveFit, values: dict[str, float]) -> bool:
    """Whether parameters can have these values within bounds, ties and constraints."""
    model, space = problem.model, problem.space
    if not isinstance(model, Tied):
        theta = np.array([values[name] for name in space.names])
    else:
        try:
            theta = free_values(space, model.ties, values)
        except (KeyError, ValueError):  # it was of other ties
            return False
        whole = dict(zip(model.ties.names, model.ties.values(theta[None])[0], strict=True))
        if not all(math.isclose(whole[name], values[name], rel_tol=CLOSE) for name in values):
            return False
    return bool(((theta >= space.low) & (theta <= space.high)).all())
