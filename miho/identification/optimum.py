"""The statement on an optimum of a problem, which all outputs share."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from miho.identification.conclusion import Conclusion, conclusion_from
from miho.identification.curve_fit import CurveFit
from miho.identification.flags import lost_effect
from miho.identification.irreducible import irreducible_of
from miho.identification.line_wrapping import with_unit
from miho.identification.periodic import REMARK, searches_period
from miho.identification.uncertainty import Linearised, linearised
from miho.optim import Descents, in_optimum
from miho.optim.evidence import is_rounding
from miho.optim.linear_part import solve_linear_part
from miho.optim.zero import is_zero
from miho.quantities import Array

LINEAR = 1e-9
"""Relative accuracy of the optimal loss of a linear problem."""
PROFILE, BOOTSTRAP, CHECK = "a profile", "the bootstrap", "a check"
"""The steps after a search that may find a better optimum."""
TRIALS = 10
"""Number of trial configurations for a parameter without an effect."""


def linear_optimum(problem: CurveFit) -> tuple[Array, float] | None:
    """Solve a problem that is linear in all its parameters.

    Ordinary least squares gives the optimum, or bounded-variable least squares if the box does not
    contain it.

    Parameters
    ----------
    problem : CurveFit
        The problem.

    Returns
    -------
    tuple of (ndarray of shape (d,), float), or None
        The global optimum in the box, in the units of the parameters, and its loss, in the squared
        unit of the output. None if the problem is not linear in all its parameters.
    """
    space = problem.space
    if set(problem.linear) != set(space.names):
        return None
    start = (space.low + space.high) / 2
    optimum = solve_linear_part(problem.residuals, start, range(len(space)), space)
    if optimum is None:
        return None
    return optimum.theta, float(problem.loss(optimum.theta[None])[0])


def conclusion_on(
    problem: CurveFit,
    theta: Array,
    run: Array,
    searches: Sequence[Descents],
    *,
    at: Linearised | None = None,
    moving: int = 0,
    found_by: str = "",
    best_known: float | None = None,
) -> Conclusion:
    """The conclusion on an optimum.

    Parameters
    ----------
    problem : CurveFit
        The problem that was searched.
    theta : ndarray of shape (d,)
        The optimum.
    run : ndarray of shape (d,)
        The result of the search; a descent from it led to `theta`.
    searches : sequence of Descents
        The descents of the run, and of a check of the run.
    at : Linearised, optional
        The uncertainty. With it, a parameter that lost its effect is noticed.
    moving : int
        Evaluations after which the descent from `run` was still improving; 0 if it converged.
    found_by : str
        The step after the search that found this optimum, if the search had found a worse one. A
        profile and the bootstrap are not searches: if one of them found the optimum, all descents
        have missed it, and may have missed others.
    best_known : float, optional
        Loss of a recorded optimum.
    """
    loss, rounding = float(problem.loss(theta[None])[0]), problem.resolution
    before = loss if np.array_equal(run, theta) else float(problem.loss(run[None])[0])
    # Knowledge of the problem decides alone.
    exact = linear_optimum(problem)
    if exact is not None:
        if loss <= exact[1] * (1 + LINEAR) + rounding:
            linear = "the model is linear in all parameters, so no other optimum is better"
            return Conclusion(linear, certain=True)
        best_known = exact[1]
    if _is_zero(problem, theta, loss):
        zero = "the residuals are zero to rounding in this box, so no other optimum is better"
        return Conclusion(zero, certain=True)
    if best_known is not None:
        conclusion = conclusion_from(loss, rounding, searches, best_known=best_known)
    elif found_by in (PROFILE, BOOTSTRAP):
        missed = f"{found_by} found this optimum after {_missed(before, searches, problem.unit)}"
        conclusion = Conclusion(missed, missed)
    else:
        conclusion = _by_descents(problem, theta, loss, searches)
        if not in_optimum(loss, before, rounding):
            step = found_by or "a descent from the run's result"
            lowered = with_unit(f"{step} lowered the error {_step(before, loss)}", problem.unit)
            doubt = f"{conclusion.doubt}; {lowered}" if conclusion.doubt else ""
            conclusion = Conclusion(f"{conclusion.evidence}; {lowered}", doubt, conclusion.certain)
    objections = []
    if moving and exact is None:
        objections.append(
            f"a descent from this point was still improving after {moving:,} evaluations, so it is "
            "not yet an optimum, and standard errors and intervals do not hold"
        )
    elif at is not None and at.unidentifiable.any():
        objections.append(lost_effect(at, problem.space, _never_identifiable(problem)))
    conclusion = _with(conclusion, *filter(None, objections))
    if conclusion.doubt or conclusion.certain or not searches_period(problem):
        return conclusion
    return Conclusion(f"{conclusion.evidence}. {REMARK}")


def _is_zero(problem: CurveFit, theta: Array, loss: float) -> bool:
    """Whether the loss at `theta` (d,) is zero to rounding."""
    if problem.rounding > 0 or loss == 0:
        return is_rounding(loss, problem.rounding, problem.resolution)
    try:
        residuals, derivatives = problem.residuals(theta), problem.jacobian(theta)
    except ValueError:
        return False
    logarithmic = np.array([p.scale == "log" for p in problem.space.parameters])
    derivatives = derivatives * np.where(logarithmic, theta, 1.0)
    return is_zero(residuals, derivatives, problem.space.encode(theta), problem.space)


def _with(conclusion: Conclusion, *objections: str) -> Conclusion:
    """A conclusion with further reasons to doubt the optimum."""
    if not objections:
        return conclusion
    doubt = "; ".join(filter(None, [conclusion.doubt, *objections]))
    evidence = "; ".join([conclusion.evidence, *objections]) if conclusion.doubt else doubt
    return Conclusion(evidence, doubt)


def _by_descents(
    problem: CurveFit, theta: Array, loss: float, searches: Sequence[Descents]
) -> Conclusion:
    """The conclusion from the descents and, if they do not suffice, by the scatter of the data."""
    conclusion = conclusion_from(loss, problem.resolution, searches)
    if not conclusion.doubt:
        return conclusion
    error = float(np.sqrt(np.mean(problem.errors(theta) ** 2)))
    least = irreducible_of(problem)
    return conclusion_from(loss, problem.resolution, searches, irreducible=least, error=error)


def _missed(before: float, searches: Sequence[Descents], unit: str) -> str:
    """A clause on the final errors of the search, whose result has the loss `before`."""
    search = Descents.together(searches)
    error = with_unit(f"{math.sqrt(min(search.ends, default=before)):.5g}", unit)
    if not search.ends:
        return f"the search had ended at an error of {error}"
    kind = search.kind(search.finished)
    if search.finished == 1:
        return f"one {kind} had ended at an error of {error}"
    return f"{search.finished:,} {kind} had ended, the best of them at an error of {error}"


def _step(before: float, after: float) -> str:
    """The errors of two losses, with enough digits to differ."""
    first, last = math.sqrt(before), math.sqrt(after)
    digits = 3
    while digits < 12 and f"{first:.{digits}g}" == f"{last:.{digits}g}":
        digits += 1
    return f"from {first:.{digits}g} to {last:.{digits}g}"


def _never_identifiable(problem: CurveFit) -> NDArray[np.bool_]:
    """Marks (d,) of parameters that are unidentifiable at all of TRIALS configurations in the box.

    The rank of the derivatives is the same almost everywhere for a smooth model, so these inputs
    cannot identify such a parameter.
    """
    never = np.ones(len(problem.space), dtype=bool)
    for theta in problem.space.decode(problem.space.initial(TRIALS)):
        with contextlib.suppress(ValueError):
            never &= linearised(problem, theta).unidentifiable
    return never
