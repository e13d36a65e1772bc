"""Evaluations and time of a method until it reaches the optimum of many problems, or stops there.

python -m experiments.benchmarks.reach optimizer=least_squares --seeds 20 --processes 2
python -m experiments.benchmarks.reach optimizer=least_squares --vary starts=1,10,50 \
    --with optimizer.screen=10 --problems 'sample_*,tire_lf'
python -m experiments.benchmarks.reach --config-dir my_options optimizer=mine --problems 'mine_*'
python -m experiments.benchmarks.reach optimizer=least_squares --stopping

The method is composed with its overrides, and each problem of conf/problem by its name. A run ends
at 1.001 times the recorded optimum, after 40,000 evaluations (`budget.evaluations`), or by itself.
The expected running time (ERT) of a target is the number of evaluations that all runs used until
they reached it or ended, divided by the number of runs that reached it. A line of geometric means
over the problems compares each variant with the unchanged method; `--vary` changes one setting at a
time.

With `--stopping` only the method or the budget ends a run. A run is at the optimum if its loss
exceeds the loss of the recorded optimum by at most a fraction of 1e-4. It arrived when its loss
first exceeded its final loss by at most this fraction. The evaluations at the end over the
evaluations at arrival are the price of recognizing the optimum. Milliseconds are of the method's
clock; two processes at once slow each other.

With `--wider 30` each range is thirty times as wide around its middle; on a logarithmic scale both
ends are a factor of thirty further out. The wider range may contain a better optimum.
"""

import argparse
import itertools
import json
import math
import multiprocessing
import re
import shlex
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.app.build import ConfigError, build_optimizer, build_problem, recorded_optimum
from experiments.app.comparing import chosen_problems
from experiments.app.compose import composed, searching
from experiments.app.console import OK, SOME_FAILED, run_and_exit
from experiments.app.explain import parse_overrides
from experiments.app.options import CONF
from experiments.app.origin import our_code
from experiments.app.safety import check_folder
from experiments.benchmarks.bars import machine
from experiments.benchmarks.reach_tables import (
    Run,
    endings,
    geometric_means,
    hits,
    reach_table,
    solved_by_all,
    stopping_shares,
    stopping_table,
)
from miho.analysis.compare.running_time import FACTORS
from miho.identification import CurveFit
from miho.optim import Budget, Optimizer, Outcome, Space, minimize
from miho.study import environment_stamp, single_thread, write_text
from miho.vehicle.data import DataUnavailableError

DEFAULT = "as it is"
BUDGET = ("budget.evaluations=40000", "budget.seconds=null")
"""Evaluations as in the arena; seconds would make the result depend on the machine."""
SEEDS_AT_ONCE = 5


@dataclass(frozen=True)
class Job:
    """Runs of one variant on one problem: overrides of the method, overrides of the problem."""

    problem: str
    variant: str
    method: tuple[str, ...]
    others: tuple[str, ...]
    seeds: tuple[int, ...]
    stopping: bool = False
    wider: float = 1.0


@lru_cache(maxsize=1)
def _problem(
    name: str, overrides: tuple[str, ...], wider: float
) -> tuple[CurveFit, Budget, float] | str:
    """A problem, the budget of a run and the optimum; or the reason why its data are missing."""
    cfg = composed([*BUDGET, *overrides, f"problem={name}"])
    optimum = recorded_optimum(cfg)
    if not optimum:
        raise ConfigError(
            f"problem {name}: has no recorded optimum above zero; leave it out of --problems"
        )
    try:
        problem = build_problem(cfg)
    except DataUnavailableError as error:
        return str(error)
    if wider != 1:
        problem = replace(problem, space=widened(problem.space, wider))
    budget = Budget(cfg.budget.evaluations, cfg.budget.seconds)
    return problem, budget, optimum


def widened(space: Space, factor: float) -> Space:
    """A space of the same parameters with wider ranges."""
    parameters = []
    for parameter in space.parameters:
        low, high = parameter.low, parameter.high
        if parameter.scale == "log":
            low, high = low / factor, high * factor
        else:
            middle, half = (low + high) / 2, (high - low) / 2
            low, high = middle - factor * half, middle + factor * half
        parameters.append(replace(parameter, low=low, high=high))
    return replace(space, parameters=tuple(parameters))


@cache
def _optimizer(method: tuple[str, ...]) -> Optimizer:
    return build_optimizer(composed(method))


