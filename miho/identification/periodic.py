"""Angles of the sines in a formula, from which a search learns that the model has a period.

The loss of such a model has an optimum for nearly every period, because a curve that is out of
phase fits no better than none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from weakref import WeakKeyDictionary

import numpy as np

from miho.compiled.kernel import Formula
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

PERIODIC = ("sin", "cos", "tan")
BOUNDED = (*PERIODIC, "arcsin", "arccos", "arctan", "arctan2", "tanh", "sign", *CONDITION)
"""Operations whose results stay within a range, however large an input is."""
FORMULAS: WeakKeyDictionary[Formula, Formula | None] = WeakKeyDictionary()
"""Angles of formulas, None without, cached per process for many fits of one function."""
ROWS = 100
"""Largest number of rows at which angles are compared."""


def angles(problem: CurveFit, thetas: Array) -> Array:
    """Ends of the range of each angle over the rows, in periods, at `thetas` (n, d), (k, 2, n).

    The k angles are of sines, cosines and tangents that follow an input without bound: the sine of
    an arctangent in the Magic Formula has no period. k is 0 for a model that is no formula. The
    model is not evaluated.
    """
    ends = [
        np.broadcast_to([angle.min(axis=-1), angle.max(axis=-1)], (2, len(thetas)))
        for model, columns, values in _parts(problem, thetas)
        if isinstance(model, Expression)
        for angle in _angles(model, columns, values)
    ]
    return np.reshape(ends, (-1, 2, len(thetas))) / (2 * np.pi)


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


def _angles(model: Expression, columns: Sequence[Array], thetas: Array) -> list[Array]:
    """Angles of a formula at parameters (n, d), (n, m) or (1, m) each, on m of the rows."""
    value = model.value
    if value not in FORMULAS:
        FORMULAS[value] = _formula_of_angles(value, len(columns), thetas.shape[1])
    angles = FORMULAS[value]
    if angles is None:
        return []
    count = columns[0].size
    rows = np.linspace(0, count - 1, min(count, ROWS)).astype(int)
    with np.errstate(all="ignore"):
        at = angles(tuple(column[rows] for column in columns), tuple(thetas.T[:, :, None]))
    return [np.atleast_2d(angle) for angle in at]


def _formula_of_angles(value: Formula, inputs: int, parameters: int) -> Formula | None:
    """Function of the angles of a formula, None if it has none or cannot be traced."""
    x = [argument(f"x{k}") for k in range(inputs)]
    p = [argument(f"p{k}") for k in range(parameters)]
    try:
        graph = trace(value, tuple(x), tuple(p))
    except NotAFormulaError:
        return None
    sines = [symbol for symbol in ordered([graph]) if symbol.operation in PERIODIC]
    angles = [sine.arguments[0] for sine in sines if _unbounded(sine.arguments[0], x)]
    if not angles:
        return None
    names = {"inputs": [s.arguments[0] for s in x], "theta": [s.arguments[0] for s in p]}
    return written("angles", names, angles, single=False)


def _unbounded(angle: Symbol, inputs: list[Symbol]) -> bool:
    """Whether an angle depends on an input other than through a bounded operation."""
    symbols = ordered([angle], ends=(ARGUMENT, CONSTANT, *BOUNDED))
    return not set(inputs).isdisjoint(symbols)
