"""Reproduce the paper's comparison (Fig. 6) under each reading of its unspecified settings.

python -m experiments.check.readings [--repetitions 20] [--workers 2] [--output FOLDER]

The paper specifies neither the inertia of its swarms nor bounds, the initial distribution, the
units of the rates of gradient descent, or the evaluation in its code. Each reading names options of
conf/optimizer, or `VARIANTS` of them, for the five methods of the paper. Missing runs are made at
full size: R = 10^4, eta = 5, 3000 rows. Seconds are modelled as evaluations times the cost of
one evaluation, which `experiments.benchmarks.interpreted` measures and writes to the same folder,
so a busy machine does not change them. Writes the table of readings by claims, all claims with
their intervals, the curves, and provenance.
"""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from baselines.arena.readings import (
    Reading,
    frames_of,
    long_table,
    reading_claims,
    readings_figure,
    short_table,
)
from experiments.app.build import ConfigError
from experiments.app.comparing import chosen_method
from experiments.app.compose import composed
from experiments.app.console import OK, SOME_FAILED, run_and_exit
from experiments.app.plan import Request, requests, sweep_settings
from experiments.app.runs import run
from miho.analysis import save
from miho.analysis.compare.comparison import Comparison, write_origin, write_tables
from miho.study import load_runs

EXPERIMENT = "experiment=paper_readings"
OUTPUT = Path("docs", "results", "paper_readings")
COSTS = "interpreted.csv"

CONSTRICTION = {
    "c1": 1.496179765663133,
    "c2": 1.496179765663133,
    "inertia_start": 0.7298437881283576,
    "inertia_end": 0.7298437881283576,
}
"""The constriction coefficient of phi = 4.1 (Clerc and Kennedy, 2002)."""
NO_INERTIA = {"inertia_start": 1.0, "inertia_end": 1.0}
"""A swarm without an inertia weight (Kennedy and Eberhart, 1995)."""
NO_LIMIT, NO_BOUNDS = {"velocity_limit": None}, {"bounds": "none"}
STARTS = {name: {"sampling": name} for name in ("uniform", "uniform_plus_noise")}
"""Starts that are uniform in the box, or drawn as in the authors' public code."""
SWARMS: dict[str, dict[str, Any]] = STARTS | {
    "constriction": CONSTRICTION,
    "constriction_no_limit": CONSTRICTION | NO_LIMIT,
    "no_inertia": NO_INERTIA,
    "no_inertia_no_bounds": NO_INERTIA | NO_BOUNDS,
    "no_inertia_no_limit": NO_INERTIA | NO_LIMIT,
    "no_inertia_unbounded": NO_INERTIA | NO_LIMIT | NO_BOUNDS,
    "no_limit": NO_LIMIT,
    "unbounded": NO_BOUNDS,
}
DESCENTS: dict[str, dict[str, Any]] = STARTS | {
    "si": {},
    "box": {"units": "box"},
    "kn_deg": {"units": "kN_deg", "steps": 20_000},
}
"""Gradient descent on a loss in N^2, with parameters in SI units, in multiples of their range, or
in kN, degrees and 1/degrees."""
RATES = {"gbo_small": 5e-18, "gbo_large": 1e-16}
"""Rates of gradient descent as for a loss in kN^2: a millionth of them per N^2."""
STEPS = {"steps": 10_000}
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    f"{method}_{suffix}": (method, settings)
    for methods, variants in (
        (("miho",), STARTS | {"unbounded": {"clip": "none"}}),
        (("pso_100", "pso_500"), SWARMS),
        (RATES, {name: STEPS | settings for name, settings in DESCENTS.items()}),
    )
    for method in methods
    for suffix, settings in variants.items()
} | {f"{name}_kn2": (name, STEPS | {"learning_rate": rate}) for name, rate in RATES.items()}
"""Methods of conf/optimizer with other settings, by name."""


def reading(words: str, *, miho: str = "miho", swarm: str = "", descent: str = "si") -> Reading:
    """Reading whose swarms and descents have these suffixes in their names."""
    methods = {"miho": miho}
    methods |= {name: f"{name}_{descent}" for name in ("gbo_small", "gbo_large")}
    methods |= {name: f"{name}_{swarm}".rstrip("_") for name in ("pso_100", "pso_500")}
    return Reading(words, methods)


