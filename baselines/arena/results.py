"""Results of an arena: leaderboard, tests and profiles as tables and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from baselines.arena.figures import ecdf_figure, error_curves, ert_table, profiles_figure
from baselines.arena.ranking import area_figure, critical_difference_diagram, speed_up_figure
from miho.analysis.compare.comparison import Comparison, write_origin, write_tables
from miho.analysis.compare.leaderboard import (
    best_rivals,
    families,
    family_scores,
    leaderboard,
    problem_scores,
)
from miho.analysis.compare.profiles import area_over_curve, data_profile, ecdf, performance_profile
from miho.analysis.compare.running_time import (
    NEAR_BEST,
    at_factor,
    expected_running_time,
    hits,
    references,
)
from miho.analysis.compare.significance import (
    FriedmanTest,
    cliques,
    critical_difference,
    friedman,
    pairwise,
    pairwise_speed_up,
    ranks,
)
from miho.analysis.curves import Axis
from miho.analysis.figures.house import save
from miho.analysis.text import csv_text
from miho.analysis.timing import Clock, clock_of, undisturbed
from miho.study import write_text

TESTED = ("miho_gn", "miho")
"""The first of these methods that takes part is tested against every other. It is fixed beforehand,
because the winner of the same runs would look better than it is."""
LEVEL = 0.05
PLAIN, WITH_AREAS = "p (Holm)", "p with AOCC"
WITHIN = (1.0, 2.0, 10.0, 100.0)
LOSSES_ONLY = "miho_qn"
"""The tested method for models that give only losses; it does not count as its rival."""
CLOSE = 1.2
"""Largest ratio of evaluations to the best rival for a method that counts as close."""
PAGE = 18
"""Problems per page: the largest number of readable columns of running times."""
CAPTIONS = {
    "leaderboard": "Methods by mean rank over {problems} problems, by the expected number of "
    "evaluations to within 1 % of the best known error; a gradient is charged as many evaluations "
    "as there are parameters. On a problem that it never solves, a method ranks behind all methods "
    "that do, by its area over the convergence curve. By families: the rank over {families} "
    "families of problems (one model in one kind of box, or one published formula), by the mean "
    "logarithm of the same numbers. Success: share of runs. Cut by seconds: share of runs that the "
    "time limit ended before they converged or used their evaluations. Microseconds: from the "
    "{timed} of {runs} runs that no other work disturbed.",
    "problems": "The problems: family (one model in one kind of box, or one published formula), "
    "parameters, best known error, and how many of the methods came within 1 % of it at least "
    "once.",
    "profiles": "Performance profile: share of problems on which a method's expected number of "
    "evaluations to within 1 % is at most so many times that of the best method.",
    "best_rivals": "{method} against the best rival of each problem, chosen afterwards: expected "
    "evaluations and {unit} to within 1 % of the best known error, and the ratio to that rival. "
    "In evaluations it is ahead on {ahead} of {problems} problems, and on {within} it needs at "
    "most {close:g} times as many; in {unit} it is ahead on {sooner}.",
    "tests": "{method} against each rival by the expected number of evaluations: problems won and "
    "lost, and Wilcoxon's signed-rank test over problems (N = {problems}) with Holm's correction. "
    "A problem that neither solves is a tie, because there is no running time to compare. This p "
    "separates {method} from {apart} of {rivals} rivals at 5 %. If the area over the convergence "
    "curve breaks these ties, as in the ranks of the leaderboard (p with AOCC), p separates it "
    "from {apart_aocc}. Problems of one family are similar and not an independent sample, so the "
    "same test over families (N = {families}) is shown as well; its p cannot be below {least:.2g} "
    "after the correction. Speed-up: how many times faster {method} is on the problems that both "
    "solve, with a 95 % interval over families and runs.",
}


class TooFewError(ValueError):
    """An arena has fewer methods or problems than its tests need."""


@dataclass(frozen=True, eq=False)
class ArenaResults:
    """Numbers of the tables and figures of an arena.

    Attributes
    ----------
    comparison : Comparison
        The runs and curves.
    clock : Clock
        The runs that may be compared in seconds.
    hits, ert : mapping of Axis to DataFrame
        When runs reached multiples of the best known error, and expected running times, by
        evaluations and by the axis of the clock.
    areas : DataFrame
        Areas over the convergence curves.
    families : mapping of str to str
        Family of each problem.
    scores, family_scores : DataFrame
        A score of each method on each problem or family of problems; lower is better.
    friedman : mapping of str to FriedmanTest
        Friedman's test over problems and over families.
    order : DataFrame
        The methods by mean rank over problems.
    speed_ups : DataFrame
        Speed-ups of all pairs of methods.
    tested : str or None
        The method that is tested against every other.
    """

    comparison: Comparison
    clock: Clock
    hits: Mapping[Axis, pd.DataFrame]
    ert: Mapping[Axis, pd.DataFrame]
    areas: pd.DataFrame
    families: Mapping[str, str]
    scores: pd.DataFrame
    family_scores: pd.DataFrame
    friedman: Mapping[str, FriedmanTest]
    order: pd.DataFrame
    speed_ups: pd.DataFrame
    tested: str | None

    @classmethod
    def of(cls, comparison: Comparison) -> ArenaResults:
        """Results of a comparison whose runs have the columns `family` and `cut`.

        Bootstrap replicates are drawn with seed 0. Raises TooFewError if there are too few methods
        or problems for Friedman's test.
        """
        runs, curves, rng = comparison.runs, comparison.curves, np.random.default_rng(0)
        reached = hits(runs, curves)
        clock = clock_of(runs)
        on_axes: dict[Axis, pd.DataFrame] = {
            "evaluations": reached,
            clock.axis: _on_the_clock(clock, reached),
        }
        ert = {axis: expected_running_time(rows, axis, rng) for axis, rows in on_axes.items()}
        areas = area_over_curve(runs, curves)
        scores = problem_scores(ert["evaluations"], areas, NEAR_BEST)
        family_of = families(runs)
        by_family = family_scores(scores, family_of)
        try:
            tests = {"problems": friedman(scores), "families": friedman(by_family)}
        except ValueError as error:
            raise TooFewError(str(error)) from None
        speed_ups = pairwise_speed_up(reached, NEAR_BEST, "evaluations", rng, families=family_of)
        methods = set(runs["optimizer"])
        tested = next((name for name in TESTED if name in methods), None)
        return cls(
            comparison, clock, on_axes, ert, areas, family_of, scores, by_family, tests,
            ranks(scores), speed_ups, tested,
        )  # fmt: skip


def write_arena(results: ArenaResults, output: Path) -> tuple[str, list[Path]]:
    """Write all tables and figures of an arena, and their origin.

    Returns the tables and tests as text, and all paths.
    """
    tables, captions = arena_tables(results)
    texts, paths = write_tables(results.comparison, tables, captions, output)
    texts += [_friedman(test, groups) for groups, test in results.friedman.items()]
    whole = pd.concat([frame.assign(axis=axis) for axis, frame in results.ert.items()])
    frames = {"ert": whole, "speed_up": results.speed_ups, "aocc": results.areas}
    for name, frame in frames.items():
        write_text(output / f"{name}.csv", csv_text(frame))
    for name, figure in arena_figures(results).items():
        paths += save(figure, output / name)
    csv = [output / f"{name}.csv" for name in frames]
    return "\n".join(texts), [*paths, *csv, write_origin(results.comparison, output)]


def arena_tables(results: ArenaResults) -> tuple[dict[str, pd.DataFrame], dict[str, str]]:
    """Tables of an arena and their captions, by name."""
    runs, ert = results.comparison.runs, results.ert["evaluations"]
    tables = {
        "problems": _problems(runs, results.hits["evaluations"]),
        "profiles": _profiles(ert),
        "leaderboard": leaderboard(runs, results.comparison.curves),
    }
    method, problems = results.tested, len(results.scores)
    facts: dict[str, object] = {"method": method, "unit": results.clock.unit, "close": CLOSE}
    if method is not None:
        plain = problem_scores(ert, None, NEAR_BEST)
        tables["tests"] = head_to_head(
            method, plain, results.scores, results.families, results.speed_ups
        )
        rivals = {
            axis: rows[rows["optimizer"] != LOSSES_ONLY] for axis, rows in results.ert.items()
        }
        tables["best_rivals"] = best_rivals(rivals, method, NEAR_BEST)
        facts |= separation(tables["tests"]) | lead(tables["best_rivals"])
    by_family = len(results.family_scores)
    # The smallest p of a signed-rank test over N families is 2^(1 - N), times Holm's rivals.
    least = min(1.0, (len(results.order) - 1) * 2.0 ** (1 - by_family))
    facts |= {"problems": problems, "families": by_family, "least": least}
    facts["timed"], facts["runs"] = int(undisturbed(runs).sum()), len(runs)
    return tables, {name: CAPTIONS[name].format(**facts) for name in tables}


def arena_figures(results: ArenaResults) -> dict[str, Figure]:
    """Figures of an arena, by name."""
    runs, curves, note = (
        results.comparison.runs, results.comparison.curves, results.comparison.note
    )  # fmt: skip
    ert, order, clock = results.ert["evaluations"], results.order, results.clock
    reached, timed = results.hits["evaluations"], results.hits[clock.axis]
    dimensions = dict(zip(runs["problem"], runs["dimension"], strict=True))
    problems = len(results.scores)
    difference = critical_difference(len(order), problems)
    figures = {
        f"error_curves{page}": error_curves(*_on(names, runs, curves), note=note)
        for page, names in pages(runs["problem"]).items()
    }
    figures |= {
        f"ert{page}": ert_table(*_on(names, ert), factor=NEAR_BEST, order=order, note=note)
        for page, names in pages(ert["problem"]).items()
    }
    figures |= {
        "ecdf": ecdf_figure(
            ecdf(reached, "evaluations"), ecdf(timed, clock.axis), clock, note=note
        ),
        "profiles": profiles_figure(
            data_profile(reached, dimensions, NEAR_BEST),
            performance_profile(ert, NEAR_BEST),
            note=note,
        ),
        "aocc": area_figure(results.areas, note=note),
        "ranks": critical_difference_diagram(
            order, difference, cliques(order, difference), sample=f"{problems} problems", note=note
        ),
    }
    if results.tested is not None:
        figures["speed_up"] = speed_up_figure(results.speed_ups, method=results.tested, note=note)
    return figures


def _on(problems: Sequence[str], *frames: pd.DataFrame) -> list[pd.DataFrame]:
    """The rows of these problems."""
    return [frame[frame["problem"].isin(problems)] for frame in frames]


def pages(problems: pd.Series) -> dict[str, list[str]]:
    """Problems in their order, split into pages, by the suffix of a file's name.

    The first page has no suffix; then follow _2, _3, ...
    """
    names = list(dict.fromkeys(problems))
    number = -(-len(names) // PAGE)
    parts = np.array_split(np.array(names, dtype=object), number)
    return {"" if k == 0 else f"_{k + 1}": part.tolist() for k, part in enumerate(parts)}


def _on_the_clock(clock: Clock, reached: pd.DataFrame) -> pd.DataFrame:
    """Hits of the seeds that may be compared on the clock."""
    comparable = pd.MultiIndex.from_frame(clock.runs[["problem", "seed"]])
    return reached[pd.MultiIndex.from_frame(reached[["problem", "seed"]]).isin(comparable)]


def _problems(runs: pd.DataFrame, reached: pd.DataFrame) -> pd.DataFrame:
    best_known = references(runs)
    first = runs.groupby("problem", sort=False).first()
    solved = at_factor(reached, NEAR_BEST)
    methods = solved[solved["reached"]].groupby("problem")["optimizer"].nunique()
    return pd.DataFrame(
        {
            "problem": first.index,
            "family": first["family"].to_numpy(),
            "parameters": first["dimension"].astype(int).to_numpy(),
            "best known error": best_known["error"].reindex(first.index).to_numpy(),
            "unit": first["unit"].to_numpy(),
            "from": best_known["source"].reindex(first.index).to_numpy(),
            "solved by": methods.reindex(first.index).fillna(0).astype(int).to_numpy(),
        }
    )


def _profiles(ert: pd.DataFrame) -> pd.DataFrame:
    profile = performance_profile(ert, NEAR_BEST, np.array(WITHIN))
    table = profile.pivot(index="optimizer", columns="tau", values="share")
    table.columns = ["fastest", *(f"within {tau:g}×" for tau in WITHIN[1:])]
    ordered = table.sort_values(list(table.columns[::-1]), ascending=False, kind="stable")
    return ordered.rename_axis("method").reset_index()


def head_to_head(
    method: str,
    plain: pd.DataFrame,
    with_areas: pd.DataFrame,
    family_of: Mapping[str, str],
    speed_ups: pd.DataFrame,
) -> pd.DataFrame:
    """A method against each rival, by scores without and with the tie-break of `problem_scores`."""
    ranked = pairwise(with_areas, method)[["rival", "p_holm"]]
    strict = pairwise(family_scores(plain, family_of), method)[["rival", "p_holm"]]
    ranked = ranked.rename(columns={"p_holm": WITH_AREAS})
    strict = strict.rename(columns={"p_holm": "p by families"})
    faster = speed_ups[speed_ups["method"] == method]
    table = pairwise(plain, method).merge(ranked, on="rival").merge(strict, on="rival")
    table = table.merge(faster, on=["method", "rival"])
    table["speed-up"] = [
        f"{row.ratio:.3g}× [{row.low:.3g}, {row.high:.3g}]" if row.problems else "-"
        for row in table.itertuples()
    ]
    columns = ["rival", "wins", "losses", "p_holm", WITH_AREAS, "p by families", "effect"]
    columns += ["speed-up", "problems", "only_method", "only_rival"]
    names = {"p_holm": PLAIN, "problems": "on problems"}
    names |= {"only_method": "only the method solves", "only_rival": "only the rival solves"}
    return table[columns].rename(columns=names)


def separation(tests: pd.DataFrame) -> dict[str, int]:
    """Number of rivals, and number of rivals that the tests separate from the method at 5 %."""
    plain, with_areas = (int((tests[name] < LEVEL).sum()) for name in (PLAIN, WITH_AREAS))
    return {"rivals": len(tests), "apart": plain, "apart_aocc": with_areas}


def lead(table: pd.DataFrame) -> dict[str, int]:
    """Number of problems of `best_rivals` where the method is ahead of the best rival."""
    evaluations, seconds = (table[name] for name in table.columns if name.startswith("share"))
    return {
        "ahead": int((evaluations < 1).sum()),
        "within": int((evaluations <= CLOSE).sum()),
        "sooner": int((seconds < 1).sum()),
    }


def _friedman(test: FriedmanTest, groups: str) -> str:
    difference = critical_difference(test.methods, test.problems)
    return (
        f"Friedman's test over {test.problems} {groups} and {test.methods} methods: "
        f"chi2 = {test.chi2:.1f}, F = {test.f:.2f}, p = {test.p:.2g}; two mean ranks differ at 5 % "
        f"if they are {difference:.2f} apart (Nemenyi).\n"
    )
