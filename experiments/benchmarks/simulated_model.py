"""Speedup by workers for a simulated model, and their cost for a cheap model.

python -m experiments.benchmarks.simulated_model [--quick] [--output FOLDER]

The model is a typical function of a user: a mass on a spring with a damper and dry friction,
simulated by SciPy's `solve_ivp` in about 20 ms. *Real* searches run until they end by themselves,
alternately with 1 and 2 worker processes. *Simulated* searches make the same decisions with workers
whose time is virtual (`experiments.benchmarks.virtual_workers`): an evaluation takes its measured
CPU seconds, and a task costs the client OVERHEAD. *Cheap* is `miho_asynchronous` on a compiled tire
with 1 and 32 workers.
"""

from __future__ import annotations

import itertools
import os
import statistics
import time
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any, cast

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.schema import register
from experiments.benchmarks.bars import AT_LEAST, Bar, Measured, benchmark, shown
from experiments.benchmarks.sleeping import forms, search
from experiments.benchmarks.virtual_workers import VirtualPool
from miho.data import Dataset
from miho.identification import CurveFit
from miho.models import FunctionModel
from miho.optim import (
    MIHO,
    MIHOGN,
    AsynchronousMIHO,
    Budget,
    Clock,
    Optimizer,
    Parameter,
    RunRecord,
    Space,
    minimize,
)
from miho.parallel import Evaluations, Pool
from miho.quantities import Array

TIMES = np.linspace(0.0, 4.0, 200)
TRUTH = {"k": 80.0, "c": 1.0, "F": 0.5}
NOISE = 1e-3
SPACE = Space(
    (Parameter("k", "1/s^2", 10, 200), Parameter("c", "1/s", 0, 5), Parameter("F", "m/s^2", 0, 3))
)
METHODS = forms("MIHO", MIHO, R=27, eta=3) | forms("MIHO-GN", MIHOGN)
SIZES = (1, 2, 4, 8, 16, 32)
SEEDS, QUICK_SEEDS = 3, 1
OVERHEAD = 5e-4
"""Seconds of the client per task."""
CHEAP, MANY = 20_000, 32
FASTER, AS_FAST = 1.4, 0.8


def oscillator(t: Array, k: float, c: float, F: float) -> Array:
    """Displacement [m] of a mass with a spring, a damper and dry friction, released at 0.1 m.

    `k` [1/s^2], `c` [1/s] and `F` [m/s^2] are per mass.
    """

    def rates(_: float, state: Array) -> tuple[float, float]:
        x, v = state
        return v, -k * x - c * v - F * np.tanh(v / 0.01)

    span = (0.0, float(t[-1]))
    solution = solve_ivp(rates, span, (0.1, 0.0), t_eval=t, rtol=1e-6, atol=1e-8)
    return np.asarray(solution.y[0])


@cache
def timed(k: float, c: float, F: float) -> tuple[Array, float]:
    """Displacements and their CPU seconds, which depend little on other programs."""
    began = time.thread_time()
    return oscillator(TIMES, k, c, F), time.thread_time() - began


def sleeping(pool: VirtualPool) -> Callable[..., Array]:
    """The oscillator for virtual workers, which sleep for the seconds of the simulation."""

    def slept(t: Array, k: float, c: float, F: float) -> Array:
        values, seconds = timed(float(k), float(c), float(F))
        pool.sleep(seconds)
        return values

    return slept


def problem_of(function: Callable[..., Array]) -> CurveFit:
    """Problem of a fit of a function to displacements with noise."""
    noise = NOISE * np.random.default_rng(1).standard_normal(TIMES.size)
    columns = {"t": TIMES, "x": oscillator(TIMES, **TRUTH) + noise}
    data = Dataset("oscillator", columns, {"t": "s", "x": "m"}, "x")
    model = FunctionModel(function, batched=False, rowwise=False, columns=("t",))
    return CurveFit(model, data, SPACE)


