"""Workers in virtual time: a discrete-event model behind the evaluations of a real search.

Methods, oracle and evaluations are the real ones, and so are their decisions; only a worker's
seconds pass as fast as they can be counted. The client hands tasks to workers one after the other,
each of which costs it `overhead` seconds, and a worker does one task at a time, in the order in
which they were handed over.
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
from miho.optim import Budget, Optimizer
from miho.optim.meter import Clock
from miho.parallel import Evaluations, Pool
from miho.parallel.remote import Answer


class VirtualPool:
    """What `Evaluations` uses of a pool, with `size` workers whose time is virtual."""

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
        """Have an evaluation take so long: what models call."""
        self._slept += seconds

    def share(self, function: Callable[[Any], Any]) -> Callable[[Any], Future[Answer]]:
        """What has the function called by a worker, with an argument."""
        return partial(self._call, function)

    def _call(self, function: Callable[[Any], Any], argument: Any) -> Future[Answer]:
        """Compute the answer at once, and keep it until the time at which it would come."""
        self._slept = 0.0
        answer = Answer(function(argument), self._slept)
        self._handed_over = max(self._handed_over, self.now) + self._overhead
        end = max(self._handed_over, heapq.heappop(self._free)) + self._slept
        heapq.heappush(self._free, end)
        future: Future[Answer] = Future()
        heapq.heappush(self._ends, (end, next(self._numbers), future, answer))
        return future

    def connected(self) -> bool:
        """Always: these workers cannot leave."""
        return True

    def wait(self, news: threading.Event) -> None:
        """Let time go on until a call has ended."""
        while not news.is_set():
            self.now, _, future, answer = heapq.heappop(self._ends)
            if future.set_running_or_notify_cancel():
                future.set_result(answer)
        news.clear()

    def flush(self) -> None:
        """No call waits for others."""


def virtual_search(
    optimizer: Optimizer,
    lengths: Lengths,
    workers: int,
    overhead: float,
    budget: Budget,
    seed: int = 0,
) -> Search:
    """The search of a sleeping model by virtual workers; its seconds are virtual.

    The first evaluation, which a real search makes alone to see how long one takes, costs the mean.
    All are made by workers (`limited`): what were made here would take no virtual time.
    """
    pool = VirtualPool(workers, overhead)
    pool.now = lengths.mean
    evaluations = Evaluations(cast(Pool, pool), limited=True)
    clock = Clock(lambda: pool.now, lambda: 0.0)
    problem = Sleeping(lengths, pool.sleep)
    ended = search(optimizer, problem, evaluations, budget, seed, clock)
    return Search(ended.seconds + lengths.mean, ended.evaluations, ended.work, ended.loss)
