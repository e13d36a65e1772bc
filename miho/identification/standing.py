"""The standing of an optimum: the evidence that it is the best, or why that is in doubt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from miho.identification.irreducible import Irreducible
from miho.optim import Agreement, Descents, agreement

BEATEN = 0.1
"""Where no curve can have an error that is lower by this fraction, one search is enough evidence,
unless another ended elsewhere: optima whose errors differ by less may differ in a weak signal."""
OVERLOOKED = 0.01
"""A recorded optimum is missed by an error that is larger by more than this fraction."""


@dataclass(frozen=True)
class Standing:
    """`evidence`: in a sentence, what is known of an optimum.

    `doubt` says why it may not be the best, and is empty where there is enough evidence that it is.
    `certain` if that does not rest on descents that agree, which may all have missed a better one.
    Everything that is said of an optimum comes from here: the printed line, the report, its page
    and `parameters.json`.
    """

    evidence: str
    doubt: str = ""
    certain: bool = False

    @property
    def statement(self) -> str:
        """One sentence for all outputs: the evidence, or the doubt by name."""
        return f"in doubt: {self.doubt}" if self.doubt else self.evidence


def kind_of(searches: Sequence[Descents]) -> str:
    """What the descents of these searches are called: brackets if all are, else descents."""
    return "brackets" if searches and all(search.brackets for search in searches) else "descents"


def standing(
    loss: float,
    rounding: float,
    searches: Sequence[Descents],
    *,
    best_known: float | None = None,
    irreducible: Irreducible | None = None,
    error: float = 0.0,
) -> Standing:
    """The evidence for an optimum of this loss, or the doubt about it.

    Losses up to `rounding` are 0; `searches` are the descents of the run, and of a check;
    `best_known` is the loss of the optimum where linear algebra or a record knows it. `error` is
    the root-mean-square error, which no curve undercuts by more than the lower end of the
    `irreducible` one says. Where a method did not end by the evidence of its descents, they are
    none: only those of a check may be enough, without them.
    """
    # A known optimum decides alone.
    if best_known is not None:
        if loss <= best_known * (1 + OVERLOOKED) ** 2 + rounding:
            return Standing("the best known optimum is reached", certain=True)
        more = (loss / best_known) ** 0.5 - 1 if best_known > 0 else float("inf")
        doubt = f"the error is {100 * more:.3g} % higher than that of the best known optimum"
        return Standing(doubt, doubt)
    # How many of the descents of all searches ended in this optimum.
    finished = sum(search.finished for search in searches)
    screened = sum(search.screened for search in searches)
    dropped = sum(search.dropped for search in searches)
    kind = kind_of(searches)
    agreed = _agreement(searches, loss, rounding)
    ended_here = agreed.agreeing
    verb = "was" if dropped == 1 else "were"
    drops = f", {dropped} {verb} dropped on fewer rows as no better" * bool(dropped)
    count = f"{ended_here or 'none'} of {finished} {kind} ended here{drops}"
    of_them = f"{ended_here or 'none'} of them ended here{drops}"
    if finished == 1:
        kind, place = kind.removesuffix("s"), "here" if ended_here else "elsewhere"
        count, of_them = (
            f"the only finished {kind} ended {place}{drops}",
            f"it ended {place}{drops}",
        )
    evidence = f"{screened:,} starts screened for {finished} {kind}; {of_them}"
    evidence = evidence if screened else count
    chance = (
        f"one more would find a better one with a probability of about {100 * agreed.better:.2g} %"
    )

    # Enough evidence: descents that agree, or an error that no curve undercuts by much.
    settled = [search for search in searches if search.settled]
    all_settled = len(settled) == len(searches)
    if agreed.enough and (all_settled or _agreement(settled, loss, rounding).enough):
        return Standing(f"{evidence}, and none found a better one; {chance}")
    alike = all_settled and ended_here == finished
    if alike and irreducible is not None and error <= irreducible.high:
        below = max(0.0, 1 - irreducible.low / error) if error > 0 else 0.0
        if below <= BEATEN:
            reached = (
                "as neighbouring points scatter, no curve has an error that is more than "
                f"{100 * below:.2g} % lower (95 % interval)"
            )
            return Standing(f"{evidence}; {reached}" if finished else reached, certain=True)
    # Too little: how many, and where the others ended.
    if not searches:
        single = "one search, and nothing in it tells whether a better optimum exists"
        return Standing(single, single)
    if not finished:
        unfinished = f"no {kind.removesuffix('s')} was finished"
        return Standing(unfinished, f"{unfinished} within the budget")
    if agreed.optima > 1:
        errors = agreed.optima - dropped
        elsewhere = f"; they ended at {errors} different errors" * (errors > 1)
        elsewhere += f", so that {chance}" * agreed.returned
        evidence, count = evidence + elsewhere, count + elsewhere
    doubt = f"only {count}" if 0 < ended_here < finished else count
    if not all_settled:
        unsettled = "; the search ended before that was evidence enough"
        return Standing(evidence + unsettled, doubt + unsettled)
    few = ", and one is" if finished == 1 else ", which are"
    return Standing(evidence, doubt + f"{few} too few to rely on" * (ended_here == finished))


def _agreement(searches: Sequence[Descents], loss: float, rounding: float) -> Agreement:
    """How the ends of all these searches agree on an optimum of this loss."""
    return agreement(
        [end for search in searches for end in search.ends],
        rounding,
        best=loss,
        finished=sum(search.finished for search in searches),
        dropped=sum(search.dropped for search in searches),
    )
