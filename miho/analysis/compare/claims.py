"""The claims of the paper's comparison (Sec. V-A.3, Fig. 6), each judged by our runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd

from miho.analysis.compare import verdict
from miho.analysis.compare.bootstrap import (
    RESAMPLES,
    Interval,
    MeanCurve,
    improvement,
    mean_error,
    speed_up,
)
from miho.analysis.compare.running_time import NEAR_BEST
from miho.analysis.compare.size import (
    MIHO,
    PAPER,
    Settings,
    mismatch,
    nearest_to_paper,
    settings_by_method,
)
from miho.analysis.compare.verdict import Printed, Verdict
from miho.analysis.curves import Axis
from miho.analysis.text import with_interval
from miho.analysis.tidy import one_problem
from miho.analysis.timing import UNITS, Clock, clock_of
from miho.analysis.variants import base_name, with_names_of
from miho.quantities import Array

Row = dict[str, object]

PAPER_RIVALS = ("gbo_small", "gbo_large", "pso_100", "pso_500")
SPEED_CLAIMS = ((1000.0, Printed(13, 0.5)), (500.0, Printed(494, 0.5)))
TERMINAL_ERROR = Printed(0.39, 0.005)
GAINS = (("pso_500", Printed(24, 0.5)), ("gbo_large", Printed(76, 0.5)))
STUCK = ("pso_100", Printed(0.75, 0.005))
MORE = Printed(1, 0)
COSTS = (("pso_100", 1000.0), (MIHO, 500.0))
"""PSO-500 needs more evaluations than these methods to these errors [N]; the paper's PSO-100 ends
above 0.5 kN."""
FLAT = ("gbo_small", 0.1)
IDLE = 0.1
"""Largest share of evaluations without improvement of a stable descent, whose error falls at every
step."""


def is_on_a_tire(runs: pd.DataFrame) -> bool:
    """Return whether these are runs of MIHO and others on the paper's tires, like its claims."""
    on_a_tire = runs["problem"].str.startswith("pacejka-tire_").all()
    return bool(on_a_tire) and MIHO in set(runs["optimizer"].map(base_name))


def claims_table(
    runs: pd.DataFrame,
    curves: pd.DataFrame,
    *,
    settings: Mapping[str, Settings] | None = None,
    rng: np.random.Generator | None = None,
    resamples: int = RESAMPLES,
) -> pd.DataFrame:
    """Judge the claims of the paper's comparison (Sec. V-A.3, Fig. 6) by these runs.

    Parameters
    ----------
    runs, curves : DataFrame
        As in `miho.load_runs`, of one problem; errors in N. If a method has several settings, its
        runs nearest to the paper count.
    settings : mapping of str to mapping, optional
        The settings of each method, for example `{"miho": {"optimizer.R": 300}}`. By default they
        are read from the stored runs.
    rng : Generator, optional
        Generator of the resamples; by default with seed 0, so that a table can be reproduced.
    resamples : int
        Bootstrap resamples.

    Returns
    -------
    DataFrame
        A row per claim: claim, paper, ours (95 % bootstrap interval), repetitions, verdict, reason.

    Raises
    ------
    ValueError
        If there are no runs of MIHO, the error is not in N, or there is more than one problem.

    Notes
    -----
    A claim is judged only by runs of its size: the settings of `size.PAPER` for the methods of the
    claim, 3000 rows and 5 parameters. Otherwise its verdict is, for example, "not judged: R = 300,
    the claim is for R = 10,000". Claims about gradient descent and swarms do not depend on R.

    A claim uses the seeds that all its methods have. Speed claims have two rows: seconds, on the
    clock of `timing.clock_of`, and evaluations, which do not depend on the machine. The rules of
    the verdicts are in `miho.analysis.compare.verdict`. In addition, PSO-100 is stuck only if none
    of its runs came within 1 % of the best of any method, GBO-small hardly moves if its error falls
    by less than 10 % of the first one, and a descent is stable if less than 10 % of its evaluations
    pass without improvement.

    The last rows compare MIHO with every other method at 0.5 kN, about which the paper claims
    nothing.
    """
    runs, curves = one_problem(runs, curves)
    unit = runs["unit"].iloc[0]
    if unit != "N":
        raise ValueError(f"the paper's claims are about a force in N; these runs are in {unit}")
    settings = settings_by_method(runs) if settings is None else settings
    runs, settings = _of_paper(runs, settings)
    curves = with_names_of(curves[curves["id"].isin(runs["id"])], runs)
    if MIHO not in set(runs["optimizer"]):
        present = ", ".join(sorted(set(runs["optimizer"])))
        raise ValueError(f"there are no runs of {MIHO!r}; the methods are {present}")
    study = _Study(runs, curves, settings, rng or np.random.default_rng(0), resamples)
    rows = [row for target, paper in SPEED_CLAIMS for row in study.speed_claim(target, paper)]
    rows.append(study.terminal_claim())
    rows += [study.gain_claim(rival, paper) for rival, paper in GAINS]
    rows.append(study.stuck_claim(*STUCK))
    rows += [study.cost_claim("pso_500", *cheaper) for cheaper in COSTS]
    rows += [study.flat_claim(*FLAT), study.stable_claim("gbo_small", stable=True)]
    rows += [study.stable_claim("gbo_large", stable=False), study.minimum_claim("gbo_large")]
    without_claim = [m for m in study.methods if m not in PAPER]
    rows += [study.extra(other, axis) for other in without_claim for axis in study.speed_axes]
    return pd.DataFrame(rows)


