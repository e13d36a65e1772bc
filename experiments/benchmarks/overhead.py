"""Cost of methods and of the recorder without the cost of the loss.

python -m experiments.benchmarks.overhead [--quick] [--output FOLDER]

Each method of conf/optimizer minimizes a cheap loss, whose time is measured and subtracted, for two
seconds of the method's clock. The microseconds are per evaluation in the units of the budget.
Hyperband, successive halving and DEHB evaluate on fractions of the data: several of their calls
count as one full evaluation. The cost of the recorder is the difference between calls of `Oracle`
and direct calls of the loss. Its share of a MIHO run on the left front tire is computed from the
number of calls in that run and their cost alone: per block of compiled steps, per batch and per
improvement. The bar per evaluation is for batches of 10 and more in which no row improves; single
rows and improvements cost more, are listed in the table and count in the share of the run.
"""

from __future__ import annotations

import math
import time
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.app.build import build
from experiments.app.compose import CONF, composed
from experiments.app.schema import register
from experiments.benchmarks.bars import AT_MOST, Bar, Measured, benchmark, interleaved
from miho.compiled import Block, Climb, Kernel, Rows, Steps
from miho.optim import Budget, LeastSquaresProblem, Optimizer, Oracle, Problem, Space, minimize

Array = NDArray[np.float64]

BATCHES = (1, 10, 100, 1000)
CAP = 2.0
"""Seconds of the method's clock."""


class Bowl(LeastSquaresProblem):
    """A parabola over the box that measures the seconds of its evaluations."""

    name = "bowl"
    linear = ("D", "Sy")

    def __init__(self, space: Space) -> None:
        self.space = space
        self._middle, self._width = (space.low + space.high) / 2, space.high - space.low
        self.seconds = 0.0

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Mean square of the residuals."""
        started = time.perf_counter()
        scaled = (thetas - self._middle) / self._width
        losses = np.asarray(np.einsum("ij,ij->i", scaled, scaled) / scaled.shape[1])
        self.seconds += time.perf_counter() - started
        return losses

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Distance to the middle, relative to the box."""
        started = time.perf_counter()
        residuals = np.asarray((theta - self._middle) / self._width)
        self.seconds += time.perf_counter() - started
        return residuals

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Its derivatives."""
        started = time.perf_counter()
        derivatives = np.diag(1 / self._width)
        self.seconds += time.perf_counter() - started
        return derivatives


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


SETTINGS = {"ngopt": ["optimizer.plan=1000"]}
"""Settings that a method needs if only the seconds are limited."""


def methods(space: Space, cap: float) -> list[dict[str, object]]:
    """Microseconds per evaluation of each method of conf/optimizer without the loss."""
    rows: list[dict[str, object]] = []
    for path in sorted((CONF / "optimizer").glob("*.yaml")):
        overrides = [f"optimizer={path.stem}", *SETTINGS.get(path.stem, ())]
        optimizer: Optimizer = build(composed(overrides)).optimizer
        problem = Bowl(space)
        problem.seconds = 0.0
        record = minimize(optimizer, problem, Budget(seconds=cap))
        evaluated = record.evaluations > 0 and record.error is None
        own_seconds = math.nan
        if evaluated:
            own_seconds = (record.seconds - problem.seconds) / record.evaluations
        rows.append(
            {
                "kind": "method",
                "name": path.stem,
                "us": 1e6 * own_seconds,
                "evaluations": record.evaluations,
                "ended": record.outcome.value if evaluated else str(record.error).splitlines()[-1],
            }
        )
    return rows


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
    """Measure the methods, the recorder alone, and its share of a run."""
    register()
    repeats = 5 if quick else 20
    experiment = build(composed(["dataset=tire_lf", "optimizer=miho"]))
    space = experiment.problem.space
    # Every method on a loss that costs nothing, and the recorder's calls timed alone.
    tidy = methods(space, CAP / 10 if quick else CAP)
    cost = recorder(space, repeats)
    for (improving, batch), seconds in cost.items():
        name = f"batch of {batch}, {improving} improve"
        tidy.append({"kind": "recorder", "name": name, "us": 1e6 * seconds / batch})
    per_block = block_seconds(space, repeats)
    tidy.append({"kind": "recorder", "name": "a block of compiled steps", "us": 1e6 * per_block})

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
        "us: per evaluation, method and recorder together, without the loss; methods with "
        "blocks of compiled steps on a compiled loss use their general form here",
        "us of hyperband, successive halving and DEHB, which evaluate on fractions of the data: "
        "per equivalent of a full evaluation",
        "the recorder's bar per evaluation is for batches of 10 and more without improvements",
        f"the MIHO run: {run.evaluations:,.0f} evaluations in {run.seconds:.2f} s, "
        f"{counted.blocks} blocks, {counted.batches} batches, {len(run.trace)} improvements, "
        f"{1e3 * spent:.1f} ms of recording",
    ]
    frame = pd.DataFrame(tidy)
    return Measured(frame.astype(object).fillna(""), frame, bars, notes)


if __name__ == "__main__":
    benchmark(__doc__, measure, "overhead")
