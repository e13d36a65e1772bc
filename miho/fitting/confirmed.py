"""Checks that a fit evaluates the function of the user correctly.

A search may replace calls with numbers by a traced formula, or by calls with arrays of parameters.
Some configurations before the search, and the optimum after it, must give the same values.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from miho.identification.curve_fit import CurveFit
from miho.models.function_model import FunctionFormula, alike
from miho.models.model import Model, expensive_leaves
from miho.parallel.worth import is_expensive
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.parallel import Evaluations

CONFIGURATIONS, VALUES = 30, 1_000_000
"""Largest numbers of configurations, and of their values, that are compared before a search."""
REPEATED = 1e-9
"""The errors of two calls differ if the difference exceeds this share of the norm of the output."""


def by_calls(
    problem: CurveFit, thetas: Array, evaluations: Evaluations | None = None
) -> CurveFit | None:
    """The problem with functions called with numbers, if that gives other values; else None.

    Values at parameter rows (n, d) are compared; at the first row only for a slow function. The
    result is None too if evaluations may not be repeated.
    """
    called = problem.model.with_numbers()
    if called is problem.model or _is_final(problem, evaluations):
        return None
    model, inputs = problem.model, problem.inputs

    def agree() -> bool:
        started = time.perf_counter()
        same = _same(model, called, thetas[:1], inputs)
        if same and len(thetas) > 1 and not is_expensive(time.perf_counter() - started):
            same = _same(model, called, thetas[1:], inputs)
        return same

    formula = model if isinstance(model, FunctionFormula) and len(thetas) > 1 else None
    if agree() if formula is None else formula.passed("agrees", agree, thetas, *inputs):
        return None
    sys.stderr.write(
        f"miho: {problem.name}: the function gives other values for numbers than for arrays, so it "
        "is called with numbers, one configuration at a time\n"
    )
    return replace(problem, model=called, expensive=True)


def compared_at(problem: CurveFit) -> Array:
    """Configurations (n, d) in the box for the comparison before a search."""
    count = min(CONFIGURATIONS, max(1, VALUES // max(1, len(problem.dataset))))
    return problem.space.decode(problem.space.initial(count))


def check_repeats(
    problem: CurveFit, theta: Array, cost: float, evaluations: Evaluations | None = None
) -> None:
    """Warn if a second call of the function at `theta` (d,) gives another sum of squares."""
    if not expensive_leaves(problem.model) or _is_final(problem, evaluations):
        return
    try:
        again = float(np.sum(problem.residuals(theta) ** 2))
    except ValueError:
        again = math.inf
    size = float(np.linalg.norm(problem.dataset[problem.dataset.output]))
    if abs(math.sqrt(again) - math.sqrt(cost)) > REPEATED * max(size, math.sqrt(cost)):
        first, second = (math.sqrt(value / problem.residual_count) for value in (cost, again))
        warnings.warn(
            f"{problem.name}: two calls with the same parameters give the errors {first:.6g} and "
            f"{second:.6g} {problem.unit}".rstrip()
            + "; a model with random numbers or an internal state has no optimum: reset them in "
            "each call",
            UserWarning,
            stacklevel=5,
        )


def _is_final(problem: CurveFit, evaluations: Evaluations | None) -> bool:
    """Whether evaluations may not be repeated: a journal records them, or they may hang."""
    return (
        evaluations is not None
        and not evaluations.may_repeat
        and bool(expensive_leaves(problem.model))
    )


def _same(model: Model, called: Model, thetas: Array, inputs: tuple[Array, ...]) -> bool:
    """Whether two models agree at parameter rows (n, d); rows that make `called` raise agree."""
    try:
        first, second = (each.predict(thetas, *inputs) for each in (model, called))
    except ValueError:
        if len(thetas) > 1:
            return all(_same(model, called, row[None], inputs) for row in thetas)
        return _raises(called, thetas, inputs)
    if np.array_equal(first, second):
        return True
    # Rows are compared on separate scales; numbers that are not finite have no value.
    finite = [np.where(np.isfinite(values), values, np.nan) for values in (first, second)]
    size = np.nan_to_num(np.abs(finite[0])).max(axis=1, keepdims=True, initial=0.0)
    size[size == 0] = 1.0
    return alike(finite[0] / size, finite[1] / size)


def _raises(model: Model, thetas: Array, inputs: tuple[Array, ...]) -> bool:
    try:
        model.predict(thetas, *inputs)
    except ValueError:
        return True
    return False
