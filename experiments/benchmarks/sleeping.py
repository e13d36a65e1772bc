"""A model with prescribed evaluation times: a decay that sleeps before each evaluation."""

from __future__ import annotations

import contextlib
import hashlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from miho.optim import (
    Budget,
    BudgetExhausted,
    LeastSquaresProblem,
    Optimizer,
    Oracle,
    Parameter,
    Space,
)
from miho.optim.meter import Clock
from miho.optim.problem import mean_square
from miho.optim.seeds import stream
from miho.parallel import Evaluations
from miho.quantities import Array

SIGMA = 0.7
"""Standard deviation of the natural logarithm of log-normal times."""
ROWS, NOISE = 60, 0.05


@dataclass(frozen=True)
class Lengths:
    """Seconds of the evaluation of a configuration (d,), on average `mean`.

    The seconds are spread log-normally by `sigma` (0: all equal), or like the `measured` seconds,
    which are sorted. They follow from a hash of the configuration, so that they are the same on
    every worker.
    """

    mean: float
    sigma: float = 0.0
    measured: tuple[float, ...] = ()

    def __call__(self, theta: Array) -> float:
        """Seconds of this configuration."""
        if not (self.sigma or self.measured):
            return self.mean
        digest = hashlib.blake2b(theta.tobytes(), digest_size=8).digest()
        uniform = (int.from_bytes(digest, "little") + 0.5) / 2**64
        if self.measured:
            length = self.measured[int(uniform * len(self.measured))]
            return self.mean * length * len(self.measured) / math.fsum(self.measured)
        return self.mean * math.exp(self.sigma * float(ndtri(uniform)) - self.sigma**2 / 2)


class Decay(LeastSquaresProblem):
    """y = a exp(-b x) + c sin(d x) with noise, in a wide box; residuals in plain NumPy."""

    name = "decay"
    linear = ("a", "c")
    rows = ROWS

    def __init__(self) -> None:
        self.space = Space(
            (
                Parameter("a", "1", 0, 10),
                Parameter("b", "1", 0, 5),
                Parameter("c", "1", -5, 5),
                Parameter("d", "1", 0.5, 5),
            )
        )
        self._x = np.random.default_rng(1).permutation(np.linspace(0, 4, ROWS))
        self._y = np.zeros(ROWS)
        truth = np.array([4.0, 1.2, 1.0, 2.0])
        noise = NOISE * np.random.default_rng(2).standard_normal(ROWS)
        self._y = self.residuals(truth) + noise

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Mean square of the residuals."""
        return np.array([mean_square(self.residuals(theta, fidelity)) for theta in thetas])

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Residuals (m,) of the first rows."""
        (a, b, c, d), m = theta, round(fidelity * ROWS)
        x = self._x[:m]
        return np.asarray(a * np.exp(-b * x) + c * np.sin(d * x) - self._y[:m])

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives (m, 4) of the residuals."""
        (a, b, c, d), x = theta, self._x[: round(fidelity * ROWS)]
        decay = np.exp(-b * x)
        return np.column_stack([decay, -a * x * decay, np.sin(d * x), c * x * np.cos(d * x)])


class Sleeping(LeastSquaresProblem):
    """A decay that calls `sleep` for the time of each evaluation, less for a part of the rows.

    Derivatives take as long as differences: one evaluation for each parameter.
    """

    linear, rows = Decay.linear, Decay.rows

    def __init__(self, lengths: Lengths, sleep: Callable[[float], None] = time.sleep) -> None:
        self._inner, self._lengths, self._sleep = Decay(), lengths, sleep
        self.name, self.space = self._inner.name, self._inner.space

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,), one after the other."""
        self._sleep(fidelity * sum(self._lengths(theta) for theta in thetas))
        return self._inner.loss(thetas, fidelity)

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Residuals (m,) of the first rows."""
        self._sleep(fidelity * self._lengths(theta))
        return self._inner.residuals(theta, fidelity)

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives (m, d) of the residuals."""
        self._sleep(len(self.space) * fidelity * self._lengths(theta))
        return self._inner.jacobian(theta, fidelity)


@dataclass(frozen=True)
class Search:
    """Result of a search: wall seconds, evaluations, seconds of all evaluations, best loss."""

    seconds: float
    evaluations: float
    work: float
    loss: float


def search(
    optimizer: Optimizer,
    problem: LeastSquaresProblem,
    evaluations: Evaluations,
    budget: Budget,
    seed: int = 0,
    clock: Clock | None = None,
) -> Search:
    """Search like `minimize`, with running workers, real or virtual.

    `MIHOGN` and `AsynchronousMIHOGN` use the same random numbers, so that their seeds are paired.
    """
    oracle = Oracle(
        problem.spread(evaluations),
        budget,
        space=problem.space.seeded(problem.name, seed),
        clock=clock,
        evaluations=evaluations,
    )
    name = type(optimizer).__name__.removeprefix("Asynchronous")
    with contextlib.suppress(BudgetExhausted):
        optimizer.run(oracle, stream("own", problem.name, seed, name))
    seconds = oracle.seconds
    evaluations.close()
    oracle.stop()
    return Search(seconds, oracle.evaluations, evaluations.usage.seconds, oracle.best)
