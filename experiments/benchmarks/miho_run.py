"""A whole MIHO run on the left front tire: a plain loop and all forms up to the fastest.

python -m experiments.benchmarks.miho_run [--quick] [--output FOLDER]

R = 10^4, eta = 5, 3000 rows (with --quick R = 10^3). The plain loop is written like the authors'
code: Python loops over the configurations, one NumPy call of the model for each mutation, the sine
and arctangent of NumPy. It draws the same noise, so that all rows of the table are the same search
and their final errors can be compared. It runs rung by rung; the fast runs are repeated between its
rungs, so that a change of the machine's speed affects all forms.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.schema import register
from experiments.benchmarks.bars import AT_LEAST, AT_MOST, Bar, Measured, benchmark
from miho.identification import CurveFit
from miho.models import Model
from miho.optim import MIHO, Problem, RunRecord, Space, hyperband_table, minimize
from miho.optim.seeds import stream
from miho.quantities import Array
from miho.vehicle.models import Pacejka

ROUNDS = 5
"""Number of runs of each fast form."""
PLAIN, GENERAL, LOSS = "plain loop", "MIHO, NumPy loss", "MIHO, loss of the machine"
STEPS, STOPPED = "steps of the machine", "and early stopping"
STOPPED_2 = "early stopping, two threads"
FAST = (STOPPED, STOPPED_2)
KINDS = ("seconds", "cpu_seconds")


@dataclass(frozen=True)
class NumPyPacejka(Model):
    """Eq. 4 as a model that is not an expression, so that the machine does not run it."""

    inputs = Pacejka.inputs
    parameters = Pacejka.parameters
    output = Pacejka.output
    linear = Pacejka.linear

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Lateral force [N] of parameter rows (n, 5) at slip angles (N,)."""
        return Pacejka().predict(thetas, *inputs)

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives (N, 5) of the lateral force."""
        return Pacejka().jacobian(theta, *inputs)


class LossAlone(Problem):
    """A problem whose loss, but nothing else, is computed by the machine."""

    def __init__(self, inner: Problem) -> None:
        self.inner, self.name, self.space = inner, inner.name, inner.space

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,) of the inner problem."""
        return self.inner.loss(thetas, fidelity)


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


def problems() -> tuple[CurveFit, CurveFit]:
    """The tire's problem and its NumPy form, under one name."""
    register()
    fit = build(composed(["dataset=tire_lf", "optimizer=miho"])).problem
    space, label = fit.space, fit.name
    return fit, CurveFit(NumPyPacejka(), fit.dataset, space, label=label)


@dataclass
class Race:
    """Time of the plain loop so far, and the runs of the other forms between its rungs."""

    forms: Mapping[str, tuple[MIHO, Problem]]
    loop: Iterator[Incumbent]
    rungs: int
    records: dict[str, list[RunRecord]] = field(default_factory=dict)
    best: Incumbent = field(default_factory=Incumbent)
    seconds: float = 0.0
    cpu_seconds: float = 0.0

    def run(self, seed: int) -> None:
        """Run all forms: the fast forms ROUNDS times during the loop, the others once."""
        pauses = sorted(set(np.linspace(0, self.rungs, ROUNDS, dtype=int).tolist()))
        slow = dict(zip(pauses[1:], (GENERAL, LOSS, STEPS), strict=False))
        for rung in range(self.rungs + 1):
            if rung in pauses:
                for name in (*FAST, *([slow[rung]] if rung in slow else [])):
                    record = minimize(*self.forms[name], seed=seed)
                    self.records.setdefault(name, []).append(record)
            if rung < self.rungs:
                started, worked = time.perf_counter(), time.process_time()
                self.best = next(self.loop)
                self.seconds += time.perf_counter() - started
                self.cpu_seconds += time.process_time() - worked
        counts = {record.evaluations for runs in self.records.values() for record in runs}
        if counts != {self.best.evaluations}:
            raise RuntimeError(f"the runs are not the same search: {counts} evaluations")

    def table(self, error: Callable[[Array], float]) -> pd.DataFrame:
        """Table with a row per form: median seconds, and `error` of the best of the first run."""
        rows: list[tuple[Any, ...]] = [
            (PLAIN, self.seconds, self.cpu_seconds, 0.0, self.best.theta)
        ]
        for name in self.forms:
            runs = self.records[name]
            spent = (np.median([getattr(run, kind) for run in runs]) for kind in KINDS)
            rows.append((name, *spent, runs[0].setup_seconds, runs[0].theta))
        table = pd.DataFrame(rows, columns=["form", *KINDS, "setup_seconds", "theta"])
        table["evaluations"] = self.best.evaluations
        table["us"] = 1e6 * table["seconds"] / self.best.evaluations
        table["speedup"] = self.seconds / table["seconds"]
        table["loss"] = [error(theta) for theta in table.pop("theta")]
        table["difference"] = table["loss"] / table["loss"][0] - 1
        return table


def measure(quick: bool) -> Measured:
    """Measure one plain run, one run of each slower form, and several runs of each fast form."""
    R, eta, seed = 1000 if quick else 10_000, 5, 0
    fit, plain = problems()
    stopping, whole = MIHO(R=R, eta=eta), MIHO(R=R, eta=eta, early_stopping=False)
    # The forms from general to fast; all make the same search with the same random numbers.
    forms: dict[str, tuple[MIHO, Problem]] = {
        GENERAL: (whole, plain),
        LOSS: (whole, LossAlone(fit)),
        STEPS: (whole, fit),
        STOPPED: (stopping, fit),
        STOPPED_2: (stopping, replace(fit, threads=2)),
    }
    alpha, force = fit.inputs[0], fit.dataset[fit.dataset.output]
    rng, space = stream("own", fit.name, seed, "MIHO"), fit.space.seeded(fit.name, seed)
    loop = plain_loop(alpha, force, space, rng, R, eta)
    race = Race(forms, loop, len(hyperband_table(R, eta)))
    race.run(seed)
    tidy = race.table(lambda theta: float(plain.loss(theta[None])[0]))
    # Compare each form with the plain loop: final loss, seconds, seconds of the processor.
    apart = float(np.abs(tidy["difference"]).max())
    speedup = tidy.set_index("form")["speedup"]
    busy = race.cpu_seconds / tidy.set_index("form")["cpu_seconds"]
    spread = [f"{name}: {min(times):.2f} to {max(times):.2f} s" for name in FAST
              if (times := [record.seconds for record in race.records[name]])]  # fmt: skip
    bars = [
        Bar(STOPPED, speedup[STOPPED], AT_LEAST, 40, "times the plain loop"),
        Bar("final loss on the full data, largest difference", apart, AT_MOST, 1e-9, "relative"),
    ]
    notes = [
        f"R = {R}, eta = {eta}, {len(fit.dataset)} rows; seconds of the method alone, median of "
        f"{ROUNDS} runs of the fast forms ({'; '.join(spread)}), one run of the others",
        f"by processor time, which excludes other programs on the machine: {STOPPED} "
        f"{busy[STOPPED]:.1f} times",
        "setup_seconds: seconds of the tracing before the first run",
        "difference: final loss against the plain loop's, both by NumPy over all rows",
    ]
    return Measured(tidy, tidy, bars, notes)


if __name__ == "__main__":
    benchmark(__doc__, measure, "miho_run")
