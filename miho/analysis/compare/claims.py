"""The claims of the paper's comparison (Sec. V-A.3, Fig. 6), each against our runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.analysis.compare import verdict
from miho.analysis.compare.bootstrap import (
    RESAMPLES,
    Interval,
    MeanCurve,
    improvement,
    mean_error,
    speed_up,
)
from miho.analysis.compare.verdict import Printed, Verdict
from miho.analysis.curves import Axis
from miho.analysis.text import with_interval
from miho.analysis.tidy import one_problem
from miho.analysis.timing import UNITS, Clock, clock_of

Array = NDArray[np.float64]
Row = dict[str, object]

PAPER_RIVALS = ("gbo_small", "gbo_large", "pso_100", "pso_500")
SPEED_CLAIMS = ((1000.0, Printed(13, 0.5)), (500.0, Printed(494, 0.5)))
TERMINAL_ERROR = Printed(0.39, 0.005)
GAINS = (("pso_500", Printed(24, 0.5)), ("gbo_large", Printed(76, 0.5)))
STUCK = ("pso_100", Printed(0.75, 0.005))
FLAT = ("gbo_small", 0.1)
NEAR_BEST = 1.01

MIHO = "miho"
"""The name of the runs that the claims are about."""


@dataclass(frozen=True)
class Differences:
    """In what a comparison differs from the paper's at full size, in words.

    methods: by method, its settings, such as "miho has R = 2000 instead of 10000". budget: what
    ends a run sooner, such as "at most 4 s per run instead of 30", "" if nothing does.
    """

    methods: Mapping[str, str] = field(default_factory=dict)
    budget: str = ""

    def of(self, *methods: str, ends_sooner: bool = False) -> list[str]:
        """What differs of these methods; that runs end sooner only where it matters."""
        budget = [self.budget] if ends_sooner and self.budget else []
        return [self.methods[method] for method in methods if method in self.methods] + budget


NONE = Differences()


def is_on_a_tire(runs: pd.DataFrame) -> bool:
    """Whether these are runs of MIHO and others on the paper's tires, as its claims are."""
    on_a_tire = runs["problem"].str.startswith("pacejka-tire_").all()
    return bool(on_a_tire) and MIHO in set(runs["optimizer"])


def claims_table(
    runs: pd.DataFrame,
    curves: pd.DataFrame,
    miho: str = "miho",
    *,
    differences: Differences = NONE,
    rng: np.random.Generator | None = None,
    resamples: int = RESAMPLES,
) -> pd.DataFrame:
    """A row per claim: claim, paper, ours (95 % bootstrap interval), repetitions, verdict, reason.

    `miho` is the method that claims are about. Speed claims have two rows, seconds, of the clock
    that `timing.clock_of` chooses, and evaluations, which do not depend on the machine. A claim
    uses the seeds that all its methods have. Errors are those of `runs` in N; the rules are those
    of `miho.analysis.compare.verdict`:

    - speed-ups and gains: reproduced if the interval holds the paper's figure or lies above it,
      not reproduced if it lies below; depends on the repetitions if it holds no advantage as
      well; depends on the budget if cut runs decide; depends on the axis if seconds and
      evaluations disagree; depends on a method that has no runs.
    - terminal errors: reproduced if the interval touches the printed figure and is narrow, not
      reproduced if it does not; depends on the data if MIHO ended on another floor than the
      paper's. PSO-100 is stuck only if no run of it came within 1 % of the best of any method.
    - GBO-small is flat if it gains less than 10 % of its first error.
    - not tested at this size: `differences` name settings of a method that the claim is about,
      unless it is about the final error of MIHO and that is within 1 % of the best of any other
      method, so that no setting ends lower; or runs end sooner than at full size, and in a longer
      one the error could still fall to the paper's (PSO-100) or beyond (PSO-100, GBO-small).

    The last rows compare MIHO with every other method at 0.5 kN, where the paper claims nothing.
    Without `rng` the resamples are those of seed 0, so that a table can be printed again.
    """
    runs, curves = one_problem(runs, curves)
    unit = runs["unit"].iloc[0]
    if unit != "N":
        raise ValueError(f"the paper's claims are about a force in N; these runs are in {unit}")
    if miho not in set(runs["optimizer"]):
        present = ", ".join(sorted(set(runs["optimizer"])))
        raise ValueError(f"there are no runs of {miho!r}; the methods are {present}")
    study = _Study(runs, curves, miho, rng or np.random.default_rng(0), resamples, differences)
    rows = [row for target, paper in SPEED_CLAIMS for row in study.speed_claim(target, paper)]
    rows.append(study.terminal_claim())
    rows += [study.gain_claim(rival, paper) for rival, paper in GAINS]
    rows += [study.stuck_claim(*STUCK), study.flat_claim(*FLAT)]
    without_claim = [m for m in study.methods if m != miho and m not in PAPER_RIVALS]
    rows += [study.extra(other, axis) for other in without_claim for axis in study.speed_axes]
    return pd.DataFrame(rows)


