"""How steadily the loss falls in the paper's gradient descent (Sec. V-A.3).

python -m experiments.check.gradient_descent [--steps 1000] [--repetitions 20]    # 10 seconds

The paper calls the small rate stable and the large one unstable. Each run descends on the
left-front tire from one common initial configuration; a steady descent has no step after which the
loss rises. For each rate the table has the mean errors in kN at the start, at best and at the end,
the number of runs in which the loss rises at least once, and the median share of steps after which
it does.
"""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.console import run_and_exit
from experiments.app.schema import register
from miho import Budget, minimize
from miho.optim import LeastSquaresProblem, Optimizer
from miho.quantities import Array

METHODS = ("gbo_small", "gbo_large")


class Watched(LeastSquaresProblem):
    """A problem that records the mean square of all residuals it returns, in `losses`."""

    jacobian_cost: int | None

    def __init__(self, problem: LeastSquaresProblem) -> None:
        self.problem, self.name, self.space = problem, problem.name, problem.space
        self.jacobian_cost = problem.jacobian_cost
        self.losses: list[float] = []

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """The loss of the problem, which is not recorded."""
        return self.problem.loss(thetas, fidelity)

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """The residuals of the problem."""
        residuals = self.problem.residuals(theta, fidelity)
        self.losses.append(float(np.mean(residuals**2)))
        return residuals

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """The derivatives of the problem."""
        return self.problem.jacobian(theta, fidelity)


def descent(optimizer: Optimizer, problem: LeastSquaresProblem, seed: int, steps: int) -> Array:
    """Errors (steps,) of one run, in the unit of the problem."""
    watched = Watched(problem)
    cost = 1 + len(watched.space)  # residuals and derivatives of one step
    minimize(optimizer, watched, Budget(evaluations=steps * cost), seed=seed)
    return np.sqrt(watched.losses[-steps:])


def steadiness(steps: int, repetitions: int) -> pd.DataFrame:
    """One row per rate, as described in the module docstring."""
    rows = []
    for method in METHODS:
        run = build(composed(["dataset=tire_lf", f"optimizer={method}"]))
        seeds = range(repetitions)
        errors = np.array([descent(run.optimizer, run.problem, seed, steps) for seed in seeds])
        errors /= 1000
        rises = np.diff(errors, axis=1) > 0
        start, best, end = errors[:, 0], errors.min(axis=1), errors[:, -1]
        rows.append(
            {
                "method": method,
                "first [kN]": start.mean(),
                "best [kN]": best.mean(),
                "last [kN]": end.mean(),
                "runs that rise": f"{rises.any(axis=1).sum()} of {repetitions}",
                "rising steps [%]": 100 * float(np.median(rises.mean(axis=1))),
            }
        )
    return pd.DataFrame(rows)


def main() -> None:
    """Parse the arguments and print the table."""
    parser = argparse.ArgumentParser(prog="python -m experiments.check.gradient_descent")
    parser.add_argument("--steps", type=int, default=1000, help="steps per descent (1000)")
    parser.add_argument("--repetitions", type=int, default=20, help="runs per rate (20)")
    arguments = parser.parse_args()

    def job() -> None:
        register()
        table = steadiness(arguments.steps, arguments.repetitions)
        print(table.to_string(index=False, float_format="%.3g"))

    run_and_exit(job)


if __name__ == "__main__":
    main()
