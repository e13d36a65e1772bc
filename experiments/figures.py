"""Draw the paper's figures from the store.

python -m experiments.figures fig6   # error over time, and the claims table (after `compare`)
python -m experiments.figures fig4   # the four learned tires (after `identify` on each of them)
python -m experiments.figures arena  # leaderboard, tests and profiles (after experiment=arena)
python -m experiments.figures fig4_right # the front axle over laps it was not learned from (after
                                         # `identify` with dataset=axle_log and dataset.end)
python -m experiments.figures fig5   # torque curves and engine map (after `identify` on torque_*)
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.app.build import ConfigError, build_dataset, rebuild
from experiments.app.console import guarded
from experiments.arena_results import draw_arena
from experiments.comparison import read_comparison, write_origin, write_tables
from experiments.full_size import differences
from miho.analysis import claims_table, fig4, fig5, fig6, results_table, save
from miho.analysis.compare.claims import MIHO, is_on_a_tire
from miho.analysis.figures.paper import AxleCurve, fig4_right
from miho.analysis.timing import clock_of
from miho.data import Dataset
from miho.driving.assembly.engine import DATASETS, engine_of, fig5_data
from miho.models import Axle
from miho.study import StoredRun, load_runs, read_run
from miho.study.provenance import IDENTITY, command_line, write_provenance

TIRES = ("lf", "rf", "lr", "rr")
HALF = np.array([1.0, 1.0, 0.5, 1.0, 0.5])
"""From the curve (B, C, D, Sx, Sy) of an axle to that of either of two equal tires."""
CAPTIONS = {
    "results": "Evaluations and seconds are medians over repetitions; never: half of them or more "
    "did not get there. Success: share of runs within 1 % of the best error.",
    "claims": "The paper's claims; ours with 95 % bootstrap intervals.",
}


def draw_comparison(root: Path, output: Path) -> list[Path]:
    """Fig. 6, the results table, the table of the paper's claims, and their provenance.

    The claims are about MIHO on a tire: without either there is no table of them.
    """
    comparison = read_comparison(root)
    runs, curves, note = comparison.runs, comparison.curves, comparison.note
    paths = save(fig6(runs, curves, note=note), output / "fig6")
    tables = {"results": results_table(runs, curves)}
    if is_on_a_tire(runs):
        tables["claims"] = claims_table(runs, curves, MIHO, differences=differences(runs))
    paths += write_tables(comparison, tables, CAPTIONS, output)
    command = " ".join(word for word in comparison.command if not word.startswith("fresh="))
    if advice := clock_of(runs).advice(command):
        print(advice, file=sys.stderr)
    return [*paths, write_origin(comparison, output)]


def draw_tires(root: Path, output: Path, optimizer: str) -> list[Path]:
    """Fig. 4, left and middle: the best run of `optimizer` on each of the four tires."""
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
    note = f"{len(dataset)} samples per tire; curves learned by {optimizer}; ISO-W signs"
    figure = fig4(samples, curves, errors=errors, note=note)
    return [*save(figure, output / "fig4"), _write_origin(output / "fig4.json", runs)]


def draw_axle(root: Path, output: Path, optimizer: str) -> list[Path]:
    """Fig. 4, right: the best run of `optimizer` on the first part of a driving log, over the rest.

    Beside it stands the sum of both front tires' curves, as in the paper, where runs on them are.
    """
    learned = _axle_run(root, optimizer)
    config = learned.config["dataset"]
    later = {**config, "start": config["end"], "end": None}
    data, known = build_dataset(later), rebuild(learned).dataset
    theta = np.array(learned.result["theta"])
    axle = Axle(theta * HALF, theta * HALF)
    curves = {"learned from other laps": _axle_curve(axle, data, known["alpha"])}
    runs = [learned]
    try:
        tires = _best_runs(root, "pacejka", ["tire_lf", "tire_rf"], optimizer)
    except ConfigError:
        tires = []
    if tires and config["axle"] == "front":
        left, right = (np.array(run.result["theta"]) for run in tires)
        seen = rebuild(tires[0]).dataset["alpha"]
        curves["sum of both learned tires"] = _axle_curve(Axle(left, right), data, seen)
        runs += tires
    points = np.degrees(data["alpha"]), data[data.output] / 1000
    note = f"points: {len(data)} samples after {config['end']:g} s; learned by {optimizer}\n"
    note += "from those before; dashed: beyond the slip angles learned from; ISO-W signs"
    figure = fig4_right(points, curves, note=note)
    return [
        *save(figure, output / "fig4_right"),
        _write_origin(output / "fig4_right.json", runs),
    ]


def _axle_run(root: Path, optimizer: str) -> StoredRun:
    """The best run on an axle in a log of which the end was left out."""
    found = load_runs(root).runs
    named = found["problem"].str.fullmatch(r"pacejka-.*_(front|rear)_axle")
    for folder in found[named & (found["optimizer"] == optimizer)].sort_values("error")["folder"]:
        stored = read_run(Path(folder))
        if stored.config["dataset"].get("end") is not None:
            return stored
    raise ConfigError(
        f"{root}: no run of {optimizer} on an axle of a driving log up to some time; run python -m "
        f"experiments.identify dataset=axle_log dataset.path=LOG.csv dataset.end=SECONDS "
        f"optimizer={optimizer} root={root}"
    )


def _axle_curve(axle: Axle, data: Dataset, seen: np.ndarray) -> AxleCurve:
    alpha = np.linspace(-0.2, 0.2, 801)
    error = float(np.sqrt(np.mean((axle.force(data["alpha"]) - data[data.output]) ** 2)))
    low, high = np.degrees([seen.min(), seen.max()])
    points = np.degrees(alpha), axle.force(alpha) / 1000
    return AxleCurve(points, error / 1000, (float(low), float(high)))


def draw_engine(root: Path, output: Path, optimizer: str) -> list[Path]:
    """Fig. 5: the torque curves of the best runs of `optimizer`, and the map they go into."""
    runs = _best_runs(root, "torquecubic", list(DATASETS.values()), optimizer)
    problems = dict(zip(DATASETS, map(rebuild, runs), strict=True))
    thetas = {
        throttle: np.array(run.result["theta"])
        for throttle, run in zip(DATASETS, runs, strict=True)
    }
    figure = fig5(**fig5_data(engine_of(problems, thetas)))
    return [*save(figure, output / "fig5"), _write_origin(output / "fig5.json", runs)]


def _best_runs(root: Path, model: str, datasets: Sequence[str], optimizer: str) -> list[StoredRun]:
    """The best run of `optimizer` on each dataset, in order."""
    found = load_runs(root).runs
    best = []
    for dataset in datasets:
        runs = found[(found["problem"] == f"{model}-{dataset}") & (found["optimizer"] == optimizer)]
        if runs.empty:
            raise ConfigError(
                f"{root}: no run of {optimizer} on {dataset}; run python -m experiments.identify "
                f"-m dataset={','.join(datasets)} optimizer={optimizer} root={root}"
            )
        best.append(read_run(Path(runs.sort_values("error", kind="stable").iloc[0]["folder"])))
    return best


def _write_origin(path: Path, stored: Sequence[StoredRun]) -> Path:
    """What regenerates a figure of single runs, and what they ran on."""
    facts = {"runs": [{key: run.result[key] for key in IDENTITY} for run in stored]}
    return write_provenance(path, command_line("experiments.figures"), stored, facts)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.figures",
        description="Draw a figure of the paper from finished runs, as PNG and PDF.",
    )
    parser.add_argument("name", choices=("fig4", "fig4_right", "fig5", "fig6", "arena"))
    parser.add_argument(
        "--root",
        type=Path,
        help="folder of runs (fig6: runs/compare; arena: runs/arena; else runs/identify)",
    )
    parser.add_argument("--output", type=Path, help="where to write (default: ROOT/figures)")
    parser.add_argument(
        "--optimizer", default="miho", help="of fig4, fig4_right, fig5 (default: miho)"
    )
    arguments = parser.parse_args()
    usual = {"fig6": "compare", "arena": "arena"}.get(arguments.name, "identify")
    root = arguments.root or Path("runs", usual)
    output = arguments.output or root / "figures"

    def job() -> None:
        if arguments.name == "fig6":
            paths = draw_comparison(root, output)
        elif arguments.name == "arena":
            paths = draw_arena(root, output)
        elif arguments.name == "fig4_right":
            paths = draw_axle(root, output, arguments.optimizer)
        elif arguments.name == "fig5":
            paths = draw_engine(root, output, arguments.optimizer)
        else:
            paths = draw_tires(root, output, arguments.optimizer)
        print("\n".join(map(str, paths)))

    guarded(job)


if __name__ == "__main__":
    main()
