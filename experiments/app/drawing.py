"""Figures of the paper and of an arena, drawn from the runs of a root."""

import math
import shlex
import sys
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from baselines.arena.results import ArenaResults, TooFewError, write_arena
from experiments.app.build import ConfigError, build_dataset, rebuild
from experiments.app.configured import as_configured
from experiments.app.explain import as_config_error
from experiments.app.front_axle import FrontAxle, facts, verdict
from experiments.app.options import options_of
from experiments.app.run_text import table_text
from miho.analysis import claims_table, fig4, fig5, fig6, results_table, save
from miho.analysis.compare.claims import is_on_a_tire
from miho.analysis.compare.comparison import Comparison, write_origin, write_tables
from miho.analysis.compare.size import PAPER_METHODS, Methods, chosen
from miho.analysis.figures.paper import AxleCurve, fig4_right
from miho.analysis.timing import clock_of
from miho.analysis.variants import base_name, named_apart
from miho.data import Dataset
from miho.study import StoredRun, load_runs, read_run
from miho.study.index import without_runs
from miho.study.manifest import missing_runs, sweep_commands, without_result
from miho.study.provenance import IDENTITY, command_line, write_provenance
from miho.vehicle.driving.assembly.engine import DATASETS, engine_of, fig5_data
from miho.vehicle.models import Axle

TIRES = ("lf", "rf", "lr", "rr")
HALF = np.array([1.0, 1.0, 0.5, 1.0, 0.5])
"""Factors from the curve (B, C, D, Sx, Sy) of an axle to the curve of one of two equal tires."""
LEFT_OUT = ("best [", "worst [", "reason")
"""First words of columns that only the files of a table have."""
CAPTIONS = {
    "results": "Evaluations and seconds are medians over repetitions; never: half of them or more "
    "did not get there. Success: share of runs within 1 % of the best error.",
    "claims": "The paper's claims; ours with 95 % bootstrap intervals.",
}


def read_comparison(root: Path) -> Comparison:
    """Read the last arena below `root`; raise ConfigError if it is missing or incomplete."""
    stored = load_runs(root)
    comparison = Comparison.of(stored.runs, stored.curves, root)
    if comparison is None:
        raise ConfigError(
            f"{root}: holds no arena; run python -m experiments.compare experiment=arena_small "
            f"{_at(root)} first"
        )
    if comparison.missing:
        raise ConfigError(
            f"{root}: runs of the comparison are missing ({comparison.missing}); compare again"
        )
    return comparison


def draw_arena(root: Path, output: Path, folder: Path | None = None) -> list[Path]:
    """Draw all tables and figures of the last arena below `root`, and print the tables.

    Problems are in conf/, in the command's --config-dir, and in `folder`. Raises ConfigError if the
    arena is too small for its tests.
    """
    comparison = read_comparison(root)
    with as_config_error(str(root), TooFewError):
        results = ArenaResults.of(replace(comparison, runs=as_configured(comparison.runs, folder)))
    text, paths = write_arena(results, output)
    print(text)
    return paths


def draw_comparison(
    root: Path,
    output: Path,
    *,
    methods: Methods | None = None,
    problem: str | None = None,
    ids: Collection[str] | None = None,
    command: Sequence[str] = (),
) -> list[Path]:
    """Draw Fig. 6, the results table, the table of the paper's claims, and their provenance.

    The runs are on the only problem of a root, or on `problem`; `ids` and `methods` select some of
    them. `command` is the command that made them, by default the sweeps of the root. The claims are
    about MIHO on a tire; their table is left out without MIHO or without a tire.
    """
    if message := missing_runs(root, problem):
        print(message, file=sys.stderr)
    runs, curves = compared(root, methods, problem, ids)
    sweeps = [" ".join(command)] if command else _made_by(root, runs)
    made_by = " && ".join(sweeps) or command_line("experiments.figures")
    comparison = Comparison.of_stored(runs, curves, [made_by])
    if ids is None and (lacking := _lacking(root, problem, methods)):
        comparison = replace(comparison, note=f"{comparison.note}, {lacking}")
    runs, note = comparison.runs, comparison.note
    title = runs["problem"].iloc[0]
    paths = save(fig6(runs, curves, note=f"{title}: {note}"), output / "fig6")
    of_paper = is_on_a_tire(runs)
    tables = {"results": results_table(runs, curves, targets=None if of_paper else ())}
    if of_paper:
        tables["claims"] = claims_table(runs, curves)
    _, table_paths = write_tables(comparison, tables, CAPTIONS, output)
    for name, table in tables.items():
        shown = table[[column for column in table if not str(column).startswith(LEFT_OUT)]]
        print(f"{CAPTIONS[name]} Runs: {comparison.note}.\n\n{table_text(shown)}\n")
    if advice := clock_of(runs).advice(sweeps):
        print(advice, file=sys.stderr)
    for method in stuck(curves):
        name, settings = base_name(method), "its settings may not suit this problem"
        if name in options_of("optimizer"):
            settings += f": python -m experiments.identify optimizer={name} --help"
        print(f"{method}: no run improved its first error by 1 %; {settings}", file=sys.stderr)
    return [*paths, *table_paths, write_origin(comparison, output)]