def runs_of(job: Job) -> list[Run] | str:
    """The runs of a job, or the reason why the data of its problem are missing."""
    loaded = _problem(job.problem, job.others, job.wider)
    if isinstance(loaded, str):
        return loaded
    problem, budget, optimum = loaded
    if not job.stopping:
        budget = replace(budget, target=(min(FACTORS) * optimum) ** 2)
    optimizer = _optimizer(job.method)
    runs = []
    with single_thread():
        for seed in job.seeds:
            record = minimize(optimizer, problem, budget, seed)
            if record.outcome is Outcome.INTERRUPTED:
                raise KeyboardInterrupt
            trace = record.trace
            runs.append(
                Run(
                    problem=job.problem,
                    variant=job.variant,
                    seed=seed,
                    optimum=optimum,
                    outcome=record.outcome,
                    evaluations=record.evaluations,
                    seconds=record.seconds,
                    at_evaluations=np.array(trace.evaluations),
                    at_seconds=np.array(trace.seconds),
                    losses=np.array(trace.loss),
                    data=problem.dataset.digest,
                    error=record.error,
                )
            )
    return runs


@dataclass
class Printout:
    """Finished runs and their printed lines, problem by problem."""

    stopping: bool
    variants: Sequence[str]
    runs: list[Run] = field(default_factory=list)

    def take(self, runs: Sequence[Run]) -> None:
        """Print the lines of one problem."""
        table = stopping_table(runs) if self.stopping else reach_table(hits(runs))
        self._print(table.reset_index(), header=not self.runs)
        self.runs += runs

    def close(self) -> None:
        """Print the lines over all problems, and the failed runs."""
        if self.stopping:
            print("\nover all runs")
            table = stopping_shares(self.runs, ["optimizer"]).reindex(list(self.variants))
            self._print(table.reset_index().assign(problem="all"))
            for run in self.runs:
                if run.ended and not run.at_optimum:
                    name = f"{run.problem}, {run.variant}, seed {run.seed}"
                    print(f"ended elsewhere: {name}: error {run.excess:.1e} above the optimum's")
        else:
            table = reach_table(hits(self.runs))
            self._means("the problems", table)
            common = solved_by_all(table)
            if 0 < len(common) < len(table):
                count = len(common) // len(self.variants)
                self._means(f"the {count} problems that every method solved", common)
        for run in self.failed:
            cause = (run.error or "").strip().splitlines()[-1]
            print(f"failed: {run.problem}, {run.variant}, seed {run.seed}: {cause}")

    @property
    def failed(self) -> list[Run]:
        """Runs that ended with an error."""
        return [run for run in self.runs if run.outcome is Outcome.FAILED]

    def _means(self, over: str, table: pd.DataFrame) -> None:
        print(f"\ngeometric means over {over}")
        means = geometric_means(table).rename_axis("method").reset_index()
        print(means.to_string(index=False, float_format=_3))

    def _print(self, table: pd.DataFrame, header: bool = True) -> None:
        names = {"problem": 19}
        if len(self.variants) > 1:
            names["method"] = max(map(len, (*self.variants, "method")))
        table = table.rename(columns={"optimizer": "method"})
        values = [name for name in table if name not in ("problem", "method")]
        rows = [row.to_dict() for _, row in table.iterrows()]
        for row in [{name: name for name in table}] * header + rows:
            cells = [f"{row[name]:<{width}}" for name, width in names.items()]
            print(*cells, *(f"{_3(row[name]):>10}" for name in values), flush=True)


