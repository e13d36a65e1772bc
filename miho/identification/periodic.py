"""Models with an unknown period, on which more claims of convergence are wrong.

The loss of such a model has an optimum for nearly every period, because a curve that is out of
phase fits no better than none. Searches then agree on a wrong optimum more often.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from miho.identification.curve_fit import CurveFit
from miho.models.expression import Expression
from miho.models.formula_text import written
from miho.models.model import Model
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

WITH_PERIOD, WITHOUT_PERIOD = 1.5, 0.5
"""Wrong claims of `miho_gn` (%), of 619 on models with a period and of 1,484 on others, in the
least favourable of the measurements in `docs/evidence.md`
(`python -m experiments.check.false_ends --instances 50`, `--draw 0` and `--draw 1`)."""
REMARK = (
    f"The model has an unknown period. On test problems with one, {WITH_PERIOD:g} % of such claims "
    f"of the default method were wrong, on others {WITHOUT_PERIOD:g} %"
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
    arctangent in the Magic Formula has no period. The result is False for
    a model that is no formula.
    """
    space = problem.space
    thetas = space.decode(space.initial(STARTS))
    ends = np.repeat(thetas[:1], 2 * len(space), axis=0)  # with one parameter at an end
    np.fill_diagonal(ends[: len(space)], space.low)
    np.fill_diagonal(ends[len(space) :], space.high)
    return any(
        isinstance(model, Expression) and _has_a_period(model, columns, values)
        for model, columns, values in _parts(problem, np.concatenate([thetas, ends]))
    )


def _parts(problem: CurveFit, thetas: Array) -> Iterator[tuple[Model, Sequence[Array], Array]]:
    """Each model of a joint one with its columns and its parameters (n, d) at `thetas` (n, f)."""
    model = problem.model
    if isinstance(model, Expression):
        yield model, problem.inputs, thetas
        return
    from miho.models.joint import JointModel
    from miho.models.tied import Tied

    if isinstance(model, Tied):
        thetas, model = model.ties.whole(thetas), model.whole
    if isinstance(model, JointModel):
        for part, _, chosen, columns in model.shares(problem.inputs):
            yield part.model, columns, thetas[:, chosen]


def _has_a_period(model: Expression, columns: Sequence[Array], thetas: Array) -> bool:
    """Whether an angle of a formula differs by over a period between parameters (n, d)."""
    inputs = [argument(f"x{k}") for k in range(len(columns))]
    parameters = [argument(f"p{k}") for k in range(thetas.shape[1])]
    try:
        graph = trace(model.value, tuple(inputs), tuple(parameters))
    except NotAFormulaError:
        return False
    sines = [symbol for symbol in ordered([graph]) if symbol.operation in PERIODIC]
    angles = [sine.arguments[0] for sine in sines if _unbounded(sine.arguments[0], inputs)]
    if not angles:
        return False
    names = {
        "inputs": [column.arguments[0] for column in inputs],
        "theta": [parameter.arguments[0] for parameter in parameters],
    }
    values = written("angles", names, angles, single=False)
    count = columns[0].size
    rows = np.linspace(0, count - 1, min(count, ROWS)).astype(int)
    with np.errstate(all="ignore"):
        at = values([column[rows] for column in columns], tuple(thetas.T[:, :, None]))
        return any(_differ(np.ptp(angle, axis=-1)) for angle in at)


def _unbounded(angle: Symbol, inputs: list[Symbol]) -> bool:
    """Whether an angle depends on an input other than through a bounded operation."""
    symbols = ordered([angle], ends=(ARGUMENT, CONSTANT, *BOUNDED))
    return not set(inputs).isdisjoint(symbols)


def _differ(ranges: Array) -> bool:
    """Whether ranges (n,) of an angle, in rad, differ by more than a period."""
    finite = ranges[np.isfinite(ranges)]
    return finite.size > 0 and bool(np.ptp(finite) > 2 * np.pi)
