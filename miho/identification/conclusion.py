"""The evidence that an optimum is the best one, or the reason to doubt it.

Knowledge of the problem decides first: a linear model, residuals of zero, a recorded optimum. Then
the descents of the search count, and the scatter of the data if they do not suffice.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from miho.identification.curve_fit import CurveFit
from miho.identification.flags import lost_effect
from miho.identification.irreducible import Irreducible, irreducible_of
from miho.identification.line_wrapping import with_unit
from miho.identification.uncertainty import Linearised, linearised
from miho.optim import Descents, in_optimum
from miho.optim.evidence import is_rounding
from miho.optim.linear_part import solve_linear_part
from miho.optim.zero import is_zero
from miho.quantities import Array

BEATEN = 0.1
"""If no curve can have an error lower by more than this fraction, one search is enough evidence,
unless another search ended elsewhere: optima whose errors differ by less may differ in a weak
signal."""
OVERLOOKED = 0.01
"""A recorded optimum counts as missed if the error is larger by more than this fraction."""
LINEAR = 1e-9
"""Relative accuracy of the optimal loss of a linear problem."""
PROFILE, BOOTSTRAP, CHECK = "a profile", "the bootstrap", "a check"
"""The steps after a search that may find a better optimum."""
TRIALS = 10
"""Number of trial configurations for a parameter without an effect."""


@dataclass(frozen=True)
class Conclusion:
    """The evidence for an optimum, the source of the statement in every output.

    Parameters
    ----------
    evidence : str
        What is known of the optimum, without a final full stop. Empty for an optimum in doubt.
    doubt : str
        Why a better optimum may exist. Empty if the evidence is sufficient.
    certain : bool, optional
        Whether the evidence does not rest on the agreement of searches, which may all have missed a
        better optimum.
    """

    evidence: str = ""
    doubt: str = ""
    certain: bool = False

    @property
    def statement(self) -> str:
        """One statement for the printed line, the report, its page and `parameters.json`."""
        return f"In doubt: {self.doubt}." if self.doubt else f"Converged: {self.evidence}."


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
        unit of the output. None if the problem is not linear in all its parameters, or if the model
        has no value at an end of a range.
    """
    space = problem.space
    if set(problem.linear) != set(space.names):
        return None
    start = (space.low + space.high) / 2
    try:
        optimum = solve_linear_part(problem.residuals, start, range(len(space)), space)
    except ValueError:  # as when it is not finite
        return None
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
        conclusion = Conclusion(doubt=missed)
    else:
        conclusion = _by_descents(problem, theta, loss, searches)
        if not in_optimum(loss, before, rounding):
            step = found_by or "a descent from the run's result"
            lowered = with_unit(f"{step} lowered the error {_step(before, loss)}", problem.unit)
            if conclusion.doubt:
                conclusion = Conclusion(doubt=f"{conclusion.doubt}; {lowered}")
            else:
                conclusion = replace(conclusion, evidence=f"{conclusion.evidence}; {lowered}")
    objection = ""
    if moving and exact is None:
        objection = (
            f"a descent from this point had not ended after {moving:,} evaluation"
            f"{'s' * (moving > 1)}, so it may not be an optimum yet, and standard errors and "
            "intervals may not hold"
        )
    elif at is not None and at.unidentifiable.any():
        objection = lost_effect(at, problem.space, _never_identifiable(problem))
    if objection:
        return Conclusion(doubt="; ".join(filter(None, [conclusion.doubt, objection])))
    return conclusion


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


def conclusion_from(
    loss: float,
    rounding: float,
    searches: Sequence[Descents],
    *,
    best_known: float | None = None,
    irreducible: Irreducible | None = None,
    error: float = 0.0,
) -> Conclusion:
    """The evidence for an optimum, or the doubt about it.

    Parameters
    ----------
    loss : float
        Loss of the optimum.
    rounding : float
        Losses up to this one count as 0.
    searches : sequence of Descents
        The descents of the run, and of a check of the run.
    best_known : float, optional
        Loss of the best optimum that linear algebra or a record knows. It decides alone.
    irreducible : Irreducible, optional
        The error that the scatter of neighbouring points leaves to any curve.
    error : float
        Root-mean-square error of the optimum, compared with the lower end of `irreducible`.

    If a search ended for another reason than its evidence, only the descents of a check can remove
    the doubt.
    """
    if best_known is not None:
        return _against_the_best_known(loss, best_known, rounding)
    all_of = Descents.together(searches)
    finished, dropped, screened = all_of.finished, all_of.dropped, all_of.screened
    agreed = all_of.agreement(loss, rounding)
    agreeing = agreed.agreeing
    starts = f" ({screened:,} starting points screened)" * bool(screened)
    counted = f"{finished} {all_of.kind(finished)}"
    count = f"{agreeing or 'none'} of {counted}{starts} found this optimum{_stopped_early(dropped)}"
    chance = f"chance that another search finds a better one: {100 * agreed.better:.2g} %"

    # Sufficient evidence: searches that agree, or an error that no curve can improve much.
    settled = Descents.together(search for search in searches if search.settled)
    if agreed.enough and settled.agreement(loss, rounding).enough:
        return Conclusion(f"{count}. Estimated {chance}")
    alike = all_of.settled and agreeing == finished
    if alike and irreducible is not None and error <= irreducible.high:
        below = max(0.0, 1 - irreducible.low / error) if error > 0 else 0.0
        if below <= BEATEN:
            least = (
                f"no curve has an error more than {100 * below:.2g} % lower, judged by the scatter "
                "of neighbouring points (95 % interval)"
            )
            return Conclusion(f"{count}; {least}" if finished else least, certain=True)

    # Insufficient evidence: how many searches agreed, and where the others ended.
    if not searches:
        single = "a single search cannot show whether a better optimum exists"
        return Conclusion(doubt=single)
    if not finished:
        unfinished = f"no {all_of.kind()} finished within the budget"
        return Conclusion(doubt=unfinished)
    if finished == 1:
        place = "found this optimum" if agreeing else "ended elsewhere"
        count = f"the only finished {all_of.kind()}{starts} {place}{_stopped_early(dropped)}"
    doubt = f"only {count}" if 0 < agreeing < finished else count
    if agreed.optima > 1:
        errors = agreed.optima - dropped
        doubt += f"; they ended at {errors} different errors" * (errors > 1)
        doubt += f"; estimated {chance}" * (agreed.returned and not agreed.enough)
    if not all_of.settled:
        doubt += "; the search ended before the evidence was sufficient"
    elif agreeing == finished:
        doubt += ", and one is too few" if finished == 1 else f", and {finished} are too few"
    return Conclusion(doubt=doubt)


def _against_the_best_known(loss: float, best_known: float, rounding: float) -> Conclusion:
    if loss <= best_known * (1 + OVERLOOKED) ** 2 + rounding:
        return Conclusion("the best known optimum is reached", certain=True)
    more = (loss / best_known) ** 0.5 - 1 if best_known > 0 else float("inf")
    doubt = f"the error is {100 * more:.3g} % above the error of the best known optimum"
    return Conclusion(doubt=doubt)


def _stopped_early(count: int) -> str:
    """The number of searches that were given up before they had looked at all rows."""
    if not count:
        return ""
    verb, pronoun = ("was", "it was") if count == 1 else ("were", "they were")
    return f", and {count} {verb} stopped on a part of the rows because {pronoun} no better"