def _3(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def variants(
    base: Sequence[str], vary: Sequence[str], others: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Overrides of the method by the name of the variant, the unchanged method first.

    Each value of each setting of `vary` is one variant, and each list of overrides in `others` is
    one variant. A variant that chooses another method drops the overrides of `base`.
    """
    variants = {DEFAULT: tuple(base)}
    texts = [text if text.startswith("optimizer.") else f"optimizer.{text}" for text in vary]
    added: list[list[str]] = []
    for override in parse_overrides(texts):
        values = (
            override.sweep_string_iterator() if override.is_sweep_override()
            else [override.get_value_element_as_str()]
        )  # fmt: skip
        added += [[f"{override.get_key_element()}={value}"] for value in values]
    added += [shlex.split(text) for text in others]
    for overrides in added:
        keys = [override.key_or_group for override in parse_overrides(overrides)]
        for key in keys:
            if key.partition(".")[0] != "optimizer":
                raise ConfigError(f"{key}: is no setting of the method; vary optimizer settings")
        method_base = () if "optimizer" in keys else tuple(base)
        name = " ".join(re.sub(r"^optimizer[.=]", "", text) for text in overrides)
        variants[name] = (*method_base, *overrides)
    return variants


def problems(patterns: str | None, folders: Sequence[Path] = (CONF,)) -> list[str]:
    """Names of problems that match, in the given order; the arena's problems by default."""
    if patterns is None:
        return chosen_problems(composed(["experiment=arena"]).comparison.problems)
    return chosen_problems(patterns.split(","), folders, key="--problems")


def _results(jobs: Sequence[Job], processes: int) -> Iterator[list[Run] | str]:
    """Results of the jobs, in the order of the jobs."""
    if processes == 1:
        yield from map(runs_of, jobs)
        return
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(runs_of, jobs)


def _write(path: Path, report: Printout, jobs: Sequence[Job]) -> None:
    """Write a row per run (`stopping`) or per run and factor, and a file with the provenance."""
    frame = endings(report.runs) if report.stopping else hits(report.runs)
    write_text(path, frame.rename(columns={"optimizer": "variant"}).to_csv(index=False))
    about = {
        "command": ["python", "-m", "experiments.benchmarks.reach", *sys.argv[1:]],
        "variants": {job.variant: job.method for job in jobs},
        "optima": {run.problem: run.optimum for run in report.runs},
        "data": {run.problem: run.data for run in report.runs},
        "code": our_code(
            frozenset({type(_optimizer(job.method)).__module__ for job in jobs})
            | {CurveFit.__module__, "miho.models", "miho.data"}
        ),
        "environment": environment_stamp(),
    }
    write_text(path.with_suffix(".provenance.json"), json.dumps(about, indent=1) + "\n")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.benchmarks.reach",
        description=(__doc__ or "").partition("\n\n")[0],
    )
    add = parser.add_argument
    add("overrides", nargs="*", help="for example optimizer=least_squares optimizer.screen=50")
    add("--config-dir", type=Path, metavar="FOLDER", help="a folder with your own options")
    add("--problems", help="names of problems or patterns, with commas (default: the arena's)")
    add("--seeds", type=int, default=10, help="runs of each variant on each problem")
    add("--first", type=int, default=0, help="the first seed")
    add("--processes", type=int, default=1, help="runs at a time")
    add("--vary", action="append", default=[], metavar="SETTING=VALUES", help="starts=1,10,50")
    add("--with", action="append", default=[], metavar="OVERRIDES", dest="others",
        help="a variant with these overrides of the method")  # fmt: skip
    add("--stopping", action="store_true", help="let the method end its runs by itself")
    add("--wider", type=float, default=1.0, metavar="FACTOR",
        help="factor by which the search boxes are wider")  # fmt: skip
    add("--out", type=Path, metavar="FILE.csv", help="where to write the runs, with provenance")
    arguments = parser.parse_intermixed_args()
    for name, least in (("seeds", 1), ("first", 0), ("processes", 1)):
        if getattr(arguments, name) < least:
            parser.error(f"--{name}: is {getattr(arguments, name)}; expected at least {least}")
    if not 1 <= arguments.wider < math.inf:
        parser.error(f"--wider: is {arguments.wider:g}; expected a number of at least 1")
    return arguments


def main() -> None:
    """Read the command line, execute the runs and print the tables."""
    arguments = _arguments()

    def job() -> int:
        folders, search_path = [CONF], searching(arguments.config_dir)
        if arguments.config_dir is not None:
            check_folder(arguments.config_dir)
            folders.append(arguments.config_dir)
        # Overrides of the method (True) define the variants, the others apply to every problem.
        overrides_of: dict[bool, list[str]] = {True: [], False: []}
        for text, override in zip(
            arguments.overrides, parse_overrides(arguments.overrides), strict=True
        ):
            key = override.key_or_group
            if key in ("problem", "seed"):
                raise ConfigError(f"{key}: cannot be chosen here; see --{key}s")
            overrides_of[key.partition(".")[0] == "optimizer"].append(text)
        methods = variants(overrides_of[True], arguments.vary, arguments.others)
        methods = {name: (*search_path, *method) for name, method in methods.items()}
        for method in methods.values():
            _optimizer(method)
        seeds = range(arguments.first, arguments.first + arguments.seeds)
        parts = [tuple(seeds[i : i + SEEDS_AT_ONCE]) for i in range(0, len(seeds), SEEDS_AT_ONCE)]
        others, stopping, wider = (
            (*search_path, *overrides_of[False]),
            arguments.stopping,
            arguments.wider,
        )
        # A job for each problem, variant and handful of seeds.
        jobs = [
            Job(name, variant, method, others, part, stopping, wider)
            for name in problems(arguments.problems, folders)
            for variant, method in methods.items()
            for part in parts
        ]
        print(machine())
        report = Printout(arguments.stopping, list(methods))
        # Lines are printed as soon as all jobs of a problem are done.
        finished = zip(jobs, _results(jobs, arguments.processes), strict=True)
        for name, of_problem in itertools.groupby(finished, key=lambda pair: pair[0].problem):
            results = [result for _, result in of_problem]
            reasons = [result for result in results if isinstance(result, str)]
            if reasons:
                print(f"{name}: left out: {reasons[0]}", file=sys.stderr)
            else:
                report.take([run for runs in results for run in runs if isinstance(run, Run)])
        if not report.runs:
            raise ConfigError("--problems: the data of all problems are missing on this machine")
        report.close()
        if arguments.out is not None:
            _write(arguments.out, report, jobs)
        return SOME_FAILED if report.failed else OK

    run_and_exit(job)


if __name__ == "__main__":
    main()
