"""Files after a session, and scores on a stream with known truth, and their comparison."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from baselines.online import Stream, bicycle, tire
from baselines.online.alarms import Watch
from baselines.online.peer import Peer
from experiments.benchmarks.online_methods import CONTENDERS, detectors
from experiments.benchmarks.online_scores import Family, thresholds
from experiments.online.session import STATES
from experiments.online.stored import SHARED, comparable
from miho.analysis import save
from miho.analysis.compare.bootstrap import mean_error
from miho.analysis.figures.house import png
from miho.analysis.figures.tracking import scores_figure, states_figure
from miho.analysis.pages.html import PAGE
from miho.analysis.pages.run import PARAMETERS, Section, page
from miho.analysis.text import csv_text, significant
from miho.models.identified import parameters_text
from miho.online import Alarm, OnlineMethod, Running, Tracker, TrackerState
from miho.online.method import Rows
from miho.quantities import Array
from miho.study import Identity, write_text
from miho.study.provenance import command_line, lasting

FAMILIES: Mapping[str, Family] = {
    "baselines.online.tire": tire,
    "baselines.online.bicycle": bicycle,
}
"""Streams on which alarms are calibrated, by their targets."""
CONTENDER = {"miho": "tracker", "batch": "batch_ls", "lm_window": "lm"}
"""Names in the benchmark of the options of `tracker` that have another name there."""


@dataclass
class Watched(Running):
    """A peer with a calibrated alarm.

    Parameters
    ----------
    peer : Peer
        The run.
    watch : Watch
        Its alarm.
    """

    peer: Peer
    watch: Watch

    def update(self, rows: Rows) -> TrackerState:
        """Take one row, and return the state after it."""
        state = self.peer.update(rows)
        [fired] = self.watch.judge(self.peer, self.watch.statistic(self.peer))
        return replace(state, alarm=self.watch.alarm if fired else None)


def watched(running: Running, name: str, method: OnlineMethod, family: str) -> Running:
    """Return a run of a peer with its quickest calibrated alarm; another run as it is."""
    contender = CONTENDER.get(name, name)
    if not isinstance(running, Peer) or contender not in CONTENDERS or family not in FAMILIES:
        return running
    limits, best = _calibration(contender, method, FAMILIES[family])
    return Watched(running, detectors((best,), limits)[best].watch(running.setup))


@lru_cache
def _calibration(
    contender: str, method: OnlineMethod, family: Family
) -> tuple[Mapping[str, float], str]:
    return thresholds(CONTENDERS[contender], method, family)


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


PROVENANCE = "comparison.json"
STAYING = 1.0
"""Time for which it must stay so [s]."""
CALIBRATED = (
    "The alarm of a peer is at 1.02 times its largest evidence in an hour without a change, on "
    "other seeds."
)
CLOSE = 0.1
"""An estimate that differs by less than this share is close."""


def score(
    root: Path, tracker: str, seed: int, stream: Stream, alarms: Sequence[Alarm]
) -> dict[str, Any]:
    """Return the score of a session: errors, delays and coverage of the watched parameters.

    error is the mean over the rows, in shares of the truth; within_10 [s] is the time after the
    change from which the first parameter that jumps is within 10 % of its new value and stays for
    1 s; alarm [s] is the delay of the first alarm; false_alarms are alarms before the change.
    """
    states = pd.read_csv(root / STATES)
    start = stream.start if stream.start is not None else np.inf
    name = next(iter(stream.changes))
    rows = min(len(states), len(stream))
    truth, value = stream.truth[name][:rows], states[name].to_numpy()[:rows]
    apart = np.abs(value / truth - 1)
    low, high = (states[f"{name}_{end}"].to_numpy()[:rows] for end in ("low", "high"))
    clock = stream.clock[:rows]
    later = clock >= start
    old = np.abs(value / truth[-1] - 1) >= CLOSE
    near = clock[later & ~_soon(old, clock)]
    after = [alarm.time for alarm in alarms if alarm.time >= start]
    return {
        "tracker": tracker,
        "seed": seed,
        "error": float(np.mean(apart)),
        "within_10": float(near[0] - start) if near.size else None,
        "alarm": after[0] - start if after else None,
        "false_alarms": len(alarms) - len(after),
        "coverage": float(np.mean((low <= truth) & (truth <= high))),
    }


def _soon(event: NDArray[np.bool_], clock: Array) -> NDArray[np.bool_]:
    """Whether an event (N,) occurs within `STAYING` after each row."""
    count = np.concatenate([[0], np.cumsum(event)])
    ends = np.searchsorted(clock, clock + STAYING, side="right")
    return count[ends] > count[:-1]


def compare(root: Path, like: Identity) -> None:
    """Write table, figure and origin of the stored scores below a folder that one is `like`."""
    stored, others = comparable(root, like)
    scores = pd.DataFrame([session["score"] for session in stored]).sort_values(["tracker", "seed"])
    write_text(root / "scores.csv", csv_text(scores))
    rng, lines = np.random.default_rng(0), []
    for tracker, group in scores.groupby("tracker"):
        error = mean_error(100 * group["error"].to_numpy(dtype=float), rng)
        lines.append({
            "tracker": tracker,
            "seeds": len(group),
            "error [%]": f"{error.estimate:.2f} [{error.low:.2f}, {error.high:.2f}]",
            "within 10 % [s]": group["within_10"].median(),
            "alarm [s]": group["alarm"].median(),
            "missed": int(group["alarm"].isna().sum()),
            "false alarms": int(group["false_alarms"].sum()),
            "coverage": group["coverage"].mean(),
        })  # fmt: skip
    table = pd.DataFrame(lines).to_string(index=False, float_format="%.2f")
    left = f"\n{others} scores of other code or settings are left out." if others else ""
    write_text(root / "table.txt", f"{table}\n{CALIBRATED}{left}\n")
    save(scores_figure(scores), root / "figures" / "trackers")
    about = {
        "command": command_line("experiments.track"),
        **{name: stored[0][name] for name in SHARED},
        "sessions": [
            {n: session[n] for n in ("optimizer", "seed", "id", "data")} for session in stored
        ],
        "environment": lasting(stored[0]["environment"]),
    }
    write_text(root / PROVENANCE, json.dumps(about, indent=1) + "\n")
