"""Which clock a figure or a claim over time goes by: the wall's or the processor's."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from miho.analysis.curves import Axis
from miho.analysis.tidy import require_columns

VALID = "timing_valid"
QUIET_SHARE = 0.5
"""Wall seconds are shown where nothing disturbed more than this share of each problem's seeds."""
UNITS = {"seconds": "seconds", "cpu_seconds": "CPU seconds", "evaluations": "evaluations"}


@dataclass(frozen=True, eq=False)
class Clock:
    """The one clock of a figure or table: seconds of two clocks never share an axis.

    axis: the column of runs and curves that holds its seconds. runs: those that may be compared on
    it. disturbed: what other work did to the runs, in words, "" if nothing. note: the same, with
    what is shown of them.
    """

    axis: Axis
    runs: pd.DataFrame
    disturbed: str
    note: str

    @property
    def unit(self) -> str:
        """Such as "CPU seconds"."""
        return UNITS[self.axis]

    def advice(self, command: str) -> str:
        """How to get wall seconds, "" where the clock has them; command: what made the runs."""
        if self.axis == "seconds":
            return ""
        return (
            f"CPU seconds stand for seconds, since {self.disturbed}; for seconds of the wall clock "
            f"run this while the machine does nothing else: {command} fresh=true"
        )


def undisturbed(runs: pd.DataFrame) -> pd.Series[bool]:
    """Whether no other work disturbed the seconds of each run; True without the column."""
    return runs[VALID].eq(True) if VALID in runs else pd.Series(True, runs.index)


def clock_of(runs: pd.DataFrame) -> Clock:
    """The clock that these runs may be compared on.

    Wall seconds of the seeds that nothing disturbed, if on every problem these are more than
    `QUIET_SHARE` of its seeds; else the processor's seconds of all runs, which other work hardly
    changes. `timing_valid` is True, False, or missing for a run that was not watched, which is no
    better than False. Methods stay paired: where one run of a problem and seed is not valid, no
    run of that problem and seed counts as quiet. A table without the column is shown in wall
    seconds, and the note says that nobody judged it.
    """
    require_columns(runs, ["problem", "seed"], "runs")
    if runs.empty or VALID not in runs:
        unknown = "" if runs.empty else "seconds: nothing is known of what else the machine did"
        return Clock("seconds", runs, "", unknown)
    valid = undisturbed(runs)
    if valid.all():
        return Clock("seconds", runs, "", "")
    disturbed = _disturbed(runs)
    quiet = valid.groupby([runs["problem"], runs["seed"]]).all()
    if (quiet.groupby("problem").mean() > QUIET_SHARE).all():
        whole = valid.groupby([runs["problem"], runs["seed"]]).transform("all")
        comparable = runs[whole]
        drawn = f"shown are the {len(comparable)} runs of undisturbed seeds"
        return Clock("seconds", comparable, disturbed, f"seconds: {disturbed}; {drawn}")
    require_columns(runs, ["cpu_seconds"], "runs")
    return Clock("cpu_seconds", runs, disturbed, f"CPU seconds: {disturbed}")


def _disturbed(runs: pd.DataFrame) -> str:
    """Such as "other work disturbed 3 of 40 runs"."""
    unwatched, disturbed = int(runs[VALID].isna().sum()), int(runs[VALID].eq(False).sum())
    parts = [f"other work disturbed {disturbed} of {len(runs)} runs"] * bool(disturbed)
    parts += [f"nothing watched {unwatched} of {len(runs)} runs"] * bool(unwatched)
    return " and ".join(parts)
