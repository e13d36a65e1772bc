"""The evidence that an optimum is the best one, or the reason to doubt it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from miho.optim import Descents

if TYPE_CHECKING:
    from miho.identification.irreducible import Irreducible

BEATEN = 0.1
"""If no curve can have an error lower by more than this fraction, one search is enough evidence,
unless another search ended elsewhere: optima whose errors differ by less may differ in a weak
signal."""
OVERLOOKED = 0.01
"""A recorded optimum counts as missed if the error is larger by more than this fraction."""


@dataclass(frozen=True)
class Conclusion:
    """The evidence for an optimum, the source of the statement in every output.

    Parameters
    ----------
    evidence : str
        What is known of the optimum, without a final full stop.
    doubt : str, optional
        Why a better optimum may exist. Empty if the evidence is sufficient.
    certain : bool, optional
        Whether the evidence does not rest on the agreement of searches, which may all have missed a
        better optimum.
    """

    evidence: str
    doubt: str = ""
    certain: bool = False

    @property
    def statement(self) -> str:
        """One statement for the printed line, the report, its page and `parameters.json`."""
        return f"In doubt: {self.doubt}." if self.doubt else f"Converged: {self.evidence}."


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
        return Conclusion(single, single)
    if not finished:
        unfinished = f"no {all_of.kind()} finished within the budget"
        return Conclusion(unfinished, unfinished)
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
    return Conclusion(doubt, doubt)


def _against_the_best_known(loss: float, best_known: float, rounding: float) -> Conclusion:
    if loss <= best_known * (1 + OVERLOOKED) ** 2 + rounding:
        return Conclusion("the best known optimum is reached", certain=True)
    more = (loss / best_known) ** 0.5 - 1 if best_known > 0 else float("inf")
    doubt = f"the error is {100 * more:.3g} % above the error of the best known optimum"
    return Conclusion(doubt, doubt)


def _stopped_early(count: int) -> str:
    """The number of searches that were given up before they had looked at all rows."""
    if not count:
        return ""
    verb, pronoun = ("was", "it was") if count == 1 else ("were", "they were")
    return f", and {count} {verb} stopped on a part of the rows because {pronoun} no better"
