"""The page of all runs below a root: what experiments know of them beside their files."""

from __future__ import annotations

import contextlib
import datetime
import json
import math
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from experiments.app.build import ConfigError
from experiments.arena_problems import as_configured
from experiments.comparison import COMPARISON
from experiments.full_size import differences
from miho.analysis import claims_table, leaderboard
from miho.analysis.running_time import references
from miho.analysis.sweep_origins import environment_table
from miho.analysis.sweep_page import Best, Told, sweep_page
from miho.analysis.sweep_runs import Sweep
from miho.analysis.timing import undisturbed
from miho.study import load_runs, write_text
from miho.study.manifest import missing_runs

MIHO = "miho"
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
class Compared:
    """The comparison that a root holds: its runs, of which some may be missing, and its words."""

    runs: pd.DataFrame
    curves: pd.DataFrame
    missing: int
    command: str
    note: str

    @classmethod
    def of(cls, sweep: Sweep, root: Path) -> Compared | None:
        """The last comparison below the root; None if there was none, or if its file is none."""
        try:
            about = json.loads((root / COMPARISON).read_text(encoding="utf-8"))
            planned = set(map(str, about["runs"]))
            command, note = " ".join(map(str, about["command"])), str(about["note"])
        except (FileNotFoundError, ValueError, LookupError, TypeError):
            return None
        runs = sweep.runs[sweep.runs["id"].isin(planned)]
        curves = sweep.curves[sweep.curves["id"].isin(planned)]
        return cls(runs, curves, len(planned) - len(runs), command, note)


def read_sweep(root: Path) -> Sweep:
    """All runs of a root; folders are told from the root on."""
    found = load_runs(root)
    if found.runs.empty:
        raise ConfigError(f"{root}: holds no finished run; run python -m experiments.identify")
    count = len(found.runs)
    if not sys.stderr.isatty():
        print(f"report of {count:,} runs: running", file=sys.stderr, flush=True)
    with tqdm(total=count, desc="reading runs", leave=False, disable=None) as bar:

        def each() -> None:
            bar.update()

        sweep = Sweep.of(found, each)
    if sweep.runs.empty:
        raise ConfigError(f"{root}: none of its {count} runs can be read; identify again")
    inside = sweep.damaged.map(lambda text: str(text).replace(f"{root}{os.sep}", ""))
    return replace(sweep, damaged=inside)


def best_runs(sweep: Sweep) -> dict[str, Path]:
    """The folder of the best run of each problem that has one with a finite error."""
    finite = sweep.runs[sweep.runs["error"].notna()].sort_values("error", kind="stable")
    firsts = finite.drop_duplicates("problem").set_index("problem")["folder"]
    order = [problem for problem in sweep.runs["problem"].unique() if problem in firsts]
    return {str(problem): Path(firsts[problem]) for problem in order}


def write_sweep(sweep: Sweep, root: Path, path: Path, best: Mapping[str, Best]) -> Path:
    """Write the page of the runs of a root; its path."""
    told = _told(sweep, root)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, sweep_page(sweep, told, best))
    return path


def _told(sweep: Sweep, root: Path) -> Told:
    compared = Compared.of(sweep, root)
    warnings = []
    if compared is not None and compared.missing:
        warnings.append(
            f"Runs of the comparison are missing ({compared.missing}): run the same command again."
        )
    missing = missing_runs(root)
    if missing is not None:
        print(missing, file=sys.stderr)
        warnings.append(f"{missing}.".replace(f"{root}{os.sep}", ""))
    board = claims = None
    try:
        board = _leaderboard(sweep, compared)
        claims = _claims(compared)
    except ValueError as error:
        warnings.append(f"A table is left out: {error}.")
    name = root.resolve().name
    known, unrecorded = _references(sweep.runs)
    return Told(
        title=f"Runs of {name}",
        facts=_facts(sweep, compared, name),
        warnings=warnings,
        leaderboard=board,
        leaderboard_note=LEADERBOARD.format(timed=_timed(sweep, compared)),
        claims=claims,
        claims_note=CLAIMS,
        references=known,
        unrecorded=unrecorded,
    )


def _leaderboard(sweep: Sweep, compared: Compared | None) -> pd.DataFrame | None:
    """Of the comparison where there is one, as its own figures have it; else of all runs."""
    runs, curves = sweep.runs, sweep.curves
    if compared is not None and len(compared.runs):
        runs, curves = as_configured(compared.runs), compared.curves
    if runs["problem"].nunique() < 2 or runs["optimizer"].nunique() < 2:
        return None
    return leaderboard(runs, curves)


def _timed(sweep: Sweep, compared: Compared | None) -> str:
    """Such as "3 of 7"; of the runs of the leaderboard."""
    runs = sweep.runs if compared is None or compared.runs.empty else compared.runs
    return f"{int(undisturbed(runs).sum())} of {len(runs)}"


def _claims(compared: Compared | None) -> pd.DataFrame | None:
    """The claims are about MIHO on a tire, and about whole comparisons."""
    if compared is None or compared.missing or compared.runs["problem"].nunique() != 1:
        return None
    on_a_tire = compared.runs["problem"].str.startswith("pacejka-tire_").all()
    if not on_a_tire or MIHO not in set(compared.runs["optimizer"]):
        return None
    known = differences(compared.runs)
    return claims_table(compared.runs, compared.curves, MIHO, differences=known)


def _references(runs: pd.DataFrame) -> tuple[dict[str, float], set[str]]:
    """The best known error of each problem, NaN where it is not above zero.

    Then the problems of which it is that of the best run, since none better is recorded.
    """
    known, unrecorded = {}, set()
    for problem, mine in runs.groupby("problem", sort=False):
        known[str(problem)] = math.nan
        with contextlib.suppress(ValueError):
            row = references(mine).iloc[0]
            known[str(problem)] = float(row["error"])
            if row["source"] != "known":
                unrecorded.add(str(problem))
    return known, unrecorded


def _facts(sweep: Sweep, compared: Compared | None, name: str) -> list[tuple[str, str]]:
    """What the page's head tells of the runs and of itself."""
    origins = list(sweep.origins.values())
    found = environment_table(origins).groupby("what", sort=False)["value"].agg(" or ".join)
    packages = [key for key in found.index if key.startswith("packages.")]
    versions = [f"Python {found.get('python', '-')}"]
    versions += [f"{key.removeprefix('packages.')} {found[key]}" for key in packages]
    machine = f"{found.get('processor', '-')}, {found.get('cores', '-')} cores"
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC,")
    quick = [argument for argument in sys.argv[1:] if argument.startswith("--")]
    return [
        *([("Command", compared.command), ("Size", compared.note)] if compared else []),
        ("Measured", str(found.get("time", "-")).replace("T", " ").replace("+00:00", " UTC")),
        ("Machine", f"{machine}, {found.get('system', '-')}"),
        ("Versions", ", ".join(versions)),
        ("Code", _digests([origin.code for origin in origins])),
        ("Data", _digests([origin.data for origin in origins])),
        ("Page", " ".join([now, "by python -m experiments.report", name, *quick])),
    ]


def _digests(digests: list[str]) -> str:
    kinds = list(dict.fromkeys(digests))
    return kinds[0][:12] if len(kinds) == 1 else f"{len(kinds)} digests, see Origin"
