"""Files after a session: parameters, informative rows, figure and page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from experiments.online.session import STATES
from miho.analysis.figures.house import png
from miho.analysis.figures.tracking import states_figure
from miho.analysis.pages.html import PAGE
from miho.analysis.pages.run import PARAMETERS, Section, page
from miho.analysis.text import csv_text, significant
from miho.models.identified import parameters_text
from miho.online import Alarm, Running, Tracker
from miho.study import write_text

INFORMATIVE = "informative_rows.csv"
MOST = 20_000
"""Largest number of states in the figure."""


def write_session(
    root: Path,
    running: Running,
    alarms: Sequence[Alarm],
    words: Sequence[str],
    title: str,
    units: Mapping[str, str],
) -> list[Path]:
    """Write parameters, informative rows and the page of the states so far; return the paths."""
    written = [root / STATES]
    if isinstance(running, Tracker):
        write_text(root / PARAMETERS, parameters_text(running.parameters(), {}))
        written.append(root / PARAMETERS)
        try:
            rows = running.dataset()
        except ValueError:  # no row has informed a parameter yet
            rows = None
        if rows is not None:
            write_text(root / INFORMATIVE, csv_text(pd.DataFrame(dict(rows.columns))))
            written.append(root / INFORMATIVE)
    states = pd.read_csv(root / STATES)
    if len(states) > 1:
        write_text(root / PAGE, session_page(states, alarms, words, title, units))
        written.append(root / PAGE)
    return written


def session_page(
    states: pd.DataFrame,
    alarms: Sequence[Alarm],
    words: Sequence[str],
    title: str,
    units: Mapping[str, str],
) -> str:
    """Return the HTML page of a session: alarms in words, last values, and the figure."""
    names = {n: units.get(n, "") for n in states.columns if f"{n}_low" in states.columns}
    last = states.iloc[-1]
    table = pd.DataFrame({
        "parameter": list(names),
        "value": [significant(float(last[name])) for name in names],
        "low": [significant(float(last[f"{name}_low"])) for name in names],
        "high": [significant(float(last[f"{name}_high"])) for name in names],
        "unit": list(names.values()),
    })  # fmt: skip
    times = {alarm.time: text for alarm, text in zip(alarms, words, strict=True)}
    shown = states.iloc[:: max(1, len(states) // MOST)]
    sections = [
        Section("Alarms", sentences=list(words) or ["No alarm: no watched parameter has changed."]),
        Section("Parameters now", table=table, caption="Intervals of 95 %."),
        Section(
            "Parameters over time", figure=png(states_figure(shown, names, times)),
            caption="Bands are 95 % intervals; red lines are alarms.",
        ),
    ]  # fmt: skip
    subtitle = f"{len(states):,} rows up to {last['time']:.1f} s."
    return page(title, subtitle, sections)
