"""Whether a run is the same to the last bit with any kind and number of workers.

python -m experiments.check.same_by_workers [--kinds threads processes dask]    # some minutes

Seven methods run on five problems with 1, 2, 4 and 8 threads, processes and workers of Dask (which
needs the extra cluster). An evaluation sleeps for about 10 ms, so that workers make it. The
comparison with the run without workers covers the outcome, the number of evaluations, the best
parameters, all improvements, and the rejected values. Exits with 1 if anything differs.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from tqdm import tqdm

from baselines.cma_es import CMAES
from experiments.check.coverage import SPACE, TRUTH
from miho.data import Dataset
from miho.identification import CurveFit
from miho.methods import PSO, DifferentialEvolution, LeastSquares
from miho.models import FunctionModel, Model
from miho.models.joint import PART, JointModel, JointPart
from miho.optim import (
    MIHO,
    MIHOGN,
    Budget,
    LeastSquaresProblem,
    Optimizer,
    Parameter,
    Problem,
    RandomSearch,
    RunRecord,
    Space,
    minimize,
)
from miho.optim.problem import mean_square
from miho.optim.seeds import stream
from miho.parallel.process_executor import ProcessExecutor
from miho.vehicle.models import Pacejka

Array = NDArray[np.float64]

SECONDS = 0.01
COUNTS = (1, 2, 4, 8)
KINDS = ("threads", "processes", "dask")
METHODS: Mapping[str, Optimizer] = {
    "miho": MIHO(),
    "miho_gn": MIHOGN(),
    "pso": PSO(particles=10),
    "cma_es": CMAES(),
    "differential_evolution": DifferentialEvolution(popsize=5),
    "random_search": RandomSearch(batch=10),
    "least_squares": LeastSquares(),
}


class Slow(Model):
    """A model that sleeps for each row of parameters."""

    def __init__(self, model: Model, seconds: float) -> None:
        self.inputs, self.parameters, self.output = model.inputs, model.parameters, model.output
        self.linear, self.name = model.linear, f"slow {model.name or type(model).__name__}"
        self.jacobian_cost = model.jacobian_cost
        self.model, self.seconds = model, seconds

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """As the model."""
        time.sleep(self.seconds * len(thetas))
        return self.model.predict(thetas, *inputs)

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """As the model."""
        time.sleep(self.seconds)
        return self.model.jacobian(theta, *inputs)


class SlowRosenbrock(LeastSquaresProblem):
    """Rosenbrock's function as two residuals; some rows raise."""

    name = "Rosenbrock"
    space = Space(tuple(Parameter(name, "1", -2.0, 2.0) for name in "xy"))

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Mean squared residual (n,)."""
        return mean_square(np.array([self.residuals(theta) for theta in thetas]))

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """(2,); raises ArithmeticError in a corner."""
        time.sleep(self.seconds)
        x, y = theta
        if x + y < -2.5:
            raise ArithmeticError(f"no value where x + y is below -2.5: {x + y:.1f}")
        return np.array([10 * (y - x * x), 1 - x])

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """(2, 2)."""
        time.sleep(self.seconds)
        return np.array([[-20 * theta[0], 10.0], [-1.0, 0.0]])


def decay(t: Any, *, a: Any, b: Any) -> Any:
    """A user's function that cannot be traced as a formula, because it branches."""
    return a * np.exp(-b * t) if b > 0 else 0.0 * t


def problems(seconds: float) -> Mapping[str, Problem]:
    """Problems whose evaluations take `seconds`."""
    rng = stream("same by workers", "data")
    alpha = np.linspace(-0.2, 0.2, 60)
    force = Pacejka().predict(TRUTH[None], alpha)[0] + 50 * rng.standard_normal(60)
    tire = Dataset("tire", {"alpha": alpha, "Fy": force}, {"alpha": "rad", "Fy": "N"}, "Fy")
    t = np.linspace(0.0, 2.0, 40)
    sigma = 0.02 + 0.02 * t
    y = 2.0 * np.exp(-1.5 * t) + sigma * rng.standard_normal(40)
    data = Dataset(
        "decay", {"t": t, "y": y, "sigma": sigma}, dict.fromkeys(("t", "y", "sigma"), ""), "y"
    )
    a = Parameter("a", "", -5.0, 5.0)
    b, c = (Parameter(name, "", 0.01, 10.0, scale="log") for name in "bc")
    slow = Slow(FunctionModel(decay, batched=False), seconds)
    joint = JointModel((JointPart("one", slow, ("a", "b")), JointPart("two", slow, ("a", "c"))))
    part = np.repeat([0.0, 1.0], 20)
    both = Dataset("parts", {PART: part, "t": t, "y": y}, {PART: "-", "t": "", "y": ""}, "y")
    return {
        "tire": CurveFit(Slow(Pacejka(), seconds), tire, SPACE),
        "decay": CurveFit(slow, data, Space((a, b))),
        "weighted decay": CurveFit(slow, data, Space((a, b)), sigma="sigma"),
        "joint decays": CurveFit(joint, both, Space((a, b, c))),
        "Rosenbrock": SlowRosenbrock(seconds),
    }


