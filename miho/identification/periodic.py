"""Models with a period that is searched, on which more claims of convergence are wrong.

The loss of such a model has an optimum for nearly every period, because a curve that is out of
phase fits no better than none. Searches then agree on a wrong optimum more often.
"""

from __future__ import annotations

import numpy as np

from miho.identification.curve_fit import CurveFit
from miho.models.expression import Expression
from miho.models.formula_text import written
from miho.models.symbolic import (
    ARGUMENT,
    CONDITION,
    CONSTANT,
    NotAFormulaError,
    Symbol,
    argument,
    ordered,
    trace,
)
from miho.quantities import Array

WITH_PERIOD, WITHOUT_PERIOD = 1.5, 0.6
"""Wrong claims of `miho_gn` (%), of 393 on models with a period and of 1,458 on others
(`python -m experiments.check.false_ends --instances 50`, `--draw 0` and `--draw 1`)."""
REMARK = (
    f"The model has a period that is searched: on such test problems {WITH_PERIOD:g} % of the "
    f"default method's claims were wrong, on others {WITHOUT_PERIOD:g} %"
)
PERIODIC = ("sin", "cos", "tan")
BOUNDED = (*PERIODIC, "arcsin", "arccos", "arctan", "arctan2", "tanh", "sign", *CONDITION)
"""Operations whose results stay within a range, however large an input is."""
STARTS, ROWS = 10, 1000
"""Configurations drawn in the box, and largest number of rows, at which angles are compared."""


def searches_period(problem: CurveFit) -> bool:
    """Whether the model is a formula with a period that depends on free parameters.

    This is the case if the angle of a sine, cosine or tangent follows an input without bound, and
    passes through one period more at one place of the box than at another. The sine of an
    arctangent in the Magic Formula has no period.

    Parameters
    ----------
    problem : CurveFit
        The problem.

    Returns
    -------
    bool
        False also for a model that is no formula, of which this is unknown.
    """
    model = problem.model
    if not isinstance(model, Expression):
        return False
    columns = [argument(f"x{k}") for k in range(len(model.inputs))]
    parameters = [argument(f"p{k}") for k in range(len(model.parameters))]
    try:
        graph = trace(model.value, tuple(columns), tuple(parameters))
    except NotAFormulaError:
        return False
    sines = [symbol for symbol in ordered([graph]) if symbol.operation in PERIODIC]
    angles = [sine.arguments[0] for sine in sines if _follows(sine.arguments[0], columns)]
    return any(map(_differ, _ranges(problem, angles, columns, parameters))) if angles else False


def _ranges(
    problem: CurveFit, angles: list[Symbol], columns: list[Symbol], parameters: list[Symbol]
) -> list[Array]:
    """Ranges (n,) of each angle over the rows, in rad, at n configurations in the box."""
    names = {
        "inputs": [column.arguments[0] for column in columns],
        "theta": [parameter.arguments[0] for parameter in parameters],
    }
    values = written("angles", names, angles, single=False)
    count = len(problem.dataset)
    rows = np.linspace(0, count - 1, min(count, ROWS)).astype(int)
    space = problem.space
    thetas = space.decode(space.initial(STARTS))
    one = np.repeat(thetas[:1], 2 * len(space), axis=0)  # one parameter at an end, for each end
    np.fill_diagonal(one[: len(space)], space.low)
    np.fill_diagonal(one[len(space) :], space.high)
    thetas = np.concatenate([thetas, one])
    with np.errstate(all="ignore"):
        at = values([column[rows] for column in problem.inputs], tuple(thetas.T[:, :, None]))
        return [np.broadcast_to(np.ptp(angle, axis=-1), len(thetas)) for angle in at]


def _follows(angle: Symbol, columns: list[Symbol]) -> bool:
    """Whether an angle depends on an input other than through a bounded operation."""
    unbounded = ordered([angle], ends=(ARGUMENT, CONSTANT, *BOUNDED))
    return not set(columns).isdisjoint(unbounded)


def _differ(ranges: Array) -> bool:
    """Whether ranges (n,) of an angle, in rad, differ by more than a period."""
    finite = ranges[np.isfinite(ranges)]
    return finite.size > 0 and bool(np.ptp(finite) > 2 * np.pi)
