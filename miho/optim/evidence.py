"""Stopping rule: when the ends of several descents are evidence for the global optimum.

Methods with several descents stop by this rule, and a report trusts a result by it. A descent
starts from one point; in methods with brackets of successive halving, it is the last candidate of
a bracket, the best of several starts. Brackets are independent except for the known minima: a
bracket on its way to one of them ends there.

Suppose n descents from separate starts have ended in w different optima. Boender and Rinnooy Kan
[1]_ treat this as a sample from an unknown number of cells with unknown shares, all equally likely
beforehand. The expected share of starts that lead to unseen optima is then w (w + 1) / (n (n - 1)).
If the order in which optima are met does not depend on their loss, a new one is the best of w + 1
with probability 1 / (w + 1); usually better optima are met sooner, and the probability is smaller.
So one more descent ends in a better optimum with a probability of about w / (n (n - 1)), which must
be small. In addition, descents must have returned to the best optimum, in number and as a share.

References
----------
.. [1] C. G. E. Boender, A. H. G. Rinnooy Kan, "Bayesian stopping rules for multistart global
   optimization methods", Mathematical Programming 37 (1987) 59-80.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass

EPSILON = sys.float_info.epsilon
AGREEING = 1e-4
"""Descents whose losses differ by less than this fraction ended in one optimum. Solvers leave far
smaller differences (their usual tolerance is 1e-10), and different optima differ by more."""
ENOUGH, SHARE, MANY = 5, 0.25, 20
"""At least ENOUGH descents, and the share SHARE of all or MANY, must end in a trusted optimum. A
better optimum that is equally easy to reach would have been missed by all n with a probability of
about (1 - 5 / n)^n, at most 1 % (with five descents that all ended in one of two optima, 2^-5 = 3
%). If the best optimum is rare, a better and rarer one is likely. After 20 returns to it, one that
is only a fifth as easy to reach would have been missed with a probability of exp(-20 / 5) = 2 %."""
BETTER = 0.025
"""Largest acceptable probability that one more descent ends in a better optimum."""


@dataclass(frozen=True)
class Agreement:
    """Agreement of the ends of `finished` descents on an optimum.

    Attributes
    ----------
    agreeing : int
        Descents that ended in the optimum.
    finished : int
        All descents that ended.
    optima : int
        Largest possible number of different optima among their ends.
    unseen : float
        Probability that one more descent ends in an unseen optimum; 1 if unknown.
    """

    agreeing: int
    finished: int
    optima: int
    unseen: float

    @property
    def returned(self) -> bool:
        """Whether enough descents returned to the optimum."""
        return self.agreeing >= min(max(ENOUGH, SHARE * self.finished), MANY)

    @property
    def enough(self) -> bool:
        """Whether the optimum can be trusted, so that a search may stop."""
        return self.returned and self.better <= BETTER

    @property
    def better(self) -> float:
        """Probability that one more descent ends in a better, unseen optimum."""
        return self.unseen / (self.optima + 1)


def agreement(
    ends: Sequence[float],
    rounding: float = 0.0,
    *,
    best: float | None = None,
    finished: int | None = None,
    dropped: int = 0,
) -> Agreement:
    """Agreement of the losses at which descents ended.

    Two losses belong to one optimum if they differ by less than AGREEING of the smaller one, or by
    less than `rounding`. Without `rounding`, descents on data without noise would never agree.

    Parameters
    ----------
    ends : sequence of float
        Losses at the ends of descents.
    rounding : float, optional
        Difference that the problem does not resolve (`Problem.resolution`).
    best : float, optional
        Loss of the optimum in question; by default the best end.
    finished : int, optional
        Number of descents, if `ends` has the best of them only.
    dropped : int, optional
        Further descents that ended at unknown losses, none of them the best; each counts as a
        different optimum.

    Returns
    -------
    Agreement
        The agreement on `best`.

    Examples
    --------
    >>> from miho.optim import agreement
    >>> seen = agreement([1.0] * 7)
    >>> seen.enough, round(seen.better, 3)
    (True, 0.024)
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
    return Agreement(agreeing, finished, optima, unseen)


def in_optimum(best: float, end: float, rounding: float = 0.0) -> bool:
    """Whether a descent ended in the optimum of a loss.

    Parameters
    ----------
    best : float
        Loss of the optimum.
    end : float
        Loss at the end of the descent, at least as large.
    rounding : float, optional
        Difference that the problem does not resolve (`Problem.resolution`).

    Returns
    -------
    bool
        Whether `end` exceeds `best` by at most 1e-4 of its size, the tolerance of solvers, plus
        `rounding`.

    Examples
    --------
    >>> from miho.optim import in_optimum
    >>> in_optimum(2.0, 2.0001), in_optimum(2.0, 2.1)
    (True, False)
    """
    return bool(end <= highest_in_optimum(best, rounding))


def highest_in_optimum(best: float, rounding: float = 0.0) -> float:
    """Largest loss of a descent that ended in the optimum of this loss."""
    return best + AGREEING * abs(best) + rounding


def is_rounding(loss: float, rounding: float, resolution: float) -> bool:
    """Whether a loss is zero by the `rounding` of a problem, which is below its `resolution`.

    An error that counts as zero is then below 1.5e-8 (the root of EPSILON) of the standard
    deviation of the data, because `resolution` is EPSILON of their variance.
    """
    return loss == 0 or loss <= rounding < resolution
