"""When the ends of several descents are evidence enough that the best of them is the optimum.

Methods that make several descents stop by this rule, and a report relies on a result by it. A
descent is that of a start of its own; or, of methods with brackets of successive halving, what a
bracket kept to its last, the best of several starts. Brackets are independent but for the minima
known so far: one that is on its way to such a minimum ends there.

n descents from starts of their own have ended in w different optima. Boender and Rinnooy Kan
(Mathematical Programming 37, 1987) take this for a sample of unknown cells with unknown shares, no
number and no share of which is likelier than another beforehand. The share of starts that lead to
optima in which none of the n has ended is then expected to be w (w + 1) / (n (n - 1)). Where the
order in which optima are met says nothing of their loss, a new one is the best of w + 1 with the
probability 1 / (w + 1); where better ones are met sooner, as is to be hoped, with less. So one more
descent ends in a better optimum with a probability of about w / (n (n - 1)), which has to be small;
and the best optimum must have been come back to, in number and in share of all.

R's gslnls stops, after Hickernell and Yuan (OR Transactions 1, 1997), by a count: more than
r + sqrt(r) NSP starts without an improvement, after NSP improvements (r = 4). It does not ask
where they ended. Eight starts that end in eight places, the first of them in the best, stop it, and
nothing was come back to; here they are not enough. Where all agree, 7 starts are enough here and 8
there. And a share of starts can be told in a report; a count since the last
improvement says less, the earlier that was.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

AGREEING = 1e-4
"""Descents whose losses differ by less than this fraction ended in one optimum: solvers leave far
less (1e-10 is their usual tolerance), and different optima lie further apart."""
ENOUGH, SHARE = 5, 0.25
"""So many descents, and this share of all, end in the best optimum where it is relied on. One that
is as easy to reach, but better, would have been missed by all n with a probability of about
(1 - 5 / n)^n, at most 1 % (of five, which all ended in one of two, 2^-5 = 3 %); and where the best
is rare, a better one that is rarer is likely."""
BETTER = 0.025
"""One more descent is to end in a better optimum with this probability at most."""


@dataclass(frozen=True)
class Agreement:
    """How the ends of `finished` descents agree.

    `best` is the loss of the optimum in question, math.inf if there is none; `agreeing` descents
    ended in it, and all together in `optima` different ones at most. `unseen` is the probability
    that one more ends in an optimum that none has ended in, 1 if nothing is known of it.
    """

    best: float
    agreeing: int
    finished: int
    optima: int
    unseen: float

    @property
    def returned(self) -> bool:
        """Whether descents came back to the optimum often enough."""
        return self.agreeing >= max(ENOUGH, SHARE * self.finished)

    @property
    def enough(self) -> bool:
        """Whether the optimum may be relied on, and a search for a better one may stop."""
        return self.returned and self.better <= BETTER

    @property
    def better(self) -> float:
        """The probability that one more descent ends in an optimum that is better, not seen yet."""
        return self.unseen / (self.optima + 1)


def agreement(
    ends: Sequence[float],
    rounding: float = 0.0,
    *,
    best: float | None = None,
    finished: int | None = None,
    dropped: int = 0,
) -> Agreement:
    """How the losses at which descents ended agree.

    Losses are one optimum where they differ by less than AGREEING of the smaller one, or by less
    than `rounding`, which the problem does not resolve (`Problem.resolution`): without it no two
    descents on data without noise would agree. `best` is the loss of the optimum in question, that
    of the best end unless it is known from elsewhere. `finished` is the number of descents where
    `ends` are only the best of them. `dropped` of them ended where nobody knows their loss, but
    that it is none of the best: each in an optimum of its own, as far as is known.
    """
    finished = len(ends) + dropped if finished is None else finished
    best = min(ends, default=math.inf) if best is None else best
    optima, highest = 0, -math.inf
    for end in sorted(ends):
        if not end <= highest:
            optima, highest = optima + 1, highest_in_optimum(end, rounding)
    optima += dropped
    highest = highest_in_optimum(best, rounding)
    agreeing = len([end for end in ends if end <= highest])
    pairs = finished * (finished - 1)
    unseen = min(1.0, optima * (optima + 1) / pairs) if pairs else 1.0
    return Agreement(best, agreeing, finished, optima, unseen)


def in_optimum(best: float, end: float, rounding: float = 0.0) -> bool:
    """Whether a descent that ended at a loss is in the optimum of a loss that is not larger.

    It is unless its loss is above that by more than solvers leave (AGREEING) and rounding does.
    """
    return bool(end <= highest_in_optimum(best, rounding))


def highest_in_optimum(best: float, rounding: float = 0.0) -> float:
    """The largest loss of a descent that ended in the optimum of this loss."""
    return best + AGREEING * abs(best) + rounding
