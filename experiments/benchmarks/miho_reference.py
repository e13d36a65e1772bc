"""MIHO as in the authors' code, at their size, compared with the cost of the loss alone.

python -m experiments.benchmarks.miho_reference

The authors' code takes 25 s for R = 10^4, eta = 5 and 3000 rows on one core (about 14,000
evaluations a second, measured with it on another machine).
"""

from __future__ import annotations

import time

import numpy as np

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.console import run_and_exit
from experiments.app.schema import register
from miho.optim import minimize
from miho.study import single_thread

REPEATS = 5000


def main() -> None:
    """Time one run, and the loss alone at the configuration that it found."""
    register()
    experiment = build(composed(["optimizer=miho_reference", "dataset=tire_lf"]))
    problem = experiment.problem
    with single_thread():
        record = minimize(experiment.optimizer, problem)
        thetas = np.array([record.theta])
        started = time.perf_counter()
        for _ in range(REPEATS):
            problem.loss(thetas)
        alone = (time.perf_counter() - started) / REPEATS
    per_row = f"{1e9 * alone / len(problem.dataset):.1f} ns a row"
    rows = [
        ("evaluations", f"{record.evaluations:,.0f}"),
        ("seconds", f"{record.seconds:.1f} (authors' code: 25)"),
        ("CPU seconds", f"{record.cpu_seconds:.1f}"),
        ("evaluations a second", f"{record.evaluations / record.seconds:,.0f}"),
        ("one evaluation alone", f"{1e6 * alone:.1f} us, {per_row}"),
        ("share of the loss", f"{100 * alone * record.evaluations / record.seconds:.0f} %"),
        ("error", f"{record.loss**0.5:.2f} {problem.unit}"),
    ]
    for name, value in rows:
        print(f"{name:<22}{value}")


if __name__ == "__main__":
    run_and_exit(main)
