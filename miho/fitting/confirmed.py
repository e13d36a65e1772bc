"""Whether a fit is that of the user's function: it is called before the search and at its end.

A formula that was traced, and parameters side by side, take the place of calls with numbers. That
they give the same is seen at some configurations before the search, and at the optimum.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from dataclasses import replace

import numpy as np

from miho.identification.curve_fit import CurveFit
from miho.models.function_model import FunctionFormula, FunctionModel, alike
from miho.models.joint import JointExpression, JointModel
from miho.models.leaves import dear_leaves
from miho.models.model import Model
from miho.models.tied import Tied, TiedModel
from miho.parallel import Evaluations
from miho.parallel.worth import is_dear
from miho.quantities import Array

CONFIGURATIONS, VALUES = 30, 1_000_000
"""Configurations at which calls are compared before a search, and values of them at most."""
REPEATED = 1e-9
"""Errors of two calls differ if by more than this share of the output's size."""


def by_calls(
    problem: CurveFit, thetas: Array, evaluations: Evaluations | None = None
) -> CurveFit | None:
    """The problem whose functions are called with numbers, where that gives other values.

    The values at parameter rows (n, d) are compared; of a slow function those at the first. None if
    they agree, or if `evaluations` may not be repeated.
    """
    called = _called(problem.model)
    if called is problem.model or _is_final(problem, evaluations):
        return None
    model, inputs = problem.model, problem.inputs

    def agree() -> bool:
        started = time.perf_counter()
        same = _same(model, called, thetas[:1], inputs)
        if same and len(thetas) > 1 and not is_dear(time.perf_counter() - started):
            same = _same(model, called, thetas[1:], inputs)
        return same

    formula = model if isinstance(model, FunctionFormula) and len(thetas) > 1 else None
    if agree() if formula is None else formula.agreed(thetas, agree):
        return None
    sys.stderr.write(
        f"miho: {problem.name}: the function gives other values for numbers than for arrays; it is "
        "called with numbers, one configuration at a time\n"
    )
    return replace(problem, model=called, dear=True)


def compared_at(problem: CurveFit) -> Array:
    """The configurations (n, d) of the box at which calls are compared before a search."""
    count = min(CONFIGURATIONS, max(1, VALUES // max(1, len(problem.dataset))))
    return problem.space.decode(problem.space.initial(count))


def check_repeats(
    problem: CurveFit, theta: Array, cost: float, evaluations: Evaluations | None = None
) -> None:
    """Warn of a function whose sum of squares at `theta` (d,) is another one in the next call."""
    if not dear_leaves(problem.model) or _is_final(problem, evaluations):
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
            + "; a model with random numbers or a state of its own has no optimum: reset them in "
            "each call",
            UserWarning,
            stacklevel=5,
        )


def _is_final(problem: CurveFit, evaluations: Evaluations | None) -> bool:
    """Whether evaluations are not to be made again, as a journal has them or they may hang."""
    return (
        evaluations is not None and not evaluations.may_repeat and bool(dear_leaves(problem.model))
    )


def _called(model: Model) -> Model:
    """The model with its functions called with numbers; itself where they are, or it has none."""
    if isinstance(model, FunctionFormula):
        return model.function.by_numbers
    if isinstance(model, FunctionModel):
        automatic = model.batched is None and model.tried.batched
        return replace(model, tried=model.tried._replace(batched=False)) if automatic else model
    if isinstance(model, Tied):
        called = _called(model.model)
        return model if called is model.model else TiedModel(called, model.ties)
    joint = model.joint if isinstance(model, JointExpression) else model
    if isinstance(joint, JointModel):
        parts = tuple(part._replace(model=_called(part.model)) for part in joint.parts)
        pairs = zip(parts, joint.parts, strict=True)
        return model if all(new.model is old.model for new, old in pairs) else JointModel(parts)
    return model


def _same(model: Model, called: Model, thetas: Array, inputs: tuple[Array, ...]) -> bool:
    """Whether two models agree at each of some rows (n, d), where the calls do not raise."""
    try:
        first, second = (each.predict(thetas, *inputs) for each in (model, called))
    except ValueError:
        if len(thetas) > 1:
            return all(_same(model, called, row[None], inputs) for row in thetas)
        return _raises(called, thetas, inputs)
    if np.array_equal(first, second):
        return True
    # Each row is compared on its own scale; what is not finite has no value.
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