def real(seeds: int) -> Iterator[dict[str, Any]]:
    """A row for each method, seed and number of processes, which alternate."""
    for seed, (name, optimizer), size in itertools.product(range(seeds), METHODS.items(), (1, 2)):
        record = minimize(optimizer, problem_of(oscillator), seed=seed, workers=size)
        if record.error is not None:
            raise RuntimeError(record.error)
        yield {
            "kind": "real",
            "method": name,
            "workers": size,
            "seed": seed,
            "evaluations": record.evaluations,
            "seconds": record.seconds,
            "loss": record.loss,
            "says": "" if record.usage is None else str(record.usage),
            "load": os.getloadavg()[0],
        }


def simulated(seeds: int) -> Iterator[dict[str, Any]]:
    """A row for each method, seed and number of virtual workers."""
    for seed, (name, optimizer), size in itertools.product(range(seeds), METHODS.items(), SIZES):
        pool = VirtualPool(size, OVERHEAD)
        evaluations = Evaluations(cast(Pool, pool), limited=True)
        clock = Clock(partial(getattr, pool, "now"), lambda: 0.0)
        ended = search(optimizer, problem_of(sleeping(pool)), evaluations, Budget(), seed, clock)
        yield {
            "kind": "simulated",
            "method": name,
            "workers": size,
            "seed": seed,
            "evaluations": ended.evaluations,
            "seconds": ended.seconds,
            "loss": ended.loss,
        }


def cheap(turns: int) -> Iterator[dict[str, Any]]:
    """A row for each turn and number of workers."""
    register()
    problem = build(composed(["dataset=tire_lf"])).problem
    optimizer: Optimizer = AsynchronousMIHO()
    for turn, size in itertools.product(range(turns), (1, MANY)):
        record: RunRecord = minimize(optimizer, problem, Budget(evaluations=CHEAP), workers=size)
        yield {
            "kind": "cheap",
            "method": "MIHO, asynchronous",
            "workers": size,
            "seed": turn,
            "evaluations": record.evaluations,
            "seconds": record.seconds,
            "loss": record.loss,
            "says": "" if record.usage is None else str(record.usage),
        }


def measure(quick: bool) -> Measured:
    """Measure medians over seeds, the speedup over one worker, and the bars."""
    seeds = QUICK_SEEDS if quick else SEEDS
    frame = pd.DataFrame(list(shown(itertools.chain(cheap(5), simulated(seeds), real(seeds)))))
    groups = frame.groupby(["kind", "method", "workers"], sort=False)
    table = groups[["evaluations", "seconds"]].median().reset_index()
    one = table[table["workers"] == 1].set_index(["kind", "method"])["seconds"]
    keys = pd.MultiIndex.from_frame(table[["kind", "method"]])
    table["times faster"] = one.loc[keys].to_numpy() / table["seconds"].to_numpy()
    faster = table.set_index(["kind", "method", "workers"])["times faster"]
    name = "MIHO, asynchronous"
    bars = [
        Bar(f"{name}, 2 real workers", float(faster["real", name, 2]), AT_LEAST, FASTER, "times"),
        Bar(
            f"{name}, cheap, {MANY} workers", float(faster["cheap", name, MANY]), AT_LEAST,
            AS_FAST, "times",
        ),
    ]  # fmt: skip
    said = frame[frame["says"].fillna("") != ""].drop_duplicates(["kind", "method"], keep="last")
    notes = [f"{row.kind}, {row.method}, says: {row.says}" for row in said.itertuples()]
    lengths = np.array([seconds for _, seconds in _measured()])
    share = np.quantile(lengths, [0.05, 0.5, 0.95]) / lengths.mean()
    notes.append(
        f"a simulation took {1e3 * statistics.fmean(lengths):.3g} ms of CPU on average; 5, 50 "
        f"and 95 % took at most {share[0]:.2f}, {share[1]:.2f} and {share[2]:.2f} times as long"
    )
    load = frame["load"].max()
    notes.append(
        f"load of the machine during the benchmark: up to {load:.1f} on {os.cpu_count()} cores"
    )
    return Measured(table, frame, bars, notes, {"overhead_seconds": OVERHEAD, "load": load})


def _measured() -> list[tuple[Array, float]]:
    """Simulations of parameters drawn over the space."""
    thetas = SPACE.decode(SPACE.sample(200, np.random.default_rng(0), "uniform"))
    return [timed(*theta) for theta in thetas.tolist()]


if __name__ == "__main__":
    benchmark(__doc__, measure, None, "simulated_model")
