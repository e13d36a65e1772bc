"""One function at many arguments, by workers where it takes long: in blocks, and in their order."""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass
from typing import Any

from miho.parallel.pool import LOOK, Pool
from miho.parallel.process_executor import WorkerLostError
from miho.parallel.remote import Answer
from miho.parallel.worth import WORTH_SENDING

LEAST, MOST = 1e-9, 1000
"""Seconds that a call takes at least, and calls in a block at most: what takes less than some 5 µs
is not worth sending at all."""
AHEAD = 3
"""Blocks for each worker that are under way: their arguments are made as they are needed."""


@dataclass(frozen=True)
class _Block:
    """Calls a function at several arguments."""

    function: Callable[[Any], Any]

    def __call__(self, arguments: Sequence[Any]) -> list[Any]:
        return [self.function(argument) for argument in arguments]


def in_blocks(
    pool: Pool | None,
    function: Callable[[Any], Any],
    arguments: Iterable[Any],
    seconds: float | None = None,
    check: Callable[[], object] = lambda: None,
) -> Iterator[Any]:
    """What a function gives at each argument, in their order; raises what it raises.

    It takes some `seconds`; where that is not known the first is called here and measured. Where
    there is no pool, or a call takes little time, all are called here. `check` is called while
    answers are waited for, and may raise. Where a worker ends without an answer, its
    WorkerLostError stands in the place of each value.
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
    call = pool.share(_Block(function))
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
                yield from _answer(future, check)
            except WorkerLostError as error:
                yield from itertools.repeat(error, length)
    finally:
        for _, future in under_way:
            future.cancel()


def _answer(future: Future[Answer], check: Callable[[], object]) -> list[Any]:
    """What a worker answers, waited for so that signals are seen."""
    while not future.done():
        wait([future], LOOK)
        check()
    answer = future.result()
    if answer.raised is not None:
        raise answer.raised.as_error()
    return list(answer.value)
