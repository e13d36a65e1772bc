"""Tables of the evaluations until runs reached an optimum, and until they stopped by themselves."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from miho.analysis.compare.running_time import FACTORS, NEAR_BEST, running_times
from miho.optim.minimize import Outcome
from miho.quantities import Array

SAME_OPTIMUM = 1e-4
"""Largest relative difference of two losses of the same optimum. Error bars are wider, and the
tolerances of solvers are much smaller."""


@dataclass(frozen=True)
class Run:
    """Cost of one run, and its k improvements: evaluations, seconds and losses, shape (k,)."""

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
        """Last error relative to the optimum, minus 1; inf if the run has no loss."""
        return math.sqrt(self.losses[-1]) / self.optimum - 1 if self.losses.size else math.inf

    @property
    def at_optimum(self) -> bool:
        """Whether the final loss equals the loss of the recorded optimum, to SAME_OPTIMUM."""
        return bool(self.losses.size and self.losses[-1] <= self.optimum**2 * (1 + SAME_OPTIMUM))

    @property
    def overrun(self) -> float:
        """Evaluations at the end over evaluations at arrival; NaN if the run has no loss."""
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
    """A row per problem and variant: ERT to each factor, and statistics for the smallest factor.

    `median`, `90 %` and `largest` are evaluations to the smallest factor, inf for a run that does
    not reach it; `ms` is the median of the milliseconds to the factor NEAR_BEST.
    """
    group = ["problem", "optimizer"]
    times = running_times(hits, "evaluations").pivot(index=group, columns="factor", values="ert")
    last = hits[hits["factor"] == min(FACTORS)].groupby(group)
    clocked = hits[hits["factor"] == NEAR_BEST].groupby(group)
    table = times[list(FACTORS)].rename(columns="{:g}".format)
    table["success"] = last["reached"].mean()
    for name, share in (("median", 0.5), ("90 %", 0.9), ("largest", 1.0)):
        table[name] = last["evaluations"].agg(_quantile, share)
    table["ms"] = 1e3 * clocked["seconds"].agg(_quantile, 0.5)
    return _in_order(table, hits).rename_axis(columns=None)


def stopping_table(runs: Sequence[Run]) -> pd.DataFrame:
    """A row per problem and variant on how runs end.

    `ended` is the share of runs that the method ended by itself, `at optimum` the share that it
    ended at the optimum, and `spent` the median number of evaluations. The other columns are
    quantiles of `Run.overrun` over the runs that the method ended.
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
    """Quantile without interpolation, which fails between a number and inf."""
    return float(np.quantile(values, share, method="inverted_cdf"))


def _in_order(table: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
    """Sort the rows of a table by the given order of problems and variants."""
    return table.reindex(pd.MultiIndex.from_frame(rows[table.index.names].drop_duplicates()))


def geometric_means(table: pd.DataFrame) -> pd.DataFrame:
    """A row per variant over the problems of `reach_table`, in its order.

    It contains geometric means of each ERT and of the milliseconds, which are inf if no run solved
    one of the problems; `unsolved` counts these problems. `least success` is over the problems.
    """
    columns = [f"{factor:g}" for factor in FACTORS]
    logs = table[[*columns, "ms"]].apply(np.log)
    means = logs.groupby("optimizer", sort=False).mean().apply(np.exp)
    success = table["success"].groupby("optimizer", sort=False)
    means.insert(len(columns), "least success", success.min())
    means["unsolved"] = success.agg(lambda shares: int((shares == 0).sum()))
    return means


def solved_by_all(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of `reach_table` on problems that at least one run of every variant solved."""
    return table[table["success"].groupby("problem").transform("min") > 0]
