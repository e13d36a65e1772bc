"""Thousands of small fits: `miho.fit_many`, a loop of curve_fit, and JAX if installed.

python -m experiments.benchmarks.many_fits [--quick] [--output FOLDER]

A decay to a level: 50 rows, three parameters. Fits from a start descend from a point 20 % from the
truth; fits without a start search the box. All alternate in one run on one thread. A rate is the
rate of the fastest turn: one call of `fit_many` for all datasets, or a loop of `curve_fit` over
LOOPED datasets. On a busy machine the rate per CPU second is more reliable.
NumPy's `fit_many` is one call with a function that cannot be traced. JAX makes the same number of
batched steps for all datasets, compiled before (`jax_fits`).
"""

import importlib
import os
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import curve_fit

import miho
from experiments.benchmarks.bars import Measured, at_least, benchmark, turns
from miho.quantities import Array

DATASETS, ROWS, LOOPED = 10_000, 50, 300
BOX = {"a": (0, 10), "b": (0.05, 20), "c": (-5, 5)}
JAX, OVER_JAX = "JAX, start", 3
"""A rival, and how many times as many fits `fit_many` makes in a CPU second."""
SAME = 1e-6
"""A fit is as good as another if its error is larger by at most this fraction."""


def decay(x: Array, a: float, b: float, c: float) -> Array:
    """A decay to a level."""
    return a * np.exp(-b * x) + c


def opaque(x: Array, a: float, b: float, c: float) -> Array:
    """The same decay in a form that cannot be traced as a formula."""
    return decay(np.asarray(x), a, b, c)


def measure(quick: bool) -> Measured:
    """Measure fits per second, and the share of a sample as good as SciPy's fits from the truth."""
    rng = np.random.default_rng(0)
    count = DATASETS // (10 if quick else 1)
    t = np.linspace(0, 3, ROWS)
    truth = rng.uniform([0.5, 0.3, -1.0], [5.0, 5.0, 1.0], (count, 3))
    y = decay(t, *truth.T[:, :, None]) + 0.02 * rng.standard_normal((count, ROWS))
    near = 1.2 * truth
    start = dict(zip(BOX, near.T, strict=True))
    jobs: dict[str, Callable[[], object]] = {
        "curve_fit, start": partial(looped, t, y, near),
        "fit_many, start": partial(miho.fit_many, decay, t, y, BOX, start=start),
        "fit_many": partial(miho.fit_many, decay, t, y, BOX),
    }
    fits = dict.fromkeys(jobs, LOOPED) | {"fit_many": count, "fit_many, start": count}
    batched = jax_fits(t, y, near)
    if batched is not None:
        jobs[JAX], fits[JAX] = batched, count
    spent: dict[str, list[float]] = {name: [] for name in jobs}
    timed = {name: partial(_timed, job, spent[name]) for name, job in jobs.items()}
    seconds = {name: min(s) / fits[name] for name, s in turns(timed, 3 if quick else 10).items()}
    fits["fit_many, NumPy"], spent["fit_many, NumPy"] = count, []
    started = time.perf_counter()
    _timed(partial(miho.fit_many, opaque, t, y, BOX), spent["fit_many, NumPy"])
    seconds["fit_many, NumPy"] = (time.perf_counter() - started) / count
    frame = pd.DataFrame({"form": [*seconds], "seconds": [*seconds.values()]})
    frame["fits a second"] = 1 / frame["seconds"]
    frame["fits a CPU second"] = [fits[name] / min(spent[name]) for name in frame["form"]]
    frame["speedup"] = seconds["curve_fit, start"] / frame["seconds"]
    rate = dict(zip(frame["form"], frame["fits a second"], strict=True))
    bars = [
        at_least("fit_many from a start", rate["fit_many, start"], 100_000, "fits/s"),
        at_least("fit_many without a start", rate["fit_many"], 50_000, "fits/s"),
    ]
    if batched is not None:
        each = dict(zip(frame["form"], frame["fits a CPU second"], strict=True))
        bars.append(
            at_least("fit_many over JAX, CPU", each["fit_many, start"] / each[JAX], OVER_JAX,
                "times")
        )  # fmt: skip
    for name, initial in (("start", start), ("no start", None)):
        table = miho.fit_many(decay, t, y, BOX, start=initial)
        share = float(np.mean(_as_good(table, t, y, truth)))
        bars.append(at_least(f"as good as SciPy's from the truth, {name}", share, 1.0))
    return Measured(frame[["form", "fits a second", "fits a CPU second", "speedup"]], frame, bars)


