"""Contents of a sweep's page in addition to its runs: leaderboard, claims, references and facts."""

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

ROUNDING = 1e-9
CLAIMS = (
    "The paper's claims and our results with 95 % bootstrap intervals. The reason column explains "
    "each verdict."
)
LEADERBOARD = (
    "By mean rank over problems, by the expected number of evaluations to within 1 % of the best "
    "known error; on a problem that it never solves, a method ranks behind all methods that do. "
    "Success: share of runs within that factor of the best known error. AOCC: area over the "
    "convergence curve, more is better. Times the best: over the problems that a method solves; "
    "compare it together with solved. Microseconds: from the {timed} runs that no other work "
    "disturbed."
)


@dataclass(frozen=True)
class Contents:
    """Contents of the page in addition to the runs: title, facts, further warnings and tables.

    `references` are the best known errors of the problems, in the unit of the runs. Problems in
    `unrecorded` have no recorded optimum, so theirs is the best of these runs.
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


Configured = Callable[[pd.DataFrame], pd.DataFrame]
"""Returns the runs of a comparison with the optima and families that are configured now."""


def contents(
    sweep: Sweep,
    root: Path,
    configured: Configured | None,
    warnings: Sequence[str] = (),
    made_by: str = "miho.analysis.save_sweep_page",
) -> Contents:
    """The contents for the runs of a root; `made_by` names the program that writes the page."""
    comparison = Comparison.of(sweep.runs, sweep.curves, root)
    all_runs = Comparison(sweep.runs, sweep.curves, 0, (), "")
    compared = comparison if comparison is not None and len(comparison.runs) else all_runs
    sentences = list(warnings)
    missing = 0 if comparison is None else comparison.missing
    if missing:
        text = f"Runs of the comparison are missing ({missing}): run the same command again."
        sentences.insert(0, text)
    board = claims = None
    try:
        board = _leaderboard(compared, None if compared is all_runs else configured)
        claims = None if missing else _claims(compared)
    except ValueError as error:
        sentences.append(f"A table is missing: {error}.")
    timed = f"{int(undisturbed(compared.runs).sum())} of {len(compared.runs)}"
    best_known, unrecorded = _references(sweep.runs)
    return Contents(
        title=f"Runs of {root.resolve().name}",
        facts=_facts(sweep, comparison, made_by),
        warnings=sentences,
        leaderboard=board,
        leaderboard_note=LEADERBOARD.format(timed=timed),
        claims=claims,
        claims_note=CLAIMS,
        references=best_known,
        unrecorded=unrecorded,
    )


def best_runs(sweep: Sweep) -> dict[str, Path]:
    """The folder of the best run of each problem that has a run with a finite error.

    Of runs whose errors differ by rounding, the best is one with evidence for its optimum.
    """
    finite = sweep.runs[sweep.runs["error"].notna()].sort_values("error", kind="stable")
    least = finite.groupby("problem")["error"].transform("min")
    doubt = (finite["error"] > (1 + ROUNDING) * least) | (finite["outcome"] != "converged")
    finite = finite.loc[doubt.sort_values(kind="stable").index]
    firsts = finite.drop_duplicates("problem").set_index("problem")["folder"]
    order = [problem for problem in sweep.runs["problem"].unique() if problem in firsts]
    return {str(problem): Path(firsts[problem]) for problem in order}


def _leaderboard(compared: Comparison, configured: Configured | None) -> pd.DataFrame | None:
    """The leaderboard, as in the figures of a comparison, if there are several problems."""
    runs = compared.runs if configured is None else configured(compared.runs)
    if runs["problem"].nunique() < 2 or runs["optimizer"].nunique() < 2:
        return None
    return leaderboard(runs, compared.curves)


def _claims(compared: Comparison) -> pd.DataFrame | None:
    """Claims about MIHO and other methods, if all runs are on one tire."""
    runs = compared.runs
    several = runs["optimizer"].map(base_name).nunique() > 1
    if runs["problem"].nunique() != 1 or not several or not is_on_a_tire(runs):
        return None
    return claims_table(runs, compared.curves)


def _references(runs: pd.DataFrame) -> tuple[dict[str, float], set[str]]:
    """The best known error of each problem, NaN if it is not above zero.

    The second value contains the problems whose best known error is the best of these runs.
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
    """Facts about the runs and the page, for its head."""
    origins = list(sweep.origins.values())
    values = environment_table(origins).groupby("what", sort=False)["value"].agg(" or ".join)
    packages = [key for key in values.index if key.startswith("packages.")]
    versions = [f"Python {values.get('python', '-')}"]
    versions += [f"{key.removeprefix('packages.')} {values[key]}" for key in packages]
    machine = f"{values.get('processor', '-')}, {values.get('cores', '-')} cores"
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC,")
    about = []
    if comparison is not None:
        about = [("Command", " ".join(comparison.command)), ("Size", comparison.note)]
    return [
        *about,
        ("Measured", str(values.get("time", "-")).replace("T", " ").replace("+00:00", " UTC")),
        ("Machine", f"{machine}, {values.get('system', '-')}"),
        ("Versions", ", ".join(versions)),
        ("Code", _digests([origin.code for origin in origins])),
        ("Data", _digests([origin.data for origin in origins])),
        ("Page", f"{now} by {made_by}"),
    ]


def _digests(digests: list[str]) -> str:
    kinds = list(dict.fromkeys(digests))
    return kinds[0][:12] if len(kinds) == 1 else f"{len(kinds)} digests, see Origin"
