"""What the page of a sweep says beside its runs: leaderboard, claims, references and facts."""

from __future__ import annotations

import contextlib
import datetime
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from miho.analysis.compare.claims import claims_table, is_on_a_tire
from miho.analysis.compare.comparison import Comparison
from miho.analysis.compare.leaderboard import leaderboard
from miho.analysis.compare.running_time import references
from miho.analysis.pages.sweep_runs import Sweep, environment_table
from miho.analysis.timing import undisturbed
from miho.analysis.variants import base_name

CLAIMS = (
    "The paper's claims; ours with 95 % bootstrap intervals. What decides is written beside each."
)
LEADERBOARD = (
    "By mean rank over problems, by the expected number of evaluations to within 1 % of the best "
    "known error; on a problem where it never gets there, a method is behind all that do. Success: "
    "share of runs within that factor of the best known error. AOCC: area over the convergence "
    "curve, more is better. Times the best: over the problems that a method solves; read it beside "
    "solved. Microseconds: of the {timed} runs that no other work disturbed."
)


@dataclass(frozen=True)
class Contents:
    """What the page says beside the runs: title, facts of its head, further warnings and tables.

    `references` holds the best known error of each problem, in the unit of its runs; of those in
    `unrecorded` no optimum is recorded, so that it is the best of these runs.
    """

    title: str
    facts: Sequence[tuple[str, str]] = ()
    warnings: Sequence[str] = ()
    leaderboard: pd.DataFrame | None = None
    leaderboard_note: str = ""
    claims: pd.DataFrame | None = None
    claims_note: str = ""
    references: Mapping[str, float] = field(default_factory=dict)
    unrecorded: Collection[str] = ()


@dataclass(frozen=True)
class Configured:
    """What a configuration adds to the files of runs; the defaults add nothing.

    `runs` gives the runs of a comparison with the optima and families that are configured now.
    """

    runs: Callable[[pd.DataFrame], pd.DataFrame] = lambda runs: runs


NOTHING_CONFIGURED = Configured()


def contents(
    sweep: Sweep,
    root: Path,
    configured: Configured,
    warnings: Sequence[str] = (),
    made_by: str = "miho.analysis.save_sweep_page",
) -> Contents:
    """The contents for the runs of a root; `made_by` is what writes the page."""
    comparison = Comparison.of(sweep.runs, sweep.curves, root)
    sentences = list(warnings)
    if comparison is not None and comparison.missing:
        sentences.insert(
            0,
            f"Runs of the comparison are missing ({comparison.missing}): run the same command "
            "again.",
        )
    board = claims = None
    try:
        board = _leaderboard(sweep, comparison, configured)
        claims = _claims(sweep, comparison)
    except ValueError as error:
        sentences.append(f"A table is left out: {error}.")
    best_known, unrecorded = _references(sweep.runs)
    return Contents(
        title=f"Runs of {root.resolve().name}",
        facts=_facts(sweep, comparison, made_by),
        warnings=sentences,
        leaderboard=board,
        leaderboard_note=LEADERBOARD.format(timed=_timed(sweep, comparison)),
        claims=claims,
        claims_note=CLAIMS,
        references=best_known,
        unrecorded=unrecorded,
    )


def best_runs(sweep: Sweep) -> dict[str, Path]:
    """The folder of the best run of each problem that has one with a finite error."""
    finite = sweep.runs[sweep.runs["error"].notna()].sort_values("error", kind="stable")
    firsts = finite.drop_duplicates("problem").set_index("problem")["folder"]
    order = [problem for problem in sweep.runs["problem"].unique() if problem in firsts]
    return {str(problem): Path(firsts[problem]) for problem in order}


def _leaderboard(
    sweep: Sweep, comparison: Comparison | None, configured: Configured
) -> pd.DataFrame | None:
    """The leaderboard of the comparison, as its figures have it, or else of all runs."""
    runs, curves = sweep.runs, sweep.curves
    if comparison is not None and len(comparison.runs):
        runs, curves = configured.runs(comparison.runs), comparison.curves
    if runs["problem"].nunique() < 2 or runs["optimizer"].nunique() < 2:
        return None
    return leaderboard(runs, curves)


def _timed(sweep: Sweep, comparison: Comparison | None) -> str:
    """How many runs of the leaderboard were undisturbed, such as "3 of 7"."""
    runs = sweep.runs if comparison is None or comparison.runs.empty else comparison.runs
    return f"{int(undisturbed(runs).sum())} of {len(runs)}"


def _claims(sweep: Sweep, comparison: Comparison | None) -> pd.DataFrame | None:
    """The claims are about MIHO on a tire beside others, and about whole comparisons."""
    runs, curves = sweep.runs, sweep.curves
    if comparison is not None:
        runs, curves = comparison.runs, comparison.curves
        if comparison.missing:
            return None
    several = runs["optimizer"].map(base_name).nunique() > 1
    if runs["problem"].nunique() != 1 or not several or not is_on_a_tire(runs):
        return None
    return claims_table(runs, curves)


def _references(runs: pd.DataFrame) -> tuple[dict[str, float], set[str]]:
    """The best known error of each problem, NaN where it is not above zero.

    Then the problems of which it is that of the best run, since none better is recorded.
    """
    best_known, unrecorded = {}, set()
    for problem, group in runs.groupby("problem", sort=False):
        best_known[str(problem)] = math.nan
        with contextlib.suppress(ValueError):
            row = references(group).iloc[0]
            best_known[str(problem)] = float(row["error"])
            if row["source"] != "known":
                unrecorded.add(str(problem))
    return best_known, unrecorded


def _facts(sweep: Sweep, comparison: Comparison | None, made_by: str) -> list[tuple[str, str]]:
    """What the page's head tells of the runs and of itself."""
    origins = list(sweep.origins.values())
    values = environment_table(origins).groupby("what", sort=False)["value"].agg(" or ".join)
    packages = [key for key in values.index if key.startswith("packages.")]
    versions = [f"Python {values.get('python', '-')}"]
    versions += [f"{key.removeprefix('packages.')} {values[key]}" for key in packages]
    machine = f"{values.get('processor', '-')}, {values.get('cores', '-')} cores"
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC,")
    return [
        *_comparison_facts(comparison),
        ("Measured", str(values.get("time", "-")).replace("T", " ").replace("+00:00", " UTC")),
        ("Machine", f"{machine}, {values.get('system', '-')}"),
        ("Versions", ", ".join(versions)),
        ("Code", _digests([origin.code for origin in origins])),
        ("Data", _digests([origin.data for origin in origins])),
        ("Page", f"{now} by {made_by}"),
    ]


def _comparison_facts(comparison: Comparison | None) -> list[tuple[str, str]]:
    if comparison is None:
        return []
    return [("Command", " ".join(comparison.command)), ("Size", comparison.note)]


def _digests(digests: list[str]) -> str:
    kinds = list(dict.fromkeys(digests))
    return kinds[0][:12] if len(kinds) == 1 else f"{len(kinds)} digests, see Origin"
