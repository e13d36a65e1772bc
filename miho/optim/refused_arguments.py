"""Errors on arguments of a run that have another type than documented, each with its remedy."""

from __future__ import annotations

from miho.optim.meter import Budget
from miho.optim.optimizer import Optimizer
from miho.optim.problem import Problem
from miho.optim.space import Space
from miho.validate import whole


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
            raise ValueError(f"{label} is {value!r}; expected {expected}")
    check_budget(budget)
    whole("seed", seed, 0)
    return int(seed)
