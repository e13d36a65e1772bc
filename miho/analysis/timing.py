"""Which runs may stand in a figure or a claim over seconds."""

from __future__ import annotations

import pandas as pd

from miho.analysis.tidy import require_columns

VALID = "timing_valid"


def undisturbed(runs: pd.DataFrame) -> pd.Series[bool]:
    """Whether the seconds of each run may be shown; all may where nobody judged any."""
    return runs[VALID].eq(True) if VALID in runs else pd.Series(True, runs.index)


def valid_seconds(runs: pd.DataFrame) -> tuple[pd.DataFrame, str]:
    """The runs whose seconds may be compared, and a sentence on the others, "" if there are none.

    `timing_valid` is True, False, or missing for a run that was not watched, which is no better
    than False. Methods stay paired: where one run of a problem and seed is not valid, all runs of
    that problem and seed are left out. A table without the column comes back whole, and the
    sentence says that nobody judged it. If no run is left, no figure of seconds can be drawn, and
    the sentence stands in its place.
    """
    require_columns(runs, ["problem", "seed"], "runs")
    if runs.empty:
        return runs, ""
    if VALID not in runs:
        return runs, "seconds: nothing is known of what else the machine did"
    valid = runs[VALID].eq(True)
    unwatched, disturbed = int(runs[VALID].isna().sum()), int(runs[VALID].eq(False).sum())
    if valid.all():
        return runs, ""
    whole = valid.groupby([runs["problem"], runs["seed"]]).transform("all")
    kept = runs[whole]
    found = [f"{disturbed} of {len(runs)} runs were disturbed by other work"] * bool(disturbed)
    found += [f"{unwatched} of {len(runs)} were not watched"] * bool(unwatched)
    if kept.empty:
        told = "no seconds are shown: " + " and ".join(found)
        return kept, f"{told}; run them again, one at a time, on a machine that does nothing else"
    shown = f"shown are the {len(kept)} runs of undisturbed seeds"
    return kept, f"seconds: {' and '.join(found)}; {shown}"