def _timed(job: Callable[[], object], spent: list[float]) -> None:
    """Do the job and append its CPU seconds to `spent`."""
    started = time.process_time()
    job()
    spent.append(time.process_time() - started)


def looped(t: Array, y: Array, near: Array) -> None:
    """Fit the first LOOPED datasets one after the other."""
    for values, start in zip(y[:LOOPED], near[:LOOPED], strict=True):
        curve_fit(decay, t, values, start)


def _as_good(table: pd.DataFrame, t: Array, y: Array, truth: Array) -> list[bool]:
    """Whether SciPy finds no better fit from the truth, for each of the first datasets."""
    good = []
    for k in range(LOOPED):
        theta, _ = curve_fit(decay, t, y[k], truth[k], xtol=1e-12, ftol=1e-12)
        error = np.sqrt(np.mean((decay(t, *theta) - y[k]) ** 2))
        good.append(bool(table["error"].iloc[k] <= (1 + SAME) * error))
    return good


STEPS = 10
"""Levenberg-Marquardt steps of each fit; JAX makes the same number for all."""
ONE_THREAD = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


def jax_fits(t: Array, y: Array, starts: Array) -> Callable[[], Array] | None:
    """Return a function that fits decays to the rows of y (M, N) from starts (M, 3).

    It returns the parameters (M, 3), and is compiled before. None if JAX is not installed.
    """
    os.environ.setdefault("XLA_FLAGS", ONE_THREAD)
    try:
        jax = importlib.import_module("jax")
    except ImportError:
        return None
    jax.config.update("jax_enable_x64", True)
    times = jax.numpy.asarray(t)

    def decay(p: Any) -> Any:
        return p[0] * jax.numpy.exp(-p[1] * times) + p[2]

    compiled = jax.jit(jax.vmap(partial(_fit, jax, decay)))
    arguments = jax.numpy.asarray(starts), jax.numpy.asarray(y)

    def fit() -> Array:
        return np.asarray(compiled(*arguments))

    fit()
    return fit


def _fit(jax: Any, values: Callable[[Any], Any], start: Any, y: Any) -> Any:
    """Parameters after the steps; a step that does not decrease the sum of squares is undone."""

    def squares(p: Any) -> Any:
        return ((values(p) - y) ** 2).sum()

    def step(_: int, state: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        p, damping, best = state
        J = jax.jacfwd(values)(p)
        H = J.T @ J
        damped = H + damping * jax.numpy.diag(jax.numpy.diag(H))
        trial = p - _solve(jax, damped, J.T @ (values(p) - y))
        total = squares(trial)
        lower = total < best
        where = jax.numpy.where
        factor = where(lower, 0.1, 10.0)
        return where(lower, trial, p), damping * factor, where(lower, total, best)

    return jax.lax.fori_loop(0, STEPS, step, (start, 1e-3, squares(start)))[0]


def _solve(jax: Any, H: Any, g: Any) -> Any:
    """Solve three equations by Cholesky's method, which is faster here than `jax.numpy.linalg`."""
    sqrt = jax.numpy.sqrt
    a = sqrt(H[0, 0])
    b, d = H[1, 0] / a, H[2, 0] / a
    c = sqrt(H[1, 1] - b * b)
    e = (H[2, 1] - d * b) / c
    f = sqrt(H[2, 2] - d * d - e * e)
    u = g[0] / a
    v = (g[1] - b * u) / c
    z = (g[2] - d * u - e * v) / f / f
    y = (v - e * z) / c
    return jax.numpy.stack([(u - b * y - d * z) / a, y, z])


if __name__ == "__main__":
    benchmark(__doc__, measure, "many_fits")
