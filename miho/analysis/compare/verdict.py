"""Rules that decide whether a measured interval supports a printed figure.

A printed figure stands for all values that round to it: 13x means 12.5 to 13.5. The rules are tried
in order, and the first that applies decides. Both outcomes need the same evidence: an interval that
allows only one of them, from runs that a larger budget would not change.
"""

from __future__ import annotations

from dataclasses import dataclass

from miho.analysis.compare.bootstrap import Interval

REPRODUCED = "reproduced"
NOT_REPRODUCED = "not reproduced"
ON_REPETITIONS = "depends on the repetitions"
ON_BUDGET = "depends on the budget"
ON_DATA = "depends on the data"
NOT_JUDGED = "not judged"

LEAST_REPETITIONS = 3
WIDEST_LEVEL = 0.2
TAIL = 0.025


@dataclass(frozen=True)
class Verdict:
    """A verdict and the reason in a clause.

    `word` is reproduced, not reproduced, depends on ..., or not judged with the deviating size.
    """

    word: str
    reason: str


@dataclass(frozen=True)
class Printed:
    """A figure of the paper and half a unit of its last printed digit."""

    value: float
    half_digit: float

    @property
    def low(self) -> float:
        """The smallest value that rounds to the figure."""
        return self.value - self.half_digit

    @property
    def high(self) -> float:
        """The largest value that rounds to the figure."""
        return self.value + self.half_digit


def of_advantage(
    measured: Interval,
    paper: Printed,
    repetitions: int,
    *,
    no_advantage: float,
    miho_falling: bool = False,
    rival_falling: bool = False,
) -> Verdict:
    """Verdict on "at least this much better": a speed-up (no_advantage 1) or a relative gain (0).

    1. Fewer than three repetitions: depends on the repetitions.
    2. The whole interval is below the figure: not reproduced; but depends on the budget if MIHO was
    cut while its error still fell.
    3. The whole interval is at or above it: reproduced; but depends on the budget if the rival was
    cut while its error still fell.
    4. The interval contains the figure, but more than 2.5 % of the resamples are only known within
    bounds, because runs were cut before the target: depends on the budget.
    5. It contains both the figure and no advantage: depends on the repetitions.
    6. It contains the figure: reproduced; or depends on the budget as in 3.
    """
    if repetitions < LEAST_REPETITIONS:
        return _too_few(repetitions)
    if measured.high < paper.low:
        if miho_falling:
            return Verdict(ON_BUDGET, "below the paper, but MIHO was cut while its error fell")
        return Verdict(NOT_REPRODUCED, "the whole interval is below the paper's figure")
    if measured.low < paper.low:
        if measured.censored > TAIL:
            return Verdict(ON_BUDGET, "runs were cut before they reached the target")
        if measured.low <= no_advantage:
            return Verdict(
                ON_REPETITIONS, "the interval holds the paper's figure and no advantage as well"
            )
    if rival_falling:
        return Verdict(ON_BUDGET, "as printed, but the rival was cut while its error fell")
    if measured.low > paper.high:
        return Verdict(REPRODUCED, "the whole interval is above the paper's figure")
    return Verdict(REPRODUCED, "the interval holds the paper's figure or more")


def of_level(
    measured: Interval, paper: Printed, repetitions: int, *, falling: bool, at_floor: bool
) -> Verdict:
    """Verdict on "ends at this error", in both directions.

    1. Fewer than three repetitions: depends on the repetitions.
    2. The interval does not touch the figure: depends on the data if the method ended within 1 % of
    the best error of any other method (the floor of these data differs from the paper's, so its
    figure could not appear); depends on the budget if it is above the figure and was cut while its
    error still fell; else not reproduced.
    3. It touches the figure, but is wider than 20 % of it: depends on the repetitions.
    4. It touches the figure, but runs were cut while the error still fell: depends on the budget.
    5. It touches the figure: reproduced.
    """
    if repetitions < LEAST_REPETITIONS:
        return _too_few(repetitions)
    if measured.high < paper.low or measured.low > paper.high:
        if at_floor:
            return Verdict(ON_DATA, "it is the floor of these data, which is not the paper's")
        if falling and measured.low > paper.high:
            return Verdict(ON_BUDGET, "above the paper, but cut while its error fell")
        side = "above" if measured.low > paper.high else "below"
        return Verdict(NOT_REPRODUCED, f"the whole interval is {side} the paper's figure")
    if measured.high - measured.low > WIDEST_LEVEL * paper.value:
        return Verdict(
            ON_REPETITIONS, f"the interval is wider than {WIDEST_LEVEL * 100:g} % of the figure"
        )
    if falling:
        return Verdict(ON_BUDGET, "as printed, but cut while its error fell")
    return Verdict(REPRODUCED, "the interval holds the paper's figure")


