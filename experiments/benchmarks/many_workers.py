"""Speedup of a search by 1 to 10,000 simulated workers, checked against real workers.

python -m experiments.benchmarks.many_workers [--check] [--quick] [--output FOLDER]

The methods are real and make all their decisions; workers and their time are virtual
(`experiments.benchmarks.sleeping`). The client's cost of a task is measured first. Seconds
count until the loss is within 1 % of the optimum. Evaluations take 1 s on average: equal times,
times spread log-normally, or the measured times of a simulation. With `--check` 1 to 64 real
workers sleep as well, in smaller searches that end by themselves; their seconds are compared with
the virtual seconds.
"""

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.benchmarks.bars import Measured, at_least, at_most, benchmark, shown
from experiments.benchmarks.sleeping import (
    PROCESSES,
    SIGMA,
    Lengths,
    Sleeping,
    search,
    simulation_times,
    started,
    virtual_search,
)
from miho.analysis.compare.running_time import NEAR_BEST
from miho.analysis.figures.house import new_figure
from miho.analysis.tidy import require_columns
from miho.figures.style import COLORS
from miho.optim import MIHO, MIHOGN, AsynchronousMIHOGN, Budget, Optimizer, RandomSearch, minimize
from miho.parallel import Evaluations
from miho.quantities import Array

DASHES = ("solid", (0, (4, 1.5)), (0, (1, 1.2)), "dashdot")
MARKERS = ("o", "s", "^", "D")
GREY = "#777777"
PANELS = {
    "equal": "evaluations of equal length",
    "log-normal": "spread log-normally (σ = 0.7)",
    "measured": "spread as in a simulation",
}


def many_workers_figure(frame: pd.DataFrame) -> Figure:
    """Wall time over workers, a line per method with quartiles, a panel per spread of durations.

    The frame has the columns kind, method, workers, spread, seed and seconds (NaN if the optimum
    was not reached); rows of a kind other than `simulated` are ignored.
    """
    require_columns(frame, {"kind", "method", "workers", "spread", "seed", "seconds"}, "frame")
    with new_figure(3.8) as figure:
        panels = figure.subplots(1, len(PANELS), sharex=True, sharey=True)
        for ax, (spread, title) in zip(panels, PANELS.items(), strict=True):
            rows = frame[(frame["spread"] == spread) & (frame["kind"] == "simulated")]
            for k, (name, line) in enumerate(rows.groupby("method", sort=False)):
                _band(ax, line, str(name), k)
            _ideal(ax, rows)
            ax.set(xscale="log", yscale="log", xlabel="workers")
            ax.set_title(title, loc="left")
        panels[0].set_ylabel("time to 1.01 of the optimum\n[mean evaluations]")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _band(ax: Axes, line: pd.DataFrame, name: str, k: int) -> None:
    """The median over seeds, with the quartiles as a band."""
    quartiles, look = _quartiles(line), _look(k)
    ax.fill_between(
        quartiles.index, quartiles[0.25], quartiles[0.75], color=look["color"], alpha=0.18, lw=0
    )
    ax.plot(quartiles.index, quartiles[0.5], label=name, **look)


def _quartiles(line: pd.DataFrame) -> pd.DataFrame:
    """Quartiles over seeds by workers; a run that missed the target counts as the slowest."""
    seconds = line.assign(seconds=line["seconds"].fillna(float("inf"))).groupby("workers")
    return (
        seconds["seconds"].quantile(np.array([0.25, 0.5, 0.75]), interpolation="nearest").unstack()
    )


def _ideal(ax: Axes, rows: pd.DataFrame) -> None:
    """The time of the first method with one worker, divided by the workers."""
    line = _quartiles(rows[rows["method"] == rows["method"].iloc[0]])[0.5]
    ideal = line.iloc[0] * line.index[0] / line.index.to_series()
    ideal = ideal[ideal >= rows["seconds"].min()]
    ax.plot(ideal.index, ideal, color=GREY, linewidth=0.8, label="MIHO with ideal workers")


def _look(k: int) -> dict[str, Any]:
    """Colour, dashes and marker, so that lines also differ in print without colours."""
    return {
        "color": COLORS[k % len(COLORS)],
        "linestyle": DASHES[k % len(DASHES)],
        "marker": MARKERS[k % len(MARKERS)],
        "markersize": 3.5,
    }


METHODS: dict[str, Optimizer] = {
    "MIHO": MIHO(R=1000, eta=10),
    "MIHO-GN": MIHOGN(),
    "MIHO-GN, asynchronous": AsynchronousMIHOGN(),
}
SMALL: dict[str, Optimizer] = {
    "MIHO": MIHO(R=27, eta=3),
    "MIHO-GN": MIHOGN(max_brackets=3),
    "MIHO-GN, asynchronous": AsynchronousMIHOGN(max_brackets=3),
}
"""Searches that sleeping workers finish within half a minute."""
SIZES = (1, 3, 10, 32, 100, 316, 1000, 3162, 10_000)
REAL_SIZES = (1, 2, 4, 8, 16, 32, 64)
SECONDS, REAL_SECONDS = 1.0, 0.05
SEEDS = 15
TASKS = 1000
NEAR = 0.15
"""Largest median of the relative differences between simulated and real seconds."""


class Job(NamedTuple):
    """One search by virtual workers."""

    name: str
    workers: int
    spread: str
    seed: int
    overhead: float
    target: float


