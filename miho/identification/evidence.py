"""What is known of an optimum: whether the search may have ended in another one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from miho.identification.irreducible import Irreducible
from miho.optim import Descents

AGREEING = 1e-4
"""Descents whose losses differ by less than this fraction ended in one optimum: solvers leave far
less (1e-10 is their usual tolerance), and different optima lie further apart."""
NOTHING = 1e-16
"""A loss below this fraction of the output's mean square is 0: its digits are rounding."""
ENOUGH = 5
"""So many descents end in the best optimum where it is relied on. An optimum as easy to reach, but
better, would have been missed by all n descents with a probability of (1 - 5 / n)^n, at most 1 %;
with 2 descents it is 14 %."""
UNSEEN = 0.1
"""Of the starts, at most this share may belong to optima that no descent has ended in."""
RESOLVED = 0.5
"""An irreducible error whose interval reaches below this fraction of it is not known."""
OVERLOOKED = 0.01
"""A recorded optimum is missed by an error that is larger by more than this fraction."""


@dataclass(frozen=True)
class Standing:
    """How an optimum stands: `evidence` says in a sentence what is known of it.

    `doubt` says why it may not be the best, and is empty where there is enough evidence that it is.
    """

    evidence: str
    doubt: str = ""


def standing(
    loss: float,
    size: float,
    searches: Sequence[Descents | None],
    *,
    best_known: float | None = None,
    irreducible: Irreducible | None = None,
    error: float = 0.0,
) -> Standing:
    """What is known of an optimum of this loss.

    `size` is the mean square of the output; `searches` are the descents of the run, and of a check;
    `best_known` is the loss of the optimum where linear algebra or a record knows it. `error` is
    the root-mean-square error, which no curve undercuts by much if it is within the interval of the
    `irreducible` one.
    """
    nothing = NOTHING * size
    if best_known is not None:
        if loss <= best_known * (1 + OVERLOOKED) ** 2 + nothing:
            return Standing("the best known optimum is reached")
        more = (loss / best_known) ** 0.5 - 1 if best_known > 0 else float("inf")
        doubt = f"the error is {100 * more:.3g} % higher than that of the best known optimum"
        return Standing(doubt, doubt)
    descents = [each for each in searches if each is not None]
    finished = sum(each.finished for each in descents)
    here = sum(end <= loss * (1 + AGREEING) + nothing for each in descents for end in each.ends)
    ended = f"{here} of {finished} descents ended here"
    reliable = False
    if finished:
        optima = _distinct([end for each in descents for end in each.ends], nothing)
        unseen = optima * (optima + 1) / (finished * (finished - 1)) if finished > 1 else 1.0
        reliable = here >= ENOUGH and unseen <= UNSEEN
    if reliable:
        return Standing(f"{ended}, each from a start of its own")
    if irreducible is not None and _within(error, irreducible):
        reached = "the error is within the interval of the irreducible error, which no curve beats"
        return Standing(f"{ended}; {reached}" if finished else reached)
    if not descents:
        once = "one search, and nothing in it tells whether a better optimum exists"
        return Standing(once, once)
    if not finished:
        return Standing("no descent was finished", "no descent was finished within the budget")
    others = f", in {optima} different optima" if optima > 1 else ""
    doubt = f"only {ended}{others}" if here < finished else f"{ended}, which are too few"
    return Standing(ended + others, doubt)


def _distinct(ends: Sequence[float], nothing: float) -> int:
    """How many different optima these losses are of."""
    count, last = 0, -1.0
    for end in sorted(ends):
        if count == 0 or end > last * (1 + AGREEING) + nothing:
            count += 1
            last = end
    return count


def _within(error: float, irreducible: Irreducible) -> bool:
    """Whether no curve is much better, as far as an estimate that is known well tells."""
    return irreducible.low >= RESOLVED * irreducible.value and error <= irreducible.high
