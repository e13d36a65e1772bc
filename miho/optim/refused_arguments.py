"""Errors on arguments of a run and on priors, each with its remedy."""

from __future__ import annotations

import math

from miho.optim.meter import Budget
from miho.optim.optimizer import Optimizer
from miho.optim.problem import Problem
from miho.optim.space import Parameter, Space
from miho.validate import whole

FARTHEST = 3.0
"""Largest distance of a prior's mean outside the bounds, in its standard deviations."""


ROUNDING = 1e-12
"""A fixed value is at a bound if it is outside by this fraction of the largest of both bounds."""


def checked_prior(parameter: Parameter, label: str) -> tuple[float, float]:
    """The prior of a parameter as two numbers; raises ValueError for other ones."""
    stated = f"{label}: prior is {parameter.prior!r}"
    try:
        mean, std = map(float, parameter.prior or ())
    except (TypeError, ValueError):
        raise ValueError(f"{stated}; expected mean and standard deviation") from None
    log = parameter.scale == "log"
    usable = math.isfinite(mean) and 0 < std < math.inf and (mean > 0 or not log)
    if parameter.fixed is not None or not usable:
        raise ValueError(
            f"{stated}; expected a finite mean, above 0 on the log scale, and a standard deviation "
            "above 0, of a parameter that is not fixed"
        )
    ends = (parameter.low, mean), (mean, parameter.high)
    room = min(
        (math.log(b / a) if a > 0 and b > 0 else math.inf) if log else b - a for a, b in ends
    )
    if room < -FARTHEST * std:
        raise ValueError(
            f"{stated}, {-room / std:.3g} deviations outside of {parameter.low:g} to "
            f"{parameter.high:g}; correct one of them"
        )
    return mean, std


def check_ends(parameter: Parameter, label: str) -> None:
    """Raise ValueError if bounds are in the wrong order, or a fixed value is far outside them."""
    low, high, fixed = parameter.low, parameter.high, parameter.fixed
    ends = f"low is {low!r} and high is {high!r}"
    if not low <= high:
        raise ValueError(f"{label}: {ends}; expected low <= high")
    slack = ROUNDING * max(abs(end) for end in (fixed or 0.0, low, high) if math.isfinite(end))
    if fixed is not None and abs(fixed - min(max(fixed, low), high)) > slack:
        raise ValueError(f"{label}: fixed is {fixed!r}, but {ends}; correct one of them")


def check_budget(budget: object) -> None:
    """Raise ValueError unless `budget` is a Budget or None."""
    if not isinstance(budget, Budget | None):
        raise ValueError(
            f"budget is {budget!r}; expected a Budget, for example miho.Budget(evaluations=1000) "
            "or miho.Budget(seconds=60)"
        )


def checked_seed(
    optimizer: object, problem: object, space: object, name: object, budget: object, seed: int
) -> int:
    """The seed as an int; raises ValueError for arguments of other types than documented."""
    for label, value, kind, expected in (
        ("optimizer", optimizer, Optimizer, "a method, for example miho.MIHOGN()"),
        ("problem", problem, Problem, "a miho.Problem; miho.fit takes a function"),
        ("space of the problem", space, Space, "a miho.Space"),
        ("name of the problem", name, str, "a word"),
    ):
        if isinstance(value, type) and issubclass(value, kind) and kind in (Optimizer, Problem):
            raise ValueError(f"{label} is the class {value.__name__}; write {value.__name__}()")
        if not isinstance(value, kind):
            raise ValueError(f"{label} is {value!r:.80}; expected {expected}")
    check_budget(budget)
    whole("seed", seed, 0)
    return int(seed)