def _of_paper(
    runs: pd.DataFrame, settings: Mapping[str, Settings]
) -> tuple[pd.DataFrame, Mapping[str, Settings]]:
    """The runs of each of the paper's methods that are nearest to its settings, under its name."""
    nearest = {name: base for base, name in nearest_to_paper(runs, settings).items()}
    left_out = [
        name for name in runs["optimizer"] if base_name(name) in PAPER and name not in nearest
    ]
    runs = runs[~runs["optimizer"].isin(left_out)]
    names = runs["optimizer"].map(lambda name: nearest.get(name, name))
    by_method = {nearest.get(name, name): known for name, known in settings.items()}
    return runs.assign(optimizer=names), by_method


@dataclass(frozen=True, eq=False)
class _Study:
    runs: pd.DataFrame
    curves: pd.DataFrame
    settings: Mapping[str, Settings]
    rng: np.random.Generator
    resamples: int
    mean_curves: dict[tuple[str, Axis, tuple[int, ...]], MeanCurve] = field(default_factory=dict)
    """Mean curves that several claims share."""

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
        runs = self.runs
        common = (set(runs["seed"][runs["optimizer"] == method]) for method in methods)
        return sorted(int(seed) for seed in set.intersection(*common))

    def curve(self, method: str, axis: Axis, seeds: Sequence[int]) -> MeanCurve:
        key = method, axis, tuple(seeds)
        if key not in self.mean_curves:
            self.mean_curves[key] = MeanCurve.of(self.runs, self.curves, method, axis, seeds)
        return self.mean_curves[key]

    def final(self, method: str, seeds: Sequence[int]) -> Array:
        """Final errors (n,) in N; inf if a run has no finite error."""
        rows = self.runs[self.runs["optimizer"] == method].set_index("seed").loc[list(seeds)]
        return rows["error"].fillna(np.inf).to_numpy(dtype=float)

    def falling(self, method: str, seeds: Sequence[int]) -> bool:
        return self.curve(method, "evaluations", seeds).still_falling()

    def at_floor(self, error: float) -> bool:
        """Return whether MIHO ended at the best error of another method.

        If MIHO itself is the best of all, that does not show that the data allow nothing better.
        """
        best_other = self.runs["error"][self.runs["optimizer"] != MIHO].min()
        return bool(best_other / NEAR_BEST <= error <= best_other * NEAR_BEST)

    def speed(
        self, rivals: Sequence[str], target: float, axis: Axis, method: str = MIHO
    ) -> tuple[Interval, int] | None:
        """The speed-up of a method against the fastest of the rivals, and the number of seeds.

        None without common seeds.
        """
        seeds = self.seeds([method, *rivals])
        if axis == self.clock.axis:
            timed = set(self.clock.runs["seed"])
            seeds = [seed for seed in seeds if seed in timed]
        if not seeds:
            return None
        curve = self.curve(method, axis, seeds)
        rival_curves = [self.curve(rival, axis, seeds) for rival in rivals]
        return speed_up(curve, rival_curves, target, self.rng, self.resamples), len(seeds)

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
        size = mismatch(self.settings, MIHO, *present)
        for speed in measured:
            if speed is None:
                verdicts.append(verdict.without_runs(absent or ["common seeds"]))
                continue
            of_present = verdict.of_advantage(speed[0], paper, speed[1], no_advantage=1)
            of_all = verdict.with_missing_rivals(of_present, absent)
            verdicts.append(verdict.at_this_size(of_all, size))
        first, second = verdicts
        verdicts = list(verdict.of_both_axes(first, second, self.clock.unit))
        return [
            self.speed_row(claim, printed, speed, result)
            for claim, speed, result in zip(claims, measured, verdicts, strict=True)
        ]

    def terminal_claim(self) -> Row:
        seeds = self.seeds([MIHO])
        final = self.final(MIHO, seeds)
        interval = mean_error(final, self.rng, self.resamples).scaled(1e-3)
        result = verdict.of_level(
            interval,
            TERMINAL_ERROR,
            len(seeds),
            falling=self.falling(MIHO, seeds),
            at_floor=self.at_floor(float(final.mean())),
        )
        measured = interval, len(seeds)
        return self.row("terminal error of MIHO", "0.39 kN", measured, " kN", result, MIHO)

    def gain_claim(self, rival: str, paper: Printed) -> Row:
        claim, printed = f"MIHO ends below {rival} by", f"{paper.value:g} %"
        seeds = self.seeds([MIHO, rival])
        if not seeds:
            return self.row(claim, printed, None, " %", verdict.without_runs([rival]))
        miho_errors, rival_errors = self.final(MIHO, seeds), self.final(rival, seeds)
        interval = improvement(miho_errors, rival_errors, self.rng, self.resamples).scaled(100)
        result = verdict.of_advantage(
            interval,
            paper,
            len(seeds),
            no_advantage=0,
            miho_falling=self.falling(MIHO, seeds),
            rival_falling=self.falling(rival, seeds),
        )
        return self.row(claim, printed, (interval, len(seeds)), " %", result, MIHO, rival)

    def stuck_claim(self, method: str, paper: Printed) -> Row:
        claim, printed = f"{method} stops at", f"{paper.value:g} kN"
        if method not in self.methods:
            return self.row(claim, printed, None, " kN", verdict.without_runs([method]))
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
        return self.row(claim, printed, (interval, len(seeds)), " kN", result, method)

    def cost_claim(self, method: str, cheaper: str, target: float) -> Row:
        claim = f"{method} needs more evaluations than {cheaper} to {target / 1e3:.1f} kN"
        cost = self.speed([method], target, "evaluations", cheaper)
        if cost is None:
            return self.row(claim, "more", None, "×", verdict.without_runs([method]))
        result = verdict.of_advantage(cost[0], MORE, cost[1], no_advantage=1)
        return self.row(claim, "more", cost, "×", result, method, cheaper)

    def flat_claim(self, method: str, limit: float) -> Row:
        claim, printed = f"{method} hardly moves: its error falls by", f"< {limit * 100:g} %"
        first = self.curves[self.curves["optimizer"] == method].groupby("seed")["error"].first()
        seeds = [int(seed) for seed in first.dropna().index]
        if not seeds:
            return self.row(claim, printed, None, " %", verdict.without_runs([method]))
        start = first.loc[seeds].to_numpy(dtype=float)
        fall = improvement(self.final(method, seeds), start, self.rng, self.resamples)
        falling = self.falling(method, seeds)
        result = verdict.of_share(fall, limit, len(seeds), below=True, falling=falling)
        return self.row(claim, printed, (fall.scaled(100), len(seeds)), " %", result, method)

    def stable_claim(self, method: str, *, stable: bool) -> Row:
        word, sign = ("stable", "<") if stable else ("unstable", "≥")
        claim = f"{method} is {word}: evaluations without improvement"
        printed = f"{sign} {IDLE * 100:g} %"
        if method not in self.methods:
            return self.row(claim, printed, None, " %", verdict.without_runs([method]))
        seeds = self.seeds([method])
        idle = self.curve(method, "evaluations", seeds).idle()
        share = mean_error(idle, self.rng, self.resamples)
        result = verdict.of_share(share, IDLE, len(seeds), below=stable)
        return self.row(claim, printed, (share.scaled(100), len(seeds)), " %", result, method)

    def minimum_claim(self, method: str) -> Row:
        claim, printed = f"{method} ends in a local minimum: its error over the best", "> 1.01×"
        if method not in self.methods:
            return self.row(claim, printed, None, "×", verdict.without_runs([method]))
        seeds, best = self.seeds([method]), float(self.runs["error"].min())
        excess = mean_error(self.final(method, seeds) / best, self.rng, self.resamples)
        falling = self.falling(method, seeds)
        result = verdict.of_local_minimum(excess, NEAR_BEST, len(seeds), falling=falling)
        return self.row(claim, printed, (excess, len(seeds)), "×", result, method)

    def extra(self, other: str, axis: Axis) -> Row:
        claim = f"MIHO is faster than {other} to 0.5 kN, in {UNITS[axis]}"
        speed = self.speed([other], 500.0, axis)
        result = verdict.without_claim(*speed) if speed else verdict.without_runs([other])
        return self.speed_row(claim, "-", speed, result)

    def row(
        self, claim: str, paper: str, measured: tuple[Interval, int] | None, unit: str,
        result: Verdict, *methods: str,
    ) -> Row:  # fmt: skip
        """The row of a claim about these methods, which is not judged for runs of another size."""
        result = verdict.at_this_size(result, mismatch(self.settings, *methods))
        return {
            "claim": claim,
            "paper": paper,
            "ours": with_interval(measured[0], unit) if measured else "-",
            "repetitions": measured[1] if measured else 0,
            "verdict": result.word,
            "reason": result.reason,
        }

    def speed_row(
        self, claim: str, paper: str, measured: tuple[Interval, int] | None, result: Verdict
    ) -> Row:
        row = self.row(claim, paper, measured, "×", result)
        if measured and measured[0].estimate == 0:
            row["ours"] = f"0×, MIHO did not reach it; {row['ours']}"
        return row
