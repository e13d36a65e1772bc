"""A whole MIHO run on the left front tire: by a plain loop, and by steps in C.

python -m experiments.benchmarks.miho_run [--quick] [--output FOLDER]

R = 10^4, eta = 5, 3000 rows (with --quick R = 10^3). The plain loop is written like the authors'
code: Python loops over the configurations, one NumPy call of the model for each mutation, the sine
and arctangent of NumPy. It draws the same noise, so that all rows of the table are the same search
and their final errors can be compared. It runs rung by rung; the fast runs are repeated between its
rungs, so that a change of the machine's speed affects all forms.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.benchmarks.bars import Measured, at_least, at_most, benchmark
from miho.optim import MIHO, RunRecord, Space, hyperband_table, minimize
from miho.optim.seeds import stream
from miho.quantities import Array
from miho.vehicle.models import Pacejka

ROUNDS = 5
"""Number of runs of each form but the plain loop."""
PLAIN, STEPS, STOPPED = "plain loop", "steps of the machine", "and early stopping"


@dataclass
class Incumbent:
    """Number of evaluations of the plain loop so far, and the best configuration."""

    evaluations: int = 0
    loss: float = np.inf
    theta: Array | None = None


def plain_loop(
    alpha: Array, force: Array, space: Space, rng: np.random.Generator, R: int, eta: int
) -> Iterator[Incumbent]:
    """Run Alg. 1 in Python loops, and yield the best configuration so far after each rung."""
    low, high = space.bounds
    sigma_max, sigma_min = space.sigma
    result = Incumbent()

    def error(theta: Array) -> float:
        B, C, D, Sx, Sy = theta
        result.evaluations += 1
        return float(np.mean((D * np.sin(C * np.arctan(B * (Sx - alpha))) + Sy - force) ** 2))

    table = hyperband_table(R, eta)
    for rung in table:
        if rung.j == 0:
            P = list(space.initial(rung.n) if rung is table[0] else space.sample(rung.n, rng))
            L = [error(p) for p in P]
        else:
            top = sorted(range(len(L)), key=L.__getitem__)[: rung.n]
            P, L = [P[i] for i in top], [L[i] for i in top]
        for step in range(rung.mutations):
            sigma = sigma_max + (sigma_min - sigma_max) * (step / rung.mutations)
            for i in range(len(P)):
                mutant = np.clip(rng.standard_normal(len(low)) * sigma + P[i], low, high)
                loss = error(mutant)
                if loss < L[i]:
                    P[i], L[i] = mutant, loss
        best = min(range(len(L)), key=L.__getitem__)
        if L[best] < result.loss:
            result.loss, result.theta = L[best], P[best]
        yield result


def measure(quick: bool) -> Measured:
    """Measure one plain run, with several runs of the other forms between its rungs."""
    R, eta, seed = 1000 if quick else 10_000, 5, 0
    fit = build(composed(["dataset=tire_lf", "optimizer=miho"])).problem
    alpha, force = fit.inputs[0], fit.dataset[fit.dataset.output]
    forms = {STEPS: MIHO(R=R, eta=eta, early_stopping=False), STOPPED: MIHO(R=R, eta=eta)}
    records: dict[str, list[RunRecord]] = {name: [] for name in forms}
    rng, space = stream("own", fit.name, seed, "MIHO"), fit.space.seeded(fit.name, seed)
    loop, rungs = plain_loop(alpha, force, space, rng, R, eta), len(hyperband_table(R, eta))
    pauses, spent = np.linspace(0, rungs, ROUNDS, dtype=int), np.zeros(2)
    for rung in range(rungs + 1):
        for _ in range(np.count_nonzero(pauses == rung)):
            for name, method in forms.items():
                records[name].append(minimize(method, fit, seed=seed))
        if rung < rungs:
            started = clocks()
            best = next(loop)
            spent += clocks() - started
    counts = {record.evaluations for runs in records.values() for record in runs}
    if counts != {best.evaluations}:
        raise RuntimeError(f"the runs are not the same search: {counts} evaluations")
    table = pd.DataFrame([_row(PLAIN, [spent], 0.0, best.theta)] + [
        _row(name, [(run.seconds, run.cpu_seconds) for run in runs], runs[0].setup_seconds,
             runs[0].theta)
        for name, runs in records.items()
    ])  # fmt: skip
    table["us"] = 1e6 * table["seconds"] / best.evaluations
    for kind in ("seconds", "cpu_seconds"):
        table[f"speedup, {kind}"] = table[kind][0] / table[kind]
    table["loss"] = [
        float(np.mean((Pacejka().predict(theta[None], alpha)[0] - force) ** 2))
        for theta in table.pop("theta")
    ]
    table["difference"] = table["loss"] / table["loss"][0] - 1
    faster = float(table["speedup, seconds"].iloc[-1])
    apart = float(table["difference"].abs().max())
    bars = [
        at_least(STOPPED, faster, 40, "times the plain loop"),
        at_most("final loss on the full data, largest difference", apart, 1e-9, "relative"),
    ]
    notes = [
        f"R = {R}, eta = {eta}, {len(fit.dataset)} rows, {best.evaluations:,} evaluations; seconds "
        f"of the method alone, medians of {ROUNDS} runs, one of the plain loop",
        "setup_seconds: seconds of the tracing before the first run",
        "difference: final loss against the plain loop's, both by NumPy over all rows",
    ]
    return Measured(table, table, bars, notes)


def clocks() -> Array:
    """Wall and CPU time [s]."""
    return np.array([time.perf_counter(), time.process_time()])


def _row(name: str, spent: Sequence[Any], setup: float, theta: Array | None) -> dict[str, Any]:
    """Row of a form, with the medians of the wall and CPU seconds of its runs."""
    seconds, cpu_seconds = np.median(spent, axis=0)
    return {"form": name, "seconds": seconds, "cpu_seconds": cpu_seconds,
            "setup_seconds": setup, "theta": theta}  # fmt: skip


if __name__ == "__main__":
    benchmark(__doc__, measure, "miho_run")
