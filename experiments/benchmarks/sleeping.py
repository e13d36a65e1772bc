"""A model with prescribed evaluation times, and workers that are real or in virtual time.

The model is a decay that sleeps before each evaluation. In virtual time only the seconds of the
workers are simulated, by discrete events: the client sends tasks one after the other, each of which
costs it `overhead` seconds, and a worker executes one task at a time, in the order of sending.

`simulation_times` measures seconds to prescribe. The car of `single_track_response` drives the
steering test, simulated by SciPy's `solve_ivp` with default settings (RK45, adaptive steps). Stiff
axles need more steps, a sliding car fewer.
"""

import contextlib
import hashlib
import heapq
import itertools
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any, cast

import numpy as np
from scipy.special import ndtri

from experiments.app.build import build_problem
from experiments.app.compose import composed
from miho.models import Trajectory
from miho.optim import (
    Budget,
    BudgetExhausted,
    Clock,
    LeastSquaresProblem,
    Optimizer,
    Oracle,
    Parameter,
    Space,
)
from miho.optim.problem import mean_square
from miho.optim.seeds import stream
from miho.parallel import Evaluations, Pool, open_pool
from miho.parallel.process_executor import ProcessExecutor
from miho.parallel.remote import Answer
from miho.quantities import Array
from miho.vehicle.data.synthetic_handling import manoeuvre

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


class VirtualPool:
    """The part of a pool that `Evaluations` uses, with `size` workers in virtual time."""

    def __init__(self, size: int, overhead: float) -> None:
        self.size, self.limit = size, None
        self.now = 0.0
        self._overhead = overhead
        self._handed_over = 0.0
        self._free = [0.0] * size
        self._slept = 0.0
        self._numbers = itertools.count()
        self._ends: list[tuple[float, int, Future[Answer], Answer]] = []

    def sleep(self, seconds: float) -> None:
        """Add to the virtual seconds of the current evaluation; models call this."""
        self._slept += seconds

    def share(self, function: Callable[[Any], Any]) -> Callable[[Any], Future[Answer]]:
        """Return a function that has a worker call `function` with an argument."""
        return partial(self._call, function)

    def _call(self, function: Callable[[Any], Any], argument: Any) -> Future[Answer]:
        """Compute the answer at once, and keep it until its virtual time of arrival."""
        self._slept = 0.0
        answer = Answer(function(argument), self._slept)
        self._handed_over = max(self._handed_over, self.now) + self._overhead
        end = max(self._handed_over, heapq.heappop(self._free)) + self._slept
        heapq.heappush(self._free, end)
        future: Future[Answer] = Future()
        heapq.heappush(self._ends, (end, next(self._numbers), future, answer))
        return future

    def connected(self) -> bool:
        """Always true: virtual workers cannot be lost."""
        return True

    def wait(self, news: threading.Event) -> None:
        """Advance the virtual time until a call has ended."""
        while not news.is_set():
            self.now, _, future, answer = heapq.heappop(self._ends)
            if future.set_running_or_notify_cancel():
                future.set_result(answer)
        news.clear()

    def flush(self) -> None:
        """Do nothing: no call waits for others."""


def virtual_search(
    optimizer: Optimizer,
    lengths: Lengths,
    workers: int,
    overhead: float,
    budget: Budget,
    seed: int = 0,
) -> Search:
    """Search with a sleeping model and virtual workers; the seconds of the result are virtual.

    The first evaluation, which a real search makes alone to measure its time, costs the mean.
    Every evaluation is sent to a worker (`limited`), because an evaluation in this process would
    take no virtual time.
    """
    pool = VirtualPool(workers, overhead)
    pool.now = lengths.mean
    evaluations = Evaluations(cast(Pool, pool), limited=True)
    clock = Clock(lambda: pool.now, lambda: 0.0)
    problem = Sleeping(lengths, pool.sleep)
    ended = search(optimizer, problem, evaluations, budget, seed, clock)
    return Search(ended.seconds + lengths.mean, ended.evaluations, ended.work, ended.loss)


DRAWS = 512
DURATION = 6.0
"""Seconds of the manoeuvre."""
TOLERANCE = 1e-6


def simulation_times() -> Array:
    """Seconds (DRAWS,) of simulations with parameters drawn uniformly, the shortest first."""
    return np.sort([_seconds(simulation) for simulation in simulations(DRAWS)])


def simulations(draws: int) -> list[Callable[[], Any]]:
    """Functions without arguments that simulate and return SciPy's solution."""
    problem = build_problem(composed(["model=single_track_response", "dataset=steering_test"]))
    model, space = cast(Trajectory, problem.model), problem.space
    thetas = space.decode(space.sample(draws, np.random.default_rng(0), "uniform"))
    names = [parameter.name for parameter in space.parameters]
    return [partial(_simulated, model, dict(zip(names, row, strict=True))) for row in thetas]


def _simulated(model: Trajectory, parameters: Mapping[str, float]) -> Any:
    from scipy.integrate import solve_ivp  # the import takes a second

    def rates(t: float, state: Array) -> tuple[float, ...]:
        vx, steering = manoeuvre(np.asarray(t), DURATION)
        motion: tuple[float, ...] = model.rhs(*state, vx, steering, **parameters)
        return motion

    return solve_ivp(rates, (0, DURATION), np.zeros(2), rtol=TOLERANCE, atol=TOLERANCE)


def _seconds(simulation: Callable[[], Any]) -> float:
    began = time.perf_counter()
    simulation()
    return time.perf_counter() - began


PROCESSES, DASK = "processes", "Dask"
PATIENCE = 300.0
"""Time limit [s] for the start of all workers."""
NAP = 0.1


def engines() -> list[str]:
    """Names of the engines: processes, and Dask if its libraries are installed."""
    installed = find_spec("distributed") and find_spec("miho.parallel.cluster")
    return [PROCESSES, *([DASK] if installed else [])]


@contextmanager
def started(engine: str, size: int) -> Iterator[Pool]:
    """Yield a pool whose `size` workers have all started.

    Raises RuntimeError if the workers do not start.
    """
    with ExitStack() as stack:
        if engine == PROCESSES:
            executor = ProcessExecutor(size)
            stack.callback(executor.shutdown)
            pool = stack.enter_context(open_pool(executor))
        else:
            pool = stack.enter_context(open_pool(f"dask:{size}"))
        if pool is None:
            raise RuntimeError(f"{engine} gives no pool of {size}")
        _start_all(pool)
        yield pool


def _start_all(pool: Pool) -> None:
    """Wait until each worker of a pool has finished a task."""
    began, nap, seen = time.perf_counter(), NAP, set[int]()
    while len(seen) < pool.size:
        if time.perf_counter() - began > PATIENCE:
            raise RuntimeError(f"{len(seen)} of {pool.size} workers started in {PATIENCE:g} s")
        seen |= set(pool.map(_nap, [nap] * pool.size))
        nap = min(2 * nap, 1.0)  # long enough that no worker gets two while another starts


def _nap(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()
