"""Map a function over arguments with workers: in blocks, with the results in order."""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from functools import partial
from typing import Any

from miho.parallel.pool import Pool, value_of
from miho.parallel.process_executor import WorkerLostError
from miho.parallel.remote import Answer
from miho.parallel.usage import WORTH_SENDING

LEAST, MOST = 1e-9, 1000
"""Shortest assumed duration of a call [s], and the most calls in a block. Calls shorter than about
5 µs are never sent to workers."""
AHEAD = 3
"""Blocks in progress per worker. Arguments are generated only as blocks are sent."""


def _values(function: Callable[[Any], Any], arguments: Sequence[Any]) -> list[Any]:
    return [function(argument) for argument in arguments]


def in_blocks(
    pool: Pool | None,
    function: Callable[[Any], Any],
    arguments: Iterable[Any],
    seconds: float | None = None,
    check: Callable[[], object] = lambda: None,
) -> Iterator[Any]:
    """Yield the value of a function at each argument, in the order of the arguments.

    Exceptions of the function are raised. A call takes about `seconds`; if that is None, the first
    call is made here and timed. Without a pool, or if calls are short, all calls are made here.
    `check` is called while the iterator waits for workers, and may raise. If a worker ends without
    an answer, a WorkerLostError is yielded in place of each value of its block.
    """
    todo = iter(arguments)
    if pool is None:
        yield from map(function, todo)
        return
    for first in itertools.islice(todo, 0 if seconds is not None else 1):
        started = time.perf_counter()
        value = function(first)
        seconds = time.perf_counter() - started
        yield value
    size = max(1, math.ceil(WORTH_SENDING / max(seconds or 0.0, LEAST)))
    if size > MOST:
        yield from map(function, todo)
        return
    call = pool.share(partial(_values, function))
    blocks = iter(lambda: list(itertools.islice(todo, size)), [])
    under_way: deque[tuple[int, Future[Answer]]] = deque()
    try:
        while True:
            for block in itertools.islice(blocks, AHEAD * pool.size - len(under_way)):
                under_way.append((len(block), call(block)))
            pool.flush()
            if not under_way:
                return
            length, future = under_way.popleft()
            try:
                yield from value_of(future, check)
            except WorkerLostError as error:
                yield from itertools.repeat(error, length)
    finally:
        for _, future in under_way:
            future.cancel()
