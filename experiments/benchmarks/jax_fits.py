"""Many small fits by JAX, a rival of `miho.fit_many`: batched, compiled steps on one thread."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from miho.quantities import Array

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
