"""What is known of an optimum: whether the search may have ended in another one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from miho.identification.irreducible import Irreducible
from miho.optim import Descents, agreement

BEATEN = 0.1
"""Where no curve can have an error that is lower by this fraction, one search is relied on, unless
others ended elsewhere: a weak signal is missed by optima whose errors differ by less."""
OVERLOOKED = 0.01
"""A recorded optimum is missed by an error that is larger by more than this fraction."""


@dataclass(frozen=True)
class Standing:
    """How an optimum stands: `evidence` says in a sentence what is known of it.

    `doubt` says why it may not be the best, and is empty where there is enough evidence that it is.
    `certain` if that does not rest on descents that agree, which may all have missed a better one.
    """

    evidence: str
    doubt: str = ""
    certain: bool = False


def kind_of(searches: Sequence[Descents]) -> str:
    """What the descents of searches are: all of them brackets, or not."""
    return "brackets" if searches and all(each.brackets for each in searches) else "descents"


def standing(
    loss: float,
    rounding: float,
    searches: Sequence[Descents],
    *,
    best_known: float | None = None,
    irreducible: Irreducible | None = None,
    error: float = 0.0,
) -> Standing:
    """What is known of an optimum of this loss.

    Losses up to `rounding` are 0; `searches` are the descents of the run, and of a check;
    `best_known` is the loss of the optimum where linear algebra or a record knows it. `error` is
    the root-mean-square error, which no curve undercuts by more than the lower end of the
    `irreducible` one says.
    """
    if best_known is not None:
        if loss <= best_known * (1 + OVERLOOKED) ** 2 + rounding:
            return Standing("the best known optimum is reached", certain=True)
        more = (loss / best_known) ** 0.5 - 1 if best_known > 0 else float("inf")
        doubt = f"the error is {100 * more:.3g} % higher than that of the best known optimum"
        return Standing(doubt, doubt)
    finished = sum(each.finished for each in searches)
    screened = sum(each.screened for each in searches)
    dropped = sum(each.dropped for each in searches)
    kind = kind_of(searches)
    ends = [end for each in searches for end in each.ends]
    agreed = agreement(ends, rounding, best=loss, finished=finished, dropped=dropped)
    here = agreed.agreeing
    verb = "was" if dropped == 1 else "were"
    elsewhere = f", {dropped} {verb} dropped on fewer rows as no better" * bool(dropped)
    ended = f"{here or 'none'} of {finished} {kind} ended here{elsewhere}"
    evidence = ended
    if screened:
        evidence = (
            f"{screened:,} starts screened for {finished} {kind}; {here or 'none'} of them "
            f"ended here{elsewhere}"
        )
    unseen = (
        f"one more would find a better one with a probability of about {100 * agreed.better:.2g} %"
    )
    if agreed.enough:
        return Standing(f"{evidence}, and none found a better one; {unseen}")
    if here == finished and irreducible is not None and error <= irreducible.high:
        below = max(0.0, 1 - irreducible.low / error) if error > 0 else 0.0
        if below <= BEATEN:
            reached = (
                "as neighbouring points scatter, no curve has an error that is more than "
                f"{100 * below:.2g} % lower (95 % interval)"
            )
            return Standing(f"{evidence}; {reached}" if finished else reached, certain=True)
    if not searches:
        once = "one search, and nothing in it tells whether a better optimum exists"
        return Standing(once, once)
    if not finished:
        none = f"no {kind.removesuffix('s')} was finished"
        return Standing(none, f"{none} within the budget")
    if agreed.optima > 1:
        errors = agreed.optima - dropped
        others = f"; they ended at {errors} different errors" * (errors > 1)
        others += f", so that {unseen}" * agreed.returned
        evidence, ended = evidence + others, ended + others
    doubt = f"{ended}, which are too few to rely on" if here == finished else f"only {ended}"
    return Standing(evidence, doubt if here else ended)
