"""The paper's comparison under different readings of unspecified settings: claims and figure."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from miho.analysis.compare.bootstrap import RESAMPLES, MeanCurve
from miho.analysis.compare.claims import claims_table
from miho.analysis.compare.size import PAPER
from miho.analysis.compare.verdict import NOT_REPRODUCED, REPRODUCED
from miho.analysis.curves import log_grid
from miho.analysis.figures.house import caption, new_figure
from miho.analysis.figures.paper import plain_log_ticks, plot_error_over
from miho.analysis.styles import styles_of

DESCENTS = ("gbo_small", "gbo_large")
SLOW = 1000.0
"""The larger of the errors [N] of the paper's speed-ups."""
COLUMNS = (
    ("to 1.0 kN, in evaluations", "13× to 1.0 kN, evaluations"),
    ("to 1.0 kN, in interpreted seconds", "13× to 1.0 kN, interpreted"),
    ("to 0.5 kN, in evaluations", "494× to 0.5 kN, evaluations"),
    ("to 0.5 kN, in interpreted seconds", "494× to 0.5 kN, interpreted"),
    ("terminal error of MIHO", "MIHO ends at 0.39 kN"),
    ("below pso_500", "24 % below PSO-500"),
    ("below gbo_large", "76 % below GBO-large"),
    ("pso_100 stops", "PSO-100 stays at 0.75 kN"),
    ("gbo_small hardly moves", "GBO-small: < 10 %"),
)
"""Words of a claim, and the column of the short table that contains it."""


@dataclass(frozen=True)
class Reading:
    """A reading of the settings that the paper does not specify (Sec. V-A.3).

    Attributes
    ----------
    words : str
        Description for tables and figures.
    methods : mapping of str to str
        For each method of the paper, for example "pso_100", the stored method that represents it.
    """

    words: str
    methods: Mapping[str, str]