def measured_overhead() -> float:
    """Seconds of the client per task, measured with empty evaluations that are all sent."""
    with started(PROCESSES, 2) as pool:
        evaluations = Evaluations(pool, limited=True)
        ended = search(
            RandomSearch(batch=TASKS), Sleeping(Lengths(0.0)), evaluations,
            Budget(evaluations=TASKS),
        )  # fmt: skip
    return ended.seconds / TASKS


def optimum() -> float:
    """The smallest loss of the sleeping model."""
    return minimize(MIHOGN(), Sleeping(Lengths(0.0), lambda seconds: None)).loss


def simulated(job: Job, lengths: Lengths) -> dict[str, Any]:
    """Row with the virtual seconds until the target, NaN if it was not reached."""
    budget = Budget(target=job.target)
    ended = virtual_search(METHODS[job.name], lengths, job.workers, job.overhead, budget, job.seed)
    return {
        "kind": "simulated",
        "method": job.name,
        "workers": job.workers,
        "spread": job.spread,
        "seed": job.seed,
        "seconds": ended.seconds if ended.loss <= job.target else math.nan,
        "evaluations": ended.evaluations,
        "efficiency": ended.work / (job.workers * ended.seconds),
    }


def growth(
    quick: bool, spreads: Mapping[str, Lengths], overhead: float, target: float
) -> list[Mapping[str, Any]]:
    """A row for each method, number of workers, spread and seed; several at a time."""
    sizes, seeds = (SIZES[:5:2], 2) if quick else (SIZES, SEEDS)
    jobs = [
        Job(name, size, spread, seed, overhead, target)
        for size in reversed(sizes)  # the longest jobs first
        for spread in spreads
        for name in METHODS
        for seed in range(seeds)
    ]
    with started(PROCESSES, os.cpu_count() or 1) as pool:
        # the jobs as indices: only the function may come from the main module
        rows = pool.map(lambda k: simulated(jobs[k], spreads[jobs[k].spread]), range(len(jobs)))
        return list(shown(rows))


def checked(
    quick: bool, spreads: Mapping[str, Lengths], overhead: float
) -> Iterator[dict[str, Any]]:
    """A row for each method, number of workers and spread: seconds of real and virtual workers."""
    for size in REAL_SIZES[3:4] if quick else REAL_SIZES:
        with started(PROCESSES, size) as pool:
            for spread, form in spreads.items():
                lengths = replace(form, mean=REAL_SECONDS)
                for name, optimizer in SMALL.items():
                    real = search(optimizer, Sleeping(lengths), Evaluations(pool), Budget())
                    virtual = virtual_search(optimizer, lengths, size, overhead, Budget())
                    yield {
                        "kind": "check",
                        "method": name,
                        "workers": size,
                        "spread": spread,
                        "seed": 0,
                        "seconds": real.seconds,
                        "simulated_seconds": virtual.seconds,
                        "ratio": virtual.seconds / real.seconds,
                    }


def measure(quick: bool, check: bool) -> Measured:
    """Measure medians over seeds, and the difference from real workers."""
    times = simulation_times()
    spreads = {
        "equal": Lengths(SECONDS),
        "log-normal": Lengths(SECONDS, SIGMA),
        "measured": Lengths(SECONDS, measured=tuple(times.tolist())),
    }
    overhead, target = measured_overhead(), NEAR_BEST * optimum()
    frame = pd.DataFrame(growth(quick, spreads, overhead, target))
    late = frame.assign(seconds=frame["seconds"].fillna(math.inf))
    medians = late.groupby(["spread", "workers", "method"])["seconds"].median().unstack()
    table = medians[list(METHODS)].reset_index()
    reached = frame.groupby("method")["seconds"].apply(lambda s: s.notna().mean())
    notes = [
        f"seconds until the loss is within 1 % of the optimum, medians of "
        f"{frame['seed'].nunique()} seeds; a task costs the client {1e3 * overhead:.2g} ms",
        f"a simulation of the car took {1e3 * times.mean():.3g} ms, {_quantiles(times)}",
        *(f"{name} gets there in {reached[name]:.0%} of runs" for name in METHODS),
    ]
    bars = [at_least("the runs' share that gets there", float(reached.min()), 0.5)]
    if check:
        rows = pd.DataFrame(list(shown(checked(quick, spreads, overhead))))
        columns = ["method", "spread", "workers", "seconds", "simulated_seconds", "ratio"]
        notes.append(rows[columns].to_string(index=False, float_format="{:.3g}".format))
        off = float(np.median(np.abs(rows["ratio"] - 1)))
        bars.append(at_most("simulated against real seconds, median difference", off, NEAR))
        frame = pd.concat([frame, rows], ignore_index=True)
    facts = {
        "seconds_an_evaluation": SECONDS,
        "sigma": SIGMA,
        "simulation_seconds": times.round(6).tolist(),
        "overhead_seconds": overhead,
        "target": target,
        "seeds": sorted(frame["seed"].unique().tolist()),
        "methods": {name: repr(optimizer) for name, optimizer in METHODS.items()},
        "check": {name: repr(optimizer) for name, optimizer in SMALL.items()} if check else None,
    }
    return Measured(table, frame, bars, notes, facts)


def _quantiles(times: Array) -> str:
    """Quantiles of the times relative to their mean, in words."""
    shares = np.quantile(times, [0.05, 0.5, 0.95]) / times.mean()
    return "of which 5, 50 and 95 % take at most {:.2f}, {:.2f} and {:.2f}".format(*shares)


if __name__ == "__main__":
    flags = {"check": "compare with real workers, 1 to 64 of them, which takes minutes"}
    benchmark(__doc__, measure, "many_workers", flags, draw=many_workers_figure)
