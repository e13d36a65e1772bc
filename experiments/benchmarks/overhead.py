"""Cost of recording the evaluations of a run.

python -m experiments.benchmarks.overhead [--quick] [--output FOLDER]

The cost of the recorder is the difference between calls of `Oracle` and direct calls of the loss.
Its share of a MIHO run on the left front tire is computed from the number of calls in that run and
their cost alone: per block of compiled steps, per batch and per improvement. The bar per evaluation
is for batches of 10 and more in which no row improves; single rows and improvements cost more, are
listed in the table and count in the share of the run.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.schema import register
from experiments.benchmarks.bars import AT_MOST, Bar, Measured, benchmark, interleaved
from miho.compiled import Block, Climb, Kernel, Rows, Steps
from miho.optim import Budget, Oracle, Problem, Space, minimize
from miho.quantities import Array

BATCHES = (1, 10, 100, 1000)


class CompiledSteps(NamedTuple):
    """A kernel of counted steps."""

    climb: Climb
    rows: Rows | None = None


class Counted(Problem):
    """A problem that counts the batches and the blocks of compiled steps of a run."""

    def __init__(self, inner: Problem) -> None:
        self.inner, self.name, self.space = inner, inner.name, inner.space
        self.batches = self.blocks = 0

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,) of the inner problem; each call counts as a batch."""
        self.batches += 1
        return self.inner.loss(thetas, fidelity)

    @property
    def kernel(self) -> Kernel | None:
        """The problem's compiled steps."""
        return CompiledSteps(self._climb)

    def _climb(self, steps: Steps, best: float, target: float) -> Block:
        self.blocks += 1
        kernel = self.inner.kernel
        if kernel is None or kernel.climb is None:
            raise RuntimeError("the problem has no compiled steps")
        return kernel.climb(steps, best, target)


class Prepared(Problem):
    """A problem whose losses are computed in advance, so that they cost nothing."""

    name = "prepared"

    def __init__(self, space: Space, losses: Array) -> None:
        self.space, self.losses = space, losses

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """The first n of the given losses."""
        return self.losses[: len(thetas)]


def recorder(space: Space, repeats: int) -> dict[tuple[str, int], float]:
    """Seconds of the oracle per batch without the loss: none of the losses improve, or all do."""
    cost = {}
    for batch in BATCHES:
        thetas = space.decode(space.initial(batch))
        flat = Prepared(space, np.full(batch, 1.0))
        steady = Oracle(flat, Budget())
        steady(thetas)
        jobs = {"oracle": partial(steady, thetas), "loss": partial(flat.loss, thetas)}
        seconds = interleaved(jobs, repeats)
        cost["none", batch] = seconds["oracle"] - seconds["loss"]
        falling = Prepared(space, -np.arange(1.0, batch + 1))
        improving = Oracle(falling, Budget())

        def improve(o: Oracle = improving, p: Prepared = falling, t: Array = thetas) -> None:
            p.losses = p.losses - len(t)
            o(t)

        def shift(p: Prepared = falling, t: Array = thetas) -> None:
            p.losses = p.losses - len(t)

        seconds = interleaved({"oracle": improve, "shift": shift}, repeats, atom=0.001)
        cost["all", batch] = seconds["oracle"] - seconds["shift"]
    return cost


def block_seconds(space: Space, repeats: int) -> float:
    """Seconds of the oracle per block of compiled steps without improvements."""
    none = np.empty(0)
    report = Block(1, none, none, none.reshape(0, len(space)), {"loss is nan": 0, "loss is inf": 0})
    oracle = Oracle(Prepared(space, np.ones(1)), Budget())
    oracle(space.initial(1))

    def step() -> None:
        oracle.spend(lambda limit, best, target: report, 1)

    return interleaved({"block": step}, repeats)["block"]


def measure(quick: bool) -> Measured:
    """Measure the recorder alone, and its share of a run."""
    register()
    repeats = 5 if quick else 20
    experiment = build(composed(["dataset=tire_lf", "optimizer=miho"]))
    space = experiment.problem.space
    # The recorder's calls timed alone.
    cost = recorder(space, repeats)
    per_block = block_seconds(space, repeats)
    rows = [
        (f"batch of {batch}, {improving} improve", 1e6 * seconds / batch)
        for (improving, batch), seconds in cost.items()
    ]
    rows.append(("a block of compiled steps", 1e6 * per_block))

    # Count these calls in a run of MIHO.
    counted = Counted(experiment.problem)
    run = minimize(experiment.optimizer, counted)
    per_improvement = cost["all", 1000] / 1000
    spent = (
        counted.blocks * per_block
        + counted.batches * cost["none", 1]
        + len(run.trace) * per_improvement
    )
    worst = max(cost["none", batch] / batch for batch in BATCHES[1:])
    bars = [
        Bar(
            "recorder per evaluation, batches of 10+, none improve", 1e6 * worst, AT_MOST, 1.0, "us"
        ),
        Bar("recorder's share of a MIHO run", 100 * spent / run.seconds, AT_MOST, 1.0, "%"),
    ]
    notes = [
        f"the MIHO run: {run.evaluations:,.0f} evaluations in {run.seconds:.2f} s, "
        f"{counted.blocks} blocks, {counted.batches} batches, {len(run.trace)} improvements, "
        f"{1e3 * spent:.1f} ms of recording",
    ]
    frame = pd.DataFrame(rows, columns=["name", "us"])
    return Measured(frame, frame, bars, notes)


if __name__ == "__main__":
    benchmark(__doc__, measure, "overhead")
