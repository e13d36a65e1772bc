"""Cost of one point of the tire's loss, on the machine of formulas and in NumPy.

python -m experiments.benchmarks.loss [--quick] [--output FOLDER]
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.benchmarks.bars import (
    AT_LEAST,
    AT_MOST,
    Bar,
    Measured,
    benchmark,
    turns,
)
from experiments.benchmarks.figures import loss_figure
from miho.compiled import taped_loss
from miho.vehicle.models import Pacejka

Array = NDArray[np.float64]

ROWS = (100, 300, 3000, 30_000, 3_000_000)
BATCHES = (1, 10, 100, 1000, 10_000)
MOST_POINTS = 3e7
"""Largest number of points of one call; with more, NumPy takes seconds."""
JUDGED = 3000, 1000
"""Rows and batch of the bars."""
WRITTEN_WITH = 15.5
"""ns per point of NumPy when the bars were written."""
METHODS = "one thread", "two threads", "NumPy"
TEMPORARY = 50_000
"""Numbers per temporary of the NumPy loss."""

LOW, HIGH = np.array([2, 1, 1000, -0.05, -500.0]), np.array([40, 2.5, 6000, 0.05, 500.0])


def numpy_loss(thetas: Array, x: Array, y: Array, scratch: Array) -> Array:
    """The same loss in NumPy: in place, in blocks whose temporary stays in the cache."""
    losses = np.zeros(len(thetas))
    columns = min(x.size, TEMPORARY)
    rows = max(1, TEMPORARY // columns)
    for first in range(0, len(thetas), rows):
        B, C, D, Sx, Sy = thetas[first : first + rows].T[:, :, None]
        for start in range(0, x.size, columns):
            part = slice(start, start + columns)
            shape = len(B), x[part].size
            z = scratch[: shape[0] * shape[1]].reshape(shape)
            np.subtract(Sx, x[part], out=z)
            z *= B
            np.arctan(z, out=z)
            z *= C
            np.sin(z, out=z)
            z *= D
            z += Sy
            z -= y[part]
            losses[first : first + rows] += np.einsum("ij,ij->i", z, z)
    return losses / x.size


def measure(quick: bool) -> Measured:
    """Measure all sizes and batches that NumPy evaluates in about a second."""
    rng = np.random.default_rng(0)
    scratch = np.empty(TEMPORARY)
    tidy, table = [], []
    # Every size and batch: a force with noise, and random configurations.
    for rows in ROWS[: 4 if quick else 5]:
        x = rng.uniform(-0.22, 0.22, rows)
        y = Pacejka().predict(np.array([[12.0, 1.4, 3000.0, 0.01, 80.0]]), x)[0]
        y += 100 * rng.standard_normal(rows)
        single, double = (
            taped_loss(Pacejka(), x[None], y, rng.permutation(rows), threads=threads)
            for threads in (1, 2)
        )
        if single is None or double is None:
            raise ValueError("the machine of miho.core was not built; install with a C compiler")
        for batch in BATCHES:
            if rows * batch > (MOST_POINTS / 10 if quick else MOST_POINTS):
                continue
            thetas = LOW + (HIGH - LOW) * rng.random((batch, 5))
            jobs: dict[str, Callable[[], Any]] = {
                "one thread": partial(single.losses, thetas),
                "two threads": partial(double.losses, thetas),
                "NumPy": partial(numpy_loss, thetas, x, y, scratch),
            }
            np.testing.assert_allclose(jobs["one thread"](), jobs["NumPy"](), rtol=1e-12)
            # The forms alternate, so that a change of the processor's clock affects all of them.
            heavy = rows * batch > MOST_POINTS / 30
            repeats = 2 if heavy else 5 if quick else 15
            if (rows, batch) == JUDGED:
                repeats = 10 if quick else 40
            seconds = turns(jobs, repeats)
            ns = {k: 1e9 * min(seconds[k]) / (rows * batch) for k in METHODS}
            middle = {k: float(np.median(s)) for k, s in seconds.items()}
            two_to_one = middle["one thread"] / middle["two threads"]
            faster = middle["NumPy"] / middle["one thread"]
            tidy += [{"rows": rows, "batch": batch, "method": k, "ns": v} for k, v in ns.items()]
            table.append(
                {"rows": rows, "batch": batch}
                | {f"{k} [ns]": v for k, v in ns.items()}
                | {
                    "2 threads/1": two_to_one,
                    "NumPy/1 thread": faster,
                }
            )
            if (rows, batch) == JUDGED:
                judged = ns["one thread"], ns["NumPy"], two_to_one, faster
    alone, plain, two_to_one, faster = judged
    at = f"{JUDGED[0]} rows, batch {JUDGED[1]}"
    notes = [
        "times are ns per point, the least of several alternating calls; ratios are of medians, "
        f"because ratios of least times vary by chance; bars at {at}",
        f"NumPy took {plain:.1f} ns here and {WRITTEN_WITH} when the bars were written: at that "
        f"speed one thread would take {alone * WRITTEN_WITH / plain:.2f} ns",
    ]
    bars = [
        Bar("one thread", alone, AT_MOST, 2.2, "ns per point"),
        Bar("two threads against one", two_to_one, AT_LEAST, 1.7, "times"),
        Bar("one thread against NumPy", faster, AT_LEAST, 6, "times"),
    ]
    return Measured(pd.DataFrame(table), pd.DataFrame(tidy), bars, notes)


if __name__ == "__main__":
    benchmark(__doc__, measure, loss_figure, "loss")