def _lacking(root: Path, problem: str | None, methods: Methods | None) -> str:
    """The planned runs without a result by method, as "without a result: 2 runs of random"."""
    folders, _ = without_result(root, problem)
    counts = Counter(folder.parent.name for folder in folders)
    if methods is not None:
        names = PAPER_METHODS if methods == "paper" else {base_name(name) for name in methods}
        counts = Counter({name: counts[name] for name in names if name in counts})
    runs = [f"{n:,} run{'s' * (n > 1)} of {name}" for name, n in sorted(counts.items())]
    return f"without a result: {', '.join(runs)}" if runs else ""


def stuck(curves: pd.DataFrame) -> list[str]:
    """Methods of which no run is 1 % better than its first error or within 1 % of the best."""
    ends = curves.groupby(["optimizer", "id"])["error"].agg(["first", "last"])
    moved = (ends["last"] < 0.99 * ends["first"]) | (ends["last"] < 1.01 * ends["last"].min())
    return [str(method) for method, any_run in moved.groupby(level=0).any().items() if not any_run]


def compared(
    root: Path,
    methods: Methods | None = None,
    problem: str | None = None,
    ids: Collection[str] | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Runs and curves of a root that one figure compares, selected as in `draw_comparison`.

    Raises ConfigError if there are none, if they are on several problems, or of one method only.
    """
    stored = load_runs(root)
    if damaged := len(stored.damaged):
        print(
            f"{root}: {damaged} damaged run{'s are' if damaged > 1 else ' is'} left out; "
            f"python -m experiments.doctor {shlex.quote(str(root))} gives the reasons",
            file=sys.stderr,
        )
    runs = stored.runs if ids is None else stored.runs[stored.runs["id"].isin(ids)]
    problems = sorted(map(str, runs["problem"].unique()))
    if not problems:
        raise ConfigError(without_runs(root))
    if problem is not None and problem not in problems:
        raise ConfigError(f"problem: is {problem}, but {root} has no runs on it; {_of(problems)}")
    if problem is None and len(problems) != 1:
        raise ConfigError(
            f"{root}: holds runs on {len(problems)} problems; draw one: python -m "
            f"experiments.figures fig6 {_at(root)} problem=NAME, {_of(problems)}"
        )
    runs = runs[runs["problem"] == (problem or problems[0])]
    if methods is not None:
        present = sorted(map(str, runs["optimizer"].unique()))
        with as_config_error(str(root)):
            runs = runs[runs["optimizer"].isin(chosen(present, methods))]
    names = named_apart(runs, of_problem=())["optimizer"].unique()
    if len(names) < 2:
        raise ConfigError(
            f"{root}: holds only runs of {', '.join(names)}; a comparison needs a second method "
            f"or setting, such as python -m experiments.identify -m optimizer=... {_at(root)}"
        )
    curves = stored.curves
    return runs, curves[curves["id"].isin(runs["id"])]


def _at(root: Path) -> str:
    """The root as an argument of a command."""
    return f"root={shlex.quote(str(root))}"


def _of(names: Sequence[str]) -> str:
    return f"expected one of {', '.join(names)}"


def _made_by(root: Path, runs: pd.DataFrame) -> list[str]:
    """Commands that made these runs, if recorded: their comparison, or the sweeps of the root."""
    declared = Comparison.of(runs, runs, root)
    if declared is not None and len(declared.runs) == len(runs):
        return [" ".join(declared.command)]
    return [shlex.join(words) for words in sweep_commands(root)]


def draw_tires(root: Path, output: Path, optimizer: str) -> list[Path]:
    """Draw Fig. 4: the best run of `optimizer` on each of the four tires; print the verdict.

    The right panel shows the front axle with the curves of its tires, over a drive.
    """
    runs = _best_runs(root, "pacejka", [f"tire_{tire}" for tire in TIRES], optimizer)
    samples, curves, errors = {}, {}, {}
    for tire, stored in zip(TIRES, runs, strict=True):
        problem = rebuild(stored)
        dataset = problem.dataset
        alpha = np.linspace(dataset["alpha"].min(), dataset["alpha"].max(), 400)
        force = problem.model.predict(np.array([stored.result["theta"]]), alpha)[0]
        samples[tire.upper()] = np.degrees(dataset["alpha"]), dataset["Fy"] / 1000
        curves[tire.upper()] = np.degrees(alpha), force / 1000
        errors[tire.upper()] = math.sqrt(stored.result["loss"]) / 1000
    axle = FrontAxle.of(runs[:2])
    print("\n".join(verdict(axle)))
    note = f"{len(dataset)} samples per tire; curves learned by {optimizer}; ISO-W signs; right: "
    note += axle.note()
    figure = fig4(samples, curves, errors=errors, axle=axle.panel(), note=note)
    paths = save(figure, output / "fig4")
    return [*paths, _write_origin(output / "fig4.json", runs, {"front_axle": facts(axle)})]


def draw_axle(root: Path, output: Path, optimizer: str) -> list[Path]:
    """Draw Fig. 4 (right) of a log: the best run of `optimizer` on its first part, on the rest."""
    learned = _axle_run(root, optimizer)
    config = learned.config["dataset"]
    later = {**config, "start": config["end"], "end": None}
    data, identified_from = build_dataset(later), rebuild(learned).dataset
    theta = np.array(learned.result["theta"])
    axle = Axle(theta * HALF, theta * HALF)
    curves = {"learned from other laps": _axle_curve(axle, data, identified_from["alpha"])}
    points = np.degrees(data["alpha"]), data[data.output] / 1000
    note = f"points: {len(data)} samples after {config['end']:g} s; learned by {optimizer}\n"
    note += "from those before; dashed: beyond the slip angles learned from; ISO-W signs"
    figure = fig4_right(points, curves, note=note)
    return [
        *save(figure, output / "fig4_right"),
        _write_origin(output / "fig4_right.json", [learned]),
    ]


def _axle_run(root: Path, optimizer: str) -> StoredRun:
    """Best run on an axle of a log whose last part was not used."""
    runs = load_runs(root).runs
    on_axle = runs["problem"].str.fullmatch(r"pacejka-.*_(front|rear)_axle")
    for folder in runs[on_axle & (runs["optimizer"] == optimizer)].sort_values("error")["folder"]:
        stored = read_run(Path(folder))
        if stored.config["dataset"].get("end") is not None:
            return stored
    raise ConfigError(
        f"{root}: no run of {optimizer} on an axle of a driving log up to some time; run python -m "
        f"experiments.identify dataset=axle_log dataset.path=LOG.csv dataset.end=SECONDS "
        f"optimizer={optimizer} {_at(root)}"
    )


def _axle_curve(axle: Axle, data: Dataset, identified_alpha: np.ndarray) -> AxleCurve:
    """Force over slip angle with its error on `data`; dashed beyond `identified_alpha` [rad]."""
    alpha = np.linspace(-0.2, 0.2, 801)
    error = float(np.sqrt(np.mean((axle.force(data["alpha"]) - data[data.output]) ** 2)))
    low, high = np.degrees([identified_alpha.min(), identified_alpha.max()])
    points = np.degrees(alpha), axle.force(alpha) / 1000
    return AxleCurve(points, error / 1000, (float(low), float(high)))


def draw_engine(root: Path, output: Path, optimizer: str) -> list[Path]:
    """Draw Fig. 5: the torque curves of the best runs of `optimizer`, and their engine map."""
    runs = _best_runs(root, "torquecubic", list(DATASETS.values()), optimizer)
    problems = dict(zip(DATASETS, map(rebuild, runs), strict=True))
    thetas = {
        throttle: np.array(run.result["theta"])
        for throttle, run in zip(DATASETS, runs, strict=True)
    }
    figure = fig5(**fig5_data(engine_of(problems, thetas)))
    return [*save(figure, output / "fig5"), _write_origin(output / "fig5.json", runs)]


def _best_runs(root: Path, model: str, datasets: Sequence[str], optimizer: str) -> list[StoredRun]:
    """Best run of `optimizer` on each dataset, in order."""
    all_runs = load_runs(root).runs
    best = []
    for dataset in datasets:
        on_dataset = all_runs["problem"] == f"{model}-{dataset}"
        runs = all_runs[on_dataset & (all_runs["optimizer"] == optimizer)]
        if runs.empty:
            raise ConfigError(
                f"{root}: no run of {optimizer} on {dataset}; run python -m experiments.identify "
                f"-m dataset={','.join(datasets)} optimizer={optimizer} {_at(root)}"
            )
        best.append(read_run(Path(runs.sort_values("error", kind="stable").iloc[0]["folder"])))
    return best


def _write_origin(
    path: Path, stored: Sequence[StoredRun], more: Mapping[str, Any] | None = None
) -> Path:
    """Write the provenance of a figure of single runs: its command, the runs' data, and facts."""
    runs = {"runs": [{key: run.result[key] for key in IDENTITY} for run in stored]}
    return write_provenance(
        path, command_line("experiments.figures"), stored, runs | dict(more or {})
    )
