"""Whole profiles for tests, at 95 %."""

from __future__ import annotations

from collections.abc import Sequence

from miho.identification import CurveFit, Linearised
from miho.identification.deadline import Deadline
from miho.identification.profile_likelihood import SIGNS, Profile, joined, profile_side


def profile_of(
    problem: CurveFit, at: Linearised, of: int | str, others: Sequence[Linearised] = ()
) -> Profile:
    """The profile of a parameter from both of its sides."""
    lower, upper = (profile_side(problem, (at, *others), 0.95, Deadline(), (of, s)) for s in SIGNS)
    assert lower is not None and upper is not None
    return joined(lower, upper)