@dataclass(frozen=True, eq=False)
class _Study:
    runs: pd.DataFrame
    curves: pd.DataFrame
    miho: str
    rng: np.random.Generator
    resamples: int
    differences: Differences
    mean_curves: dict[tuple[str, Axis, tuple[int, ...]], MeanCurve] = field(default_factory=dict)
    """Mean curves that several claims are about."""

    @cached_property
    def clock(self) -> Clock:
        return clock_of(self.runs)

    @property
    def speed_axes(self) -> tuple[Axis, Axis]:
        return self.clock.axis, "evaluations"

    @property
    def methods(self) -> list[str]:
        return sorted(set(self.runs["optimizer"]))

    def seeds(self, methods: Sequence[str]) -> list[int]:
        """The seeds that all of the methods have."""
        of = self.runs.groupby("optimizer")["seed"]
        common = set.intersection(*(set(of.get_group(method)) for method in methods))
        return sorted(int(seed) for seed in common)

    def curve(self, method: str, axis: Axis, seeds: Sequence[int]) -> MeanCurve:
        key = method, axis, tuple(seeds)
        if key not in self.mean_curves:
            self.mean_curves[key] = MeanCurve.of(self.runs, self.curves, method, axis, seeds)
        return self.mean_curves[key]

    def final(self, method: str, seeds: Sequence[int]) -> Array:
        """Final errors (n,) in N; inf where a run saw nothing finite."""
        rows = self.runs[self.runs["optimizer"] == method].set_index("seed").loc[list(seeds)]
        return rows["error"].fillna(np.inf).to_numpy(dtype=float)

    def falling(self, method: str, seeds: Sequence[int]) -> bool:
        return self.curve(method, "evaluations", seeds).still_falling()

    def at_floor(self, error: float) -> bool:
        """Whether MIHO ended where another method ended as the best.

        That MIHO itself is the best of all would not show that the data allow nothing better.
        """
        best_other = self.runs["error"][self.runs["optimizer"] != self.miho].min()
        return bool(best_other / NEAR_BEST <= error <= best_other * NEAR_BEST)

    def speed(
        self, rivals: Sequence[str], target: float, axis: Axis
    ) -> tuple[Interval, int] | None:
        """The speed-up against the fastest of the rivals; None without common seeds."""
        seeds = self.seeds([self.miho, *rivals])
        if axis == self.clock.axis:
            timed = set(self.clock.runs["seed"])
            seeds = [seed for seed in seeds if seed in timed]
        if not seeds:
            return None
        miho_curve = self.curve(self.miho, axis, seeds)
        rival_curves = [self.curve(rival, axis, seeds) for rival in rivals]
        return speed_up(miho_curve, rival_curves, target, self.rng, self.resamples), len(seeds)

    def speed_claim(self, target: float, paper: Printed) -> list[Row]:
        present = [rival for rival in PAPER_RIVALS if rival in self.methods]
        absent = [rival for rival in PAPER_RIVALS if rival not in self.methods]
        claims = [
            f"MIHO is faster than GBO and PSO to {target / 1e3:.1f} kN, in {UNITS[a]}"
            for a in self.speed_axes
        ]
        printed = f"{paper.value:g}×"
        measured = [self.speed(present, target, a) if present else None for a in self.speed_axes]
        verdicts = []
        differences = self.differences.of(self.miho, *present)
        for speed in measured:
            if speed is None:
                verdicts.append(verdict.without_runs(absent or ["common seeds"]))
                continue
            of_present = verdict.of_advantage(speed[0], paper, speed[1], no_advantage=1)
            of_all = verdict.with_missing_rivals(of_present, absent)
            verdicts.append(verdict.at_this_size(of_all, differences))
        first, second = verdicts
        verdicts = list(verdict.of_both_axes(first, second, self.clock.unit))
        return [
            _speed_row(claim, printed, speed, result)
            for claim, speed, result in zip(claims, measured, verdicts, strict=True)
        ]

    def terminal_claim(self) -> Row:
        seeds = self.seeds([self.miho])
        final = self.final(self.miho, seeds)
        interval = mean_error(final, self.rng, self.resamples).scaled(1e-3)
        result = verdict.of_level(
            interval,
            TERMINAL_ERROR,
            len(seeds),
            falling=self.falling(self.miho, seeds),
            at_floor=self.at_floor(float(final.mean())),
        )
        result = verdict.at_this_size(result, self.differences_at_end(final))
        return _row("terminal error of MIHO", "0.39 kN", (interval, len(seeds)), " kN", result)

    def differences_at_end(self, final: Array) -> list[str]:
        """What differs of MIHO, unless it ended where no setting ends lower."""
        return [] if self.at_floor(float(final.mean())) else self.differences.of(self.miho)

    def gain_claim(self, rival: str, paper: Printed) -> Row:
        claim, printed = f"MIHO ends below {rival} by", f"{paper.value:g} %"
        seeds = self.seeds([self.miho, rival]) if rival in self.methods else []
        if not seeds:
            return _row(claim, printed, None, " %", verdict.without_runs([rival]))
        miho_errors, rival_errors = self.final(self.miho, seeds), self.final(rival, seeds)
        interval = improvement(miho_errors, rival_errors, self.rng, self.resamples).scaled(100)
        result = verdict.of_advantage(
            interval,
            paper,
            len(seeds),
            no_advantage=0,
            miho_falling=self.falling(self.miho, seeds),
            rival_falling=self.falling(rival, seeds),
        )
        differences = [*self.differences_at_end(miho_errors), *self.differences.of(rival)]
        result = verdict.at_this_size(result, differences)
        return _row(claim, printed, (interval, len(seeds)), " %", result)

    def stuck_claim(self, method: str, paper: Printed) -> Row:
        claim, printed = f"{method} stays at", f"{paper.value:g} kN"
        if method not in self.methods:
            return _row(claim, printed, None, " kN", verdict.without_runs([method]))
        seeds = self.seeds([method])
        final = self.final(method, seeds)
        interval = mean_error(final, self.rng, self.resamples).scaled(1e-3)
        result = verdict.of_level(
            interval, paper, len(seeds), falling=self.falling(method, seeds), at_floor=False
        )
        escaped = int(np.sum(final <= NEAR_BEST * self.runs["error"].min()))
        if escaped and result.word != verdict.NOT_REPRODUCED:
            result = Verdict(
                verdict.ON_REPETITIONS, f"{escaped} of {len(seeds)} came within 1 % of the best"
            )
        differences = self.differences.of(method, ends_sooner=interval.high >= paper.low)
        result = verdict.at_this_size(result, differences)
        return _row(claim, printed, (interval, len(seeds)), " kN", result)

    def flat_claim(self, method: str, limit: float) -> Row:
        claim, printed = f"{method} improves by", f"negligible (< {limit * 100:g} %)"
        if method not in self.methods:
            return _row(claim, printed, None, " %", verdict.without_runs([method]))
        first = self.curves[self.curves["optimizer"] == method].groupby("seed")["error"].first()
        seeds = [int(seed) for seed in first.dropna().index]
        if not seeds:
            return _row(claim, printed, None, " %", verdict.without_runs([method]))
        start = first.loc[seeds].to_numpy(dtype=float)
        fall = improvement(self.final(method, seeds), start, self.rng, self.resamples)
        result = verdict.of_flatness(fall, limit, len(seeds))
        differences = self.differences.of(method, ends_sooner=fall.low < limit)
        result = verdict.at_this_size(result, differences)
        return _row(claim, printed, (fall.scaled(100), len(seeds)), " %", result)

    def extra(self, other: str, axis: Axis) -> Row:
        claim = f"MIHO is faster than {other} to 0.5 kN, in {UNITS[axis]}"
        speed = self.speed([other], 500.0, axis)
        result = verdict.without_claim(*speed) if speed else verdict.without_runs([other])
        return _speed_row(claim, "-", speed, result)


def _row(
    claim: str, paper: str, measured: tuple[Interval, int] | None, unit: str, result: Verdict
) -> Row:
    return {
        "claim": claim,
        "paper": paper,
        "ours": with_interval(measured[0], unit) if measured else "-",
        "repetitions": measured[1] if measured else 0,
        "verdict": result.word,
        "reason": result.reason,
    }


def _speed_row(
    claim: str, paper: str, measured: tuple[Interval, int] | None, result: Verdict
) -> Row:
    row = _row(claim, paper, measured, "×", result)
    if measured and measured[0].estimate == 0:
        row["ours"] = f"0×, MIHO did not reach it; {row['ours']}"
    return row