def of_share(
    share: Interval, limit: float, repetitions: int, *, below: bool, falling: bool = False
) -> Verdict:
    """Verdict on a share that stays `below` its limit, or does not.

    1. Fewer than three repetitions: depends on the repetitions.
    2. The whole interval is on one side of the limit: reproduced, or not reproduced; but depends on
    the budget if the share is below and the runs were cut while the error still fell, which can
    only raise it.
    3. The interval contains the limit: depends on the repetitions.
    """
    if repetitions < LEAST_REPETITIONS:
        return _too_few(repetitions)
    percent = f"{limit * 100:g} %"
    if share.high < limit:
        if falling:
            return Verdict(ON_BUDGET, f"below {percent}, but cut while its error fell")
        return Verdict(REPRODUCED if below else NOT_REPRODUCED, f"it is less than {percent}")
    if share.low >= limit:
        return Verdict(NOT_REPRODUCED if below else REPRODUCED, f"it is {percent} or more")
    return Verdict(ON_REPETITIONS, f"the interval holds {percent}, the limit")


def of_local_minimum(excess: Interval, limit: float, repetitions: int, *, falling: bool) -> Verdict:
    """Verdict on "ends in a local minimum": the error stops falling above the best of all methods.

    `excess` is the final error divided by the best error. Fewer than three repetitions: depends on
    the repetitions. Not reproduced if the whole interval of the excess is at or below `limit`,
    depends on the repetitions if it contains the limit, on the budget if runs were cut while the
    error fell, else reproduced.
    """
    if repetitions < LEAST_REPETITIONS:
        return _too_few(repetitions)
    if excess.high <= limit:
        return Verdict(NOT_REPRODUCED, f"it ends within {(limit - 1) * 100:.0f} % of the best")
    if excess.low <= limit:
        return Verdict(ON_REPETITIONS, "some repetitions end at the best error")
    if falling:
        return Verdict(ON_BUDGET, "above the best, but cut while its error fell")
    return Verdict(REPRODUCED, "it no longer falls, above the best of all methods")


def without_runs(methods: list[str]) -> Verdict:
    """Verdict on a claim about methods that have no runs."""
    return Verdict(f"depends on {', '.join(methods)}", "there are no runs to compare with")


def with_missing_rivals(verdict: Verdict, methods: list[str]) -> Verdict:
    """Verdict with missing rivals, which could only reduce "faster than the fastest"."""
    if not methods or verdict.word == NOT_REPRODUCED:
        return verdict
    return Verdict(
        f"depends on {', '.join(methods)}", f"{verdict.word} against the others; no runs of these"
    )


def at_this_size(verdict: Verdict, mismatch: str) -> Verdict:
    """Verdict on a claim about runs of one size: not judged for runs of another size.

    `mismatch` describes the deviation, such as "R = 300, the claim is for R = 10,000"; empty if
    there is none. The number of repetitions is not part of the size, because intervals and their
    rules account for it.
    """
    return Verdict(f"{NOT_JUDGED}: {mismatch}", "") if mismatch else verdict


def of_both_axes(
    seconds: Verdict, evaluations: Verdict, unit: str = "seconds"
) -> tuple[Verdict, Verdict]:
    """Verdicts on a speed claim by both axes; if only one holds, both depend on the axis."""
    definite = {REPRODUCED, NOT_REPRODUCED}
    if seconds.word == evaluations.word or not {seconds.word, evaluations.word} <= definite:
        return seconds, evaluations
    on_both = Verdict(
        "depends on the axis", f"{seconds.word} in {unit}, {evaluations.word} in evaluations"
    )
    return on_both, on_both


def without_claim(measured: Interval, repetitions: int) -> Verdict:
    """Verdict on a speed ratio that the paper does not print: faster, slower or undecided."""
    if repetitions < LEAST_REPETITIONS:
        return Verdict("-", f"only {repetitions} repetitions")
    if measured.low > 1:
        return Verdict("-", "MIHO is faster")
    if measured.high < 1:
        return Verdict("-", "MIHO is slower")
    return Verdict("-", "undecided: the interval holds 1")


def _too_few(repetitions: int) -> Verdict:
    return Verdict(ON_REPETITIONS, f"only {repetitions}; a verdict needs {LEAST_REPETITIONS}")