READINGS = (
    reading("inertia 0.9 to 0.4, velocity limit, box, normal start, N² and SI units"),
    reading("inertia 0.9 to 0.4, no velocity limit", swarm="no_limit"),
    reading("constriction, velocity limit", swarm="constriction"),
    reading("constriction, no velocity limit", swarm="constriction_no_limit"),
    reading("w = 1, velocity limit", swarm="no_inertia"),
    reading("w = 1, no velocity limit", swarm="no_inertia_no_limit"),
    reading("no bounds, inertia 0.9 to 0.4", miho="miho_unbounded", swarm="unbounded"),
    reading(
        "no bounds, w = 1, velocity limit", miho="miho_unbounded", swarm="no_inertia_no_bounds"
    ),
    reading(
        "no bounds, w = 1, no velocity limit", miho="miho_unbounded", swarm="no_inertia_unbounded"
    ),
    reading("uniform start", miho="miho_uniform", swarm="uniform", descent="uniform"),
    reading(
        "uniform start plus noise",
        miho="miho_uniform_plus_noise",
        swarm="uniform_plus_noise",
        descent="uniform_plus_noise",
    ),
    reading(
        "MIHO and start as in the authors' code",
        miho="miho_reference",
        swarm="uniform_plus_noise",
        descent="uniform_plus_noise",
    ),
    reading("descent on a loss in kN²", descent="kn2"),
    reading("descent in kN and degrees", descent="kn_deg"),
    reading("descent in multiples of the ranges", descent="box"),
)


def plan(repetitions: int, overrides: Sequence[str] = ()) -> Iterator[Request]:
    """Runs of all readings, method by method."""
    names = dict.fromkeys(name for each in READINGS for name in each.methods.values())
    for name in names:
        option, settings = VARIANTS.get(name, (name, {}))
        replaced = [f"++{text}" for text in chosen_method(option, settings)[1:]]
        words = [EXPERIMENT, f"optimizer={option}", *replaced, f"method={name}", *overrides]
        yield from requests(composed(words), " ".join(words), range(repetitions))


def costs_of(path: Path) -> dict[str, dict[str, float]]:
    """Seconds per evaluation of each method, for each kind of cost."""
    if not path.exists():
        raise ConfigError(
            f"{path}: is missing; run python -m experiments.benchmarks.interpreted "
            f"--output {path.parent} first"
        )
    table = pd.read_csv(path).set_index("method") * 1e-6
    return {str(kind): dict(table[kind]) for kind in table}


def judge(comparison: Comparison, target: float, output: Path) -> None:
    """Write tables, figure and provenance; print the short table."""
    costs = costs_of(output / COSTS)
    frames = {
        each.words: frames_of(each, comparison.runs, comparison.curves, target) for each in READINGS
    }
    claims = {words: reading_claims(*both, costs) for words, both in frames.items()}
    tables = {"readings": short_table(claims), "claims": long_table(claims, list(claims))}
    captions = {
        "readings": "The paper's claims under each reading. Bold: reproduced; italics: undecided "
        "within this budget or these repetitions; ∞: no rival gets there.",
        "claims": "The same with 95 % bootstrap intervals.",
    }
    texts, _ = write_tables(comparison, tables, captions, output)
    print(texts[0])
    curves = {words: both[1] for words, both in frames.items()}
    save(readings_figure(curves, note=comparison.note), output / "readings")
    write_origin(comparison, output)


def main() -> None:
    """Parse the arguments, make the missing runs, and judge."""
    parser = argparse.ArgumentParser(prog="python -m experiments.check.readings")
    parser.add_argument("--repetitions", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2, help="simultaneous runs (2)")
    parser.add_argument("--root", type=Path, help="folder of runs (runs/paper_readings)")
    parser.add_argument("--output", type=Path, default=OUTPUT)
    arguments = parser.parse_args()

    def job() -> int:
        costs_of(arguments.output / COSTS)
        overrides = [] if arguments.root is None else [f"root={arguments.root}"]
        cfg = composed([EXPERIMENT, *overrides])
        todo = list(plan(arguments.repetitions, overrides))
        settings = replace(sweep_settings(cfg.sweep), workers=arguments.workers)
        outcome = run(todo, settings, command="experiments.check.readings")
        outcome.raise_if_stopped()
        if any(state.error is None and state.reason is not None for state in outcome.states):
            print("runs are missing; nothing is judged, run again", file=sys.stderr)
            return SOME_FAILED
        ids = {request.identity.id for request in todo}
        stored = load_runs(Path(cfg.root))
        runs, curves = (frame[frame["id"].isin(ids)] for frame in (stored.runs, stored.curves))
        note = (
            f"R = 10,000, {arguments.repetitions} repetitions, at most "
            f"{cfg.budget.evaluations:,} evaluations per run"
        )
        command = ("python", "-m", "experiments.check.readings")
        comparison = Comparison(runs, curves, 0, command, note)
        judge(comparison, math.sqrt(cfg.budget.target), arguments.output)
        return OK

    run_and_exit(job)


if __name__ == "__main__":
    main()