@contextmanager
def opened(kind: str, count: int) -> Iterator[Any]:
    """Context with `count` workers of a kind."""
    with ExitStack() as stack:
        if kind == "threads":
            yield stack.enter_context(ThreadPoolExecutor(count))
        elif kind == "processes":
            yield stack.enter_context(ProcessExecutor(count))
        else:
            from miho.parallel.cluster import cluster  # needs the extra `cluster`

            client: Any = stack.enter_context(cluster(f"dask:{count}"))
            yield client.get_executor(pure=False)


def differences(alone: RunRecord, record: RunRecord) -> list[str]:
    """Differences between two runs."""
    same = {
        "outcome": alone.outcome is record.outcome and alone.error == record.error,
        "evaluations": alone.evaluations == record.evaluations,
        "theta": np.array_equal(np.array(alone.theta), np.array(record.theta)),
        "loss": alone.loss == record.loss and alone.trace.loss == record.trace.loss,
        "trace": np.array_equal(alone.trace.theta, record.trace.theta)
        and alone.trace.evaluations == record.trace.evaluations,
        "rejected": alone.rejected == record.rejected,
    }
    return [name for name, equal in same.items() if not equal]


def compared(kinds: list[str], counts: list[int], evaluations: int) -> pd.DataFrame:
    """One row per run: differences from the run without workers, and evaluations by workers."""
    budget, rows = Budget(evaluations=evaluations), []
    slow, quick = problems(SECONDS), problems(0.0)
    runs = [(method, problem) for problem in slow for method in METHODS]
    alone = {(m, p): minimize(METHODS[m], quick[p], budget) for m, p in runs}
    for kind in kinds:
        for count in counts:
            with opened(kind, count) as workers:
                for m, p in tqdm(runs, desc=f"{count} {kind}", disable=None):
                    record = minimize(METHODS[m], slow[p], budget, workers=workers)
                    usage = record.usage
                    rows.append(
                        {
                            "problem": p, "method": m, "kind": kind, "workers": count,
                            "evaluations": record.evaluations,
                            "by workers": 0 if usage is None else usage.evaluations,
                            "failed": record.error is not None,
                            "differs": ", ".join(differences(alone[m, p], record)),
                        }
                    )  # fmt: skip
    return pd.DataFrame(rows)


def main() -> int:
    """Print a table of equal runs; return 1 if a run differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--counts", nargs="+", type=int, default=list(COUNTS))
    parser.add_argument("--evaluations", type=int, default=40)
    arguments = parser.parse_args()
    runs = compared(arguments.kinds, arguments.counts, arguments.evaluations)
    same = (runs["differs"] == "") & ~runs["failed"]
    table = runs.assign(same=same).pivot_table(
        index="method", columns="problem", values="same", aggfunc=lambda s: f"{s.sum()} of {s.size}"
    )
    counts = ", ".join(map(str, arguments.counts))
    print(f"Runs equal to the run without workers to the last bit, with {counts} workers")
    print(f"({', '.join(arguments.kinds)}), of {arguments.evaluations} evaluations each:\n")
    print(table.to_string())
    share = runs["by workers"].sum() / runs["evaluations"].sum()
    print(f"\n{same.sum()} of {same.size} runs are the same; workers made {share:.0%} as many "
          "evaluations as were counted")  # fmt: skip
    if not same.all():
        print(f"\n{runs[~same].to_string(index=False)}")
    return int(not same.all())


if __name__ == "__main__":
    sys.exit(main())
