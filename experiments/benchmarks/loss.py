"""What one point of the tire's loss costs: here, in NumPy, and at the processor's limit.

python -m experiments.benchmarks.loss [--quick] [--output FOLDER]

The limit: with fused multiply-adds, which the machine of formulas does not use, a point takes 12
multiplications and 20 of them, counted by hand in `miho.models.tire` and the functions that numba
compiles (`miho.compiled.polynomials`), besides 8 additions and one division, which
other units of the processor do meanwhile: 61 floating-point operations. It reads 16 bytes, the
slip angle and the force; temporaries stay in the first-level cache. The time is that of 32 fused
multiply-adds at the rate measured here with a kernel that does nothing else, or that of the 16
bytes at the measured rate of reading, if it is longer.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray

from experiments.benchmarks.bars import (
    AT_LEAST,
    AT_MOST,
    Bar,
    Measured,
    benchmark,
    interleaved,
    turns,
)
from miho.analysis.figures.benchmark import loss_figure
from miho.compiled.fused import FusedLoss
from miho.models import Pacejka

Array = NDArray[np.float64]

ROWS = (100, 300, 3000, 30_000, 3_000_000)
BATCHES = (1, 10, 100, 1000, 10_000)
MOST_POINTS = 3e7
"""Points of one call; beyond, NumPy takes seconds."""
JUDGED = 3000, 1000
"""Rows and batch at which the bars are judged."""
WRITTEN_WITH = 15.5
"""ns per point of NumPy when the bars were written."""
METHODS = "one thread", "two threads", "NumPy"
TEMPORARY = 50_000
"""Numbers per temporary of the NumPy loss."""

MULTIPLIED, FLOPS, BYTES = 32, 61, 16
LOW, HIGH = np.array([2, 1, 1000, -0.05, -500.0]), np.array([40, 2.5, 6000, 0.05, 500.0])
CHAIN, LANES = 12, 2048
"""Multiply-adds per number, of that many numbers: enough to hide loading and storing, and few
enough that the processor overlaps several numbers; with 32 the measured rate is a quarter lower."""


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


@njit(cache=True, nogil=True, fastmath={"contract"})  # type: ignore[untyped-decorator]
def multiply_add(x: Array, times: int = 1) -> None:
    """CHAIN dependent multiply-adds of each number; the processor overlaps those of several."""
    for _ in range(times):
        for i in range(x.size):
            v = x[i]
            for _ in range(CHAIN):
                v = v * 0.5 + 0.25
            x[i] = v


def limit() -> tuple[float, float]:
    """Seconds per fused multiply-add and per byte read from memory, of one core."""
    few, many = np.ones(LANES), np.ones(6_000_000)
    least = interleaved({"fma": lambda: multiply_add(few), "read": lambda: many.sum()}, 20)
    return least["fma"] / (CHAIN * LANES), least["read"] / many.nbytes


def arithmetic(threads: int) -> Callable[[], None]:
    """The same multiply-adds, some milliseconds of them, shared by so many threads."""
    pool, numbers = ThreadPoolExecutor(threads), [np.ones(LANES) for _ in range(threads)]

    def job() -> None:
        for task in [pool.submit(multiply_add, x, 6000 // threads) for x in numbers]:
            task.result()

    return job


def measure(quick: bool) -> Measured:
    """All sizes and batches that NumPy can do in about a second."""
    rng = np.random.default_rng(0)
    scratch = np.empty(TEMPORARY)
    # The processor's limit for a point [ns].
    per_fma, per_byte = limit()
    bound = 1e9 * max(MULTIPLIED * per_fma, BYTES * per_byte)
    tidy, table = [], []
    # Every size and batch: a force with noise, and random configurations.
    for rows in ROWS[: 4 if quick else 5]:
        x = rng.uniform(-0.22, 0.22, rows)
        y = Pacejka().predict(np.array([[12.0, 1.4, 3000.0, 0.01, 80.0]]), x)[0]
        y += 100 * rng.standard_normal(rows)
        single, double = (
            FusedLoss(Pacejka(), x[None], y, rng.permutation(rows), threads) for threads in (1, 2)
        )
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
            # In turns, so that a change of the clock strikes all alike.
            heavy = rows * batch > MOST_POINTS / 30
            repeats = 2 if heavy else 5 if quick else 15
            if (rows, batch) == JUDGED:
                repeats = 10 if quick else 40
                jobs |= {"alone": arithmetic(1), "shared": arithmetic(2)}
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
                    "1 thread/limit": ns["one thread"] / bound,
                }
            )
            if (rows, batch) == JUDGED:
                judged = ns["one thread"], ns["NumPy"], two_to_one, faster
                machine = middle["alone"] / middle["shared"]
    tidy += [{"rows": n, "batch": 0, "method": "limit", "ns": bound} for n in ROWS]
    alone, plain, two_to_one, faster = judged
    at = f"{JUDGED[0]} rows, batch {JUDGED[1]}"
    notes = [
        "times are ns per point, the least of several calls in turns; ratios are of their medians, "
        f"because the least is the luck of one core, or of two at once; bars at {at}",
        f"two threads of multiply-adds alone, in the same turns: {machine:.2f} times one",
        f"limit: {FLOPS} flops and {BYTES} bytes a point; {1e-9 / per_fma:.1f}e9 multiply-adds/s "
        f"and {1e-9 / per_byte:.1f} GB/s measured, so {1e9 * MULTIPLIED * per_fma:.2f} ns of "
        f"arithmetic and {1e9 * BYTES * per_byte:.2f} ns of reading",
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
