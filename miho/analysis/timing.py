"""The clock of a figure or claim over time: wall or CPU seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from miho.analysis.curves import Axis
from miho.analysis.tidy import require_columns

VALID = "timing_valid"
QUIET_SHARE = 0.5
"""Wall seconds are shown if more than this share of each problem's seeds was undisturbed."""
REPEAT = "sweep.timed=true fresh=true"
"""Settings with which a sweep repeats its runs whose seconds are not valid."""
UNITS = {"seconds": "seconds", "cpu_seconds": "CPU seconds", "evaluations": "evaluations"}


@dataclass(frozen=True, eq=False)
class Clock:
    """The clock of a figure or table; seconds of two clocks never share an axis.

    Attributes
    ----------
    axis : Axis
        The column of runs and curves with its seconds.
    runs : DataFrame
        The runs that may be compared on it.
    disturbed : str
        Disturbances of the runs by other work, as a phrase; empty if there were none.
    note : str
        The same with the selection that is shown.
    """

    axis: Axis
    runs: pd.DataFrame
    disturbed: str
    note: str

    @property
    def unit(self) -> str:
        """Unit of the axis, for example "CPU seconds"."""
        return UNITS[self.axis]

    def advice(self, commands: Sequence[str]) -> str:
        """How to get wall seconds by the commands that made the runs; empty if the clock has them.

        Without commands only the reason is given.
        """
        if self.axis == "seconds":
            return ""
        reason = f"CPU seconds replace seconds, because {self.disturbed}"
        if not commands:
            return reason
        again = " && ".join(f"{command} {REPEAT}" for command in commands)
        return f"{reason}; for wall seconds, run this while the machine is otherwise idle: {again}"


def undisturbed(runs: pd.DataFrame) -> pd.Series[bool]:
    """Whether the seconds of each run are undisturbed by other work; True without the column."""
    return runs[VALID].eq(True) if VALID in runs else pd.Series(True, runs.index)


def clock_of(runs: pd.DataFrame) -> Clock:
    """The clock for comparing these runs.

    These are wall seconds of the undisturbed seeds, if they are more than `QUIET_SHARE` of the
    seeds of every problem; else CPU seconds of all runs, which other work hardly changes.
    `timing_valid` is True, False, or missing for a run that was not watched, which counts as False.
    Methods stay paired: if one run of a problem and seed is not valid, none with that problem and
    seed counts as undisturbed. A table without the column is shown in wall seconds, with a note
    that nobody judged them.
    """
    require_columns(runs, ["problem", "seed"], "runs")
    if runs.empty or VALID not in runs:
        unknown = "" if runs.empty else "seconds: other work on the machine is unknown"
        return Clock("seconds", runs, "", unknown)
    valid = undisturbed(runs)
    if valid.all():
        return Clock("seconds", runs, "", "")
    disturbed = _disturbed(runs)
    quiet = valid.groupby([runs["problem"], runs["seed"]]).all()
    if (quiet.groupby("problem").mean() > QUIET_SHARE).all():
        whole = valid.groupby([runs["problem"], runs["seed"]]).transform("all")
        comparable = runs[whole]
        scope = f"shown are the {len(comparable):,} runs of undisturbed seeds"
        return Clock("seconds", comparable, disturbed, f"seconds: {disturbed}; {scope}")
    require_columns(runs, ["cpu_seconds"], "runs")
    return Clock("cpu_seconds", runs, disturbed, f"CPU seconds: {disturbed}")


def _disturbed(runs: pd.DataFrame) -> str:
    """A phrase such as "other work disturbed 3 of 40 runs"."""
    unwatched, disturbed = int(runs[VALID].isna().sum()), int(runs[VALID].eq(False).sum())
    parts = [f"other work disturbed {disturbed:,} of {len(runs):,} runs"] * bool(disturbed)
    parts += [f"nothing watched {unwatched:,} of {len(runs):,} runs"] * bool(unwatched)
    return " and ".join(parts)