def frames_of(
    reading: Reading, runs: pd.DataFrame, curves: pd.DataFrame, target: float
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The runs and curves of one reading, under the paper's names of the methods.

    A run that stopped at an error of at most `target` [N] counts as ended by itself, because it
    cannot gain anything. Gradient descent that ended after its last step counts as cut if its mean
    error fell by more than 1 % in the second half of its steps.

    Raises
    ------
    ValueError
        If `runs` lacks one of the stored methods.
    """
    missing = sorted(set(reading.methods.values()) - set(runs["optimizer"]))
    if missing:
        raise ValueError(f"there are no runs of {', '.join(missing)}; expected runs with all seeds")
    names = {stored: paper for paper, stored in reading.methods.items()}
    of_reading = [
        frame[frame["optimizer"].isin(names)].assign(
            optimizer=lambda rows: rows["optimizer"].map(names)
        )
        for frame in (runs, curves)
    ]
    runs, curves = of_reading
    runs.loc[runs["error"] <= target, "outcome"] = "converged"
    for method in DESCENTS:
        descents = runs["optimizer"] == method
        cut = runs.assign(outcome="budget")
        seeds = list(runs.loc[descents, "seed"])
        if MeanCurve.of(cut, curves, method, "evaluations", seeds).still_falling():
            runs.loc[descents, "outcome"] = "budget"
    return runs, curves


def in_seconds(frame: pd.DataFrame, costs: Mapping[str, float]) -> pd.DataFrame:
    """`frame` of runs or curves with seconds of evaluations times `costs` [s] by method.

    Information on the original clock is dropped.
    """
    seconds = frame["evaluations"] * frame["optimizer"].map(costs)
    return frame.drop(columns="timing_valid", errors="ignore").assign(seconds=seconds)


def reading_claims(
    runs: pd.DataFrame,
    curves: pd.DataFrame,
    costs: Mapping[str, Mapping[str, float]],
    resamples: int = RESAMPLES,
) -> pd.DataFrame:
    """`claims_table` of one reading, with rows for the seconds of each kind of cost.

    A reading represents the paper's methods at their size, whatever its settings. The frames are as
    from `frames_of`. `costs` has, for each kind, for example "interpreted", the seconds of an
    evaluation of each method.
    """
    tables, of_speeds = [], without_slow_descents(runs, curves)
    for kind, seconds in costs.items():
        for frame in (of_speeds, runs):
            timed = in_seconds(frame, seconds), in_seconds(curves, seconds)
            table = claims_table(*timed, settings=PAPER, resamples=resamples)
            of_speed = table["claim"].str.contains(" is faster than ")
            table = table[of_speed if frame is of_speeds else ~of_speed]
            renamed = table["claim"].str.replace("in seconds", f"in {kind} seconds")
            tables.append(table.assign(claim=renamed))
    return pd.concat(tables).drop_duplicates("claim", ignore_index=True)


def without_slow_descents(runs: pd.DataFrame, curves: pd.DataFrame) -> pd.DataFrame:
    """`runs` in which gradient descent counts as ended if it could not reach the target in time.

    It makes fewer steps than a swarm makes evaluations, so its end would bound all speed-ups. It
    counts as ended if, at the pace of its second half, which is faster than any later pace, its
    mean error would stay above `SLOW` until the end of the longest run.
    """
    runs, longest = runs.copy(), runs["evaluations"].max()
    for method in DESCENTS:
        descents = runs["optimizer"] == method
        curve = MeanCurve.of(runs, curves, method, "evaluations", list(runs.loc[descents, "seed"]))
        end = curve.ends.max()
        half, last = (curve.errors[:, curve.at <= at][:, -1].mean() for at in (end / 2, end))
        if last - (half - last) * (longest - end) / (end / 2) > SLOW:
            runs.loc[descents, "outcome"] = "converged"
    return runs


def short_table(claims: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """A row per reading with measured estimates and the number of reproduced claims.

    An estimate is bold if the claim is reproduced, and in italics if that depends on something that
    was not tested, for example a longer budget. The last column counts the seven claims, with
    speed-ups in evaluations.
    """
    rows = []
    for words, table in claims.items():
        row, reproduced = {"reading": words}, 0
        for claim, column in COLUMNS:
            match = table[table["claim"].str.contains(claim, regex=False)].iloc[0]
            row[column] = _marked(match["ours"].partition(" [")[0], match["verdict"])
            counts = "interpreted" not in column
            reproduced += counts and match["verdict"] == REPRODUCED
        rows.append({**row, "reproduced of 7": str(reproduced)})
    return pd.DataFrame(rows)


def _marked(estimate: str, word: str) -> str:
    if word == REPRODUCED:
        return f"**{estimate}**"
    return estimate if word == NOT_REPRODUCED else f"*{estimate}*"


def long_table(claims: Mapping[str, pd.DataFrame], order: Sequence[str]) -> pd.DataFrame:
    """All claims of all readings, a row each, in this order of the readings."""
    return pd.concat([claims[words].assign(reading=words) for words in order], ignore_index=True)[
        ["reading", "claim", "paper", "ours", "repetitions", "verdict", "reason"]
    ]


PANELS_IN_A_ROW = 3
TITLE_WIDTH = 34


def readings_figure(readings: Mapping[str, pd.DataFrame], *, note: str = "") -> Figure:
    """Mean error of the paper's five methods over evaluations, a panel per reading.

    `readings` has the curves of each reading by its words, as from
    `baselines.arena.readings.frames_of`. Errors are in N and drawn in kN.
    """
    rows = -(-len(readings) // PANELS_IN_A_ROW)
    curves = pd.concat(readings.values(), ignore_index=True)
    grid = log_grid(curves, "evaluations", 250)
    with new_figure(0.6 + 1.75 * rows) as figure:
        panels = figure.subplots(rows, PANELS_IN_A_ROW, sharex=True, sharey=True, squeeze=False)
        axes = list(panels.flat)
        for ax, (words, of_reading) in zip(axes, readings.items(), strict=False):
            plot_error_over(of_reading, "evaluations", ax, grid=grid)
            ax.set_title(textwrap.fill(words, TITLE_WIDTH), loc="left", fontsize=8)
            for level in (0.5, 1.0):
                ax.axhline(level, color="#888888", linewidth=0.6, linestyle=":")
            ax.set(xlabel="", ylabel="")
            plain_log_ticks(ax.yaxis)
        for ax in axes[: len(readings)][-PANELS_IN_A_ROW:]:
            ax.tick_params(labelbottom=True)
            ax.set_xlabel("evaluations of the full loss", fontsize=8)
        for ax in axes[len(readings) :]:
            ax.set_visible(False)
        figure.supylabel("mean error [kN]", fontsize=9)
        styles = styles_of(curves["optimizer"])
        handles = [Line2D([], [], label=style.name, **style.line) for style in styles.values()]
        figure.legend(handles=handles, loc="outside upper left", ncols=len(handles))
        caption(figure, "lines: mean over repetitions, bands: 10 to 90 %", note)
    return figure
