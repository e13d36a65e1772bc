"""Workers in virtual time: a discrete-event simulation for the evaluations of a real search.

Methods, oracle, evaluations and decisions are real; only the seconds of the workers are virtual.
The client sends tasks to workers one after the other, and each task costs it `overhead` seconds. A
worker executes one task at a time, in the order of sending.
"""

from __future__ import annotations

import heapq
import itertools
import threading
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Any, cast

from experiments.benchmarks.sleeping import Lengths, Search, Sleeping, search
from miho.optim import Budget, Clock, Optimizer
from miho.parallel import Evaluations, Pool
from miho.parallel.remote import Answer


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
