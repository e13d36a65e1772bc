"""Problems whose evaluations are made by workers, and executors that do as a test says."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miho.data import Dataset
from miho.identification import CurveFit
from miho.models import FunctionModel
from miho.optim import LeastSquaresProblem, Parameter, Problem, RunRecord, Space
from miho.optim.problem import mean_square

Array = NDArray[np.float64]
SPACE = Space((Parameter("a", "V", -5.0, 5.0), Parameter("b", "1/s", 0.01, 10.0, scale="log")))
TIMES = np.linspace(0.0, 2.0, 17)
OUTPUT = 2.0 * np.exp(-1.5 * TIMES) + 0.05 * np.cos(40 * TIMES)
LIMIT = 60.0
"""Seconds for an evaluation: with a limit, workers make each, however little it takes."""


def decay(t: Any, *, a: Any, b: Any) -> Any:
    """No formula: it branches, so that workers may be worth while."""
    if b < 0:
        raise ArithmeticError("b is negative")
    return a * np.exp(-b * t)


def decay_fit(**settings: Any) -> CurveFit:
    """The fit of it."""
    units = {"t": "", "y": ""}
    data = Dataset("decay", {"t": TIMES, "y": OUTPUT}, units, "y")
    return CurveFit(FunctionModel(decay, batched=False), data, SPACE, **settings)


class Bowl(Problem):
    """A loss of two parameters that raises in part of its box."""

    name, space = "bowl", SPACE

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        if (thetas[:, 0] > 3).any():
            raise ArithmeticError(f"a is large in {np.count_nonzero(thetas[:, 0] > 3)} rows")
        return np.asarray((thetas**2).sum(axis=1))


class Residuals(LeastSquaresProblem):
    """Residuals with derivatives of their own."""

    name, space = "residuals", SPACE

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return mean_square(thetas[:, :1] * np.exp(-thetas[:, 1:] * TIMES) - OUTPUT)

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        return np.asarray(theta[0] * np.exp(-theta[1] * TIMES) - OUTPUT)

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        decays = np.exp(-theta[1] * TIMES)
        return np.column_stack([decays, -theta[0] * TIMES * decays])


class Counted(Problem):
    """Another loss, by threads: how often each row was evaluated."""

    def __init__(self, loss: Callable[[Array], Array], name: str = "counted") -> None:
        self.name, self.space = name, SPACE
        self.counts: Counter[bytes] = Counter()
        self._loss, self._lock = loss, threading.Lock()

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        with self._lock:
            self.counts.update(theta.tobytes() for theta in thetas)
        return self._loss(thetas)


class Watched(Executor):
    """Does a call where it is given, unless the test has another idea of it."""

    def __init__(self, instead: Callable[[int, Future[Any]], bool]) -> None:
        self._max_workers = 4
        self.calls: list[tuple[Future[Any], Callable[[], Any]]] = []
        self._instead = instead

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        number = len(self.calls)
        self.calls.append((future, lambda: future.set_result(fn(*args, **kwargs))))
        if not self._instead(number, future):
            self.calls[-1][1]()
        return future


def same(first: RunRecord, second: RunRecord) -> bool:
    """Whether two runs did the same to the last bit."""
    return (
        first.error is None
        and first.outcome is second.outcome
        and first.evaluations == second.evaluations
        and first.loss == second.loss
        and np.array_equal(first.theta, second.theta)  # type: ignore[arg-type]
        and np.array_equal(first.trace.theta, second.trace.theta)
        and np.array_equal(first.trace.loss, second.trace.loss)
        and np.array_equal(first.trace.evaluations, second.trace.evaluations)
        and first.rejected == second.rejected
    )
