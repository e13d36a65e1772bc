"""Tables of what runs spent until they reached an optimum, or until they knew that it is one."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.analysis.compare.running_time import FACTORS, running_times
from miho.optim.minimize import Outcome

Array = NDArray[np.float64]

CLOCKED = 1.01
"""The factor whose milliseconds are shown."""
SAME_OPTIMUM = 1e-4
"""Relative difference of two losses that are one optimum: no error bar is as narrow, and a solver
that stops at its tolerance is far below."""


@dataclass(frozen=True)
class Run:
    """What one run spent, and its improvements: evaluations, seconds and losses (k,) each."""

    problem: str
    variant: str
    seed: int
    optimum: float
    outcome: Outcome
    evaluations: float
    seconds: float
    at_evaluations: Array
    at_seconds: Array
    losses: Array
    data: str = ""
    error: str | None = None

    def first(self, loss: float) -> tuple[float, float]:
        """Evaluations and seconds until a loss of at most `loss`; inf if never."""
        k = np.flatnonzero(self.losses <= loss)
        return (self.at_evaluations[k[0]], self.at_seconds[k[0]]) if k.size else (math.inf,) * 2

    @property
    def ended(self) -> bool:
        """Whether the method ended the run by itself, and not by its largest number of brackets."""
        return self.outcome is Outcome.CONVERGED

    @property
    def excess(self) -> float:
        """The last error relative to the optimum, minus 1; inf without any."""
        return math.sqrt(self.losses[-1]) / self.optimum - 1 if self.losses.size else math.inf

    @property
    def at_optimum(self) -> bool:
        """Whether the loss of the end is that of the recorded optimum."""
        return bool(self.losses.size and self.losses[-1] <= self.optimum**2 * (1 + SAME_OPTIMUM))

    @property
    def overrun(self) -> float:
        """Evaluations at the end over those at arrival; NaN for a run that never had a loss."""
        if not self.losses.size:
            return math.nan
        return self.evaluations / self.first(self.losses[-1] * (1 + SAME_OPTIMUM))[0]


def hits(runs: Sequence[Run]) -> pd.DataFrame:
    """A row per run and factor, as `miho.analysis.compare.running_time.hits` gives them."""
    rows = []
    for run, factor in itertools.product(runs, FACTORS):
        evaluations, seconds = run.first((factor * run.optimum) ** 2)
        rows.append(
            {"problem": run.problem, "optimizer": run.variant, "seed": run.seed, "factor": factor,
             "evaluations": evaluations, "seconds": seconds, "outcome": run.outcome.value,
             "spent_evaluations": run.evaluations, "spent_seconds": run.seconds,
             "reached": math.isfinite(evaluations)}
        )  # fmt: skip
    return pd.DataFrame(rows)


def reach_table(hits: pd.DataFrame) -> pd.DataFrame:
    """A row per problem and variant: ERT to each factor, and the runs to the smallest of them.

    `median`, `90 %` and `largest` are evaluations to the smallest factor, inf for a run that does
    not get there, `ms` the median of the milliseconds to CLOCKED.
    """
    group = ["problem", "optimizer"]
    times = running_times(hits, "evaluations").pivot(index=group, columns="factor", values="ert")
    last = hits[hits["factor"] == min(FACTORS)].groupby(group)
    clocked = hits[hits["factor"] == CLOCKED].groupby(group)
    table = times[list(FACTORS)].rename(columns="{:g}".format)
    table["success"] = last["reached"].mean()
    for name, share in (("median", 0.5), ("90 %", 0.9), ("largest", 1.0)):
        table[name] = last["evaluations"].agg(_quantile, share)
    table["ms"] = 1e3 * clocked["seconds"].agg(_quantile, 0.5)
    return _in_order(table, hits).rename_axis(columns=None)


def stopping_table(runs: Sequence[Run]) -> pd.DataFrame:
    """A row per problem and variant on how runs end.

    `ended` is the share of runs that the method ended by itself, `at optimum` that of all runs that
    it ended there; `spent` the median of evaluations, the others are of `Run.overrun`, over the
    runs that the method ended.
    """
    return _in_order(stopping_shares(runs, ["problem", "optimizer"]), endings(runs))


def stopping_shares(runs: Sequence[Run], by: list[str]) -> pd.DataFrame:
    """The columns of `stopping_table` over groups of runs."""
    frame = endings(runs)
    groups, ended = frame.groupby(by), frame[frame["ended"]].groupby(by)
    table = pd.DataFrame({"runs": groups.size(), "ended": groups["ended"].mean()})
    table["at optimum"] = groups["stopped_there"].mean()
    table["spent"] = groups["evaluations"].median()
    for name, share in (("median", 0.5), ("90 %", 0.9), ("largest", 1.0)):
        table[name] = ended["overrun"].agg(_quantile, share)
    return table


def endings(runs: Sequence[Run]) -> pd.DataFrame:
    """A row per run on how it ended."""
    rows = [
        {"problem": run.problem, "optimizer": run.variant, "seed": run.seed, "ended": run.ended,
         "stopped_there": run.ended and run.at_optimum, "evaluations": run.evaluations,
         "overrun": run.overrun, "excess": run.excess, "outcome": run.outcome.value}
        for run in runs
    ]  # fmt: skip
    return pd.DataFrame(rows)


def _quantile(values: pd.Series, share: float) -> float:
    """A value of those that are there: between a number and inf there is none."""
    return float(np.quantile(values, share, method="inverted_cdf"))


def _in_order(table: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of a table in the order in which problems and variants were given."""
    return table.reindex(pd.MultiIndex.from_frame(rows[table.index.names].drop_duplicates()))


def geometric_means(table: pd.DataFrame) -> pd.DataFrame:
    """A row per variant over the problems of `reach_table`, in its order.

    Geometric means of each ERT and of milliseconds: inf if there is one problem that no run solved,
    which `unsolved` counts. `success` is the least.
    """
    columns = [f"{factor:g}" for factor in FACTORS]
    logs = table[[*columns, "ms"]].apply(np.log)
    means = logs.groupby("optimizer", sort=False).mean().apply(np.exp)
    success = table["success"].groupby("optimizer", sort=False)
    means.insert(len(columns), "least success", success.min())
    means["unsolved"] = success.agg(lambda shares: int((shares == 0).sum()))
    return means


def solved_by_all(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of `reach_table` on problems that some run of every variant solved."""
    return table[table["success"].groupby("problem").transform("min") > 0]
