"""Evaluations by workers: submitted before their values are needed, each made and logged once."""

from __future__ import annotations

import contextlib
import itertools
import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, InvalidStateError
from functools import partial
from typing import Any

import numpy as np

from miho.parallel.errors import NoWorkersLeft
from miho.parallel.journal import Journal, Key
from miho.parallel.journal_check import JournalCheck
from miho.parallel.pool import Pool, lost
from miho.parallel.process_executor import HungError, OverdueError, WorkersGoneError
from miho.parallel.remote import Answer, Raised
from miho.parallel.rows import Ahead, ByRows, Evaluated, Pending, Rows, Send, as_array
from miho.parallel.usage import Usage, Worth
from miho.parallel.worth import is_expensive
from miho.quantities import Array

MOST_LOST = 50
"""Chunks in a row that may end their workers before the run gives up."""
PATIENCE = 7.0
"""Seconds that a broken connection has to recover. Dask tries for five."""
MOST_KEPT = 1000
"""Values of failed batches that are kept, in case their rows are requested again one by one."""


class Evaluations:
    """Make the evaluations of a run, by workers or here, and keep them in a journal.

    The first evaluation is made here and timed. Workers make the others if they take long enough.

    Parameters
    ----------
    pool : Pool or None
        The workers; None for none.
    journal : Journal, optional
        Keeps the expensive evaluations.
    limited : bool
        Whether the pool limits the duration of an evaluation. Workers then make all evaluations,
        including the first.

    Attributes
    ----------
    usage : Usage
        Counts of evaluations and their durations.
    worth : Worth
        Decides whether an evaluation is sent to a worker.
    check : callable
        Called while values are waited for. It may raise, to end the wait.

    Raises
    ------
    NoWorkersLeft
        By requests for values, if no worker can evaluate anything any more.
    StaleJournalError
        By requests for values, if the journal belongs to functions that have changed.
    """

    def __init__(
        self, pool: Pool | None, journal: Journal | None = None, *, limited: bool = False
    ) -> None:
        self.usage = Usage(1 if pool is None else pool.size)
        self.worth = Worth(self.usage, limited=limited)
        self.check: Callable[[], None] = lambda: None
        self._pool, self._journal = pool, journal
        self._checked = None if journal is None else JournalCheck(journal)
        self._pending: dict[Key, Pending] = {}
        self._here: dict[Key, Array | Raised] = {}  # values that are known but not requested yet
        self._ends = itertools.count(0 if journal is None else len(journal))
        self._arrivals, self._news = threading.Lock(), threading.Event()
        self._submitted: list[Key] | None = None
        self._lost = 0  # chunks in a row
        self._latest = time.monotonic()  # time of the last value or cancellation
        self._broken = math.inf  # time since which the connection is broken

    def function(
        self,
        name: str,
        function: Rows,
        shape: tuple[int, ...] = (),
        losses: Callable[[Array], Array] | None = None,
    ) -> Evaluated:
        """The same function, evaluated by workers; `name` is its key in the journal."""
        send = None if self._pool is None else self._pool.share(ByRows(function))
        return Evaluated(name, function, shape, self, send, losses)

    def known(self, name: str) -> list[tuple[Array, Array]]:
        """Parameter rows and values of a function in the journal."""
        return [] if self._journal is None else self._journal.values_of(name)

    @property
    def may_repeat(self) -> bool:
        """Whether an evaluation may be repeated: not if a journal keeps it or if it may hang."""
        return self._journal is None and not self.worth.limited

    @property
    def workers(self) -> int:
        """Number of evaluations that can be in progress at a time."""
        return self.usage.workers

    def resting(self) -> bool:
        """Return whether evaluations are so short that this one is made here, untimed."""
        return self.worth.resting() and self._submitted is None

    @property
    def spreads(self) -> bool:
        """Whether workers make evaluations, because each is known to take long enough."""
        return self._pool is not None and self.worth.measured and not self.worth.short

    @property
    def worth_one(self) -> bool:
        """Whether sending single evaluations to workers is known to save time."""
        return self._pool is not None and self.worth.alone

    def ahead(self, ask: Callable[[], object]) -> Ahead:
        """Begin all evaluations that `ask` needs, without waiting; discard the result of `ask`."""
        keys: list[Key] = []
        if self._pool is not None and not self.worth.short:
            self._submitted = keys
            try:
                ask()
            except Exception:  # noqa: BLE001, S110 -- it raises again when its value is requested
                pass
            finally:
                self._submitted = None
        if keys and self._pool is not None:
            self._pool.flush()
        return Ahead(keys, ask, self.worth.measured)

    def first_ready(self, needs: Sequence[Ahead]) -> int:
        """Position of the need that was completed first, or 0 if none has to wait for workers.

        Needs whose evaluations were not begun are begun.
        """
        needs = [need if need.begun else self.ahead(need.again) for need in needs]
        while True:
            ends = [self._end_of_all(need) if need.left else need.latest for need in needs]
            first = min(ends)
            if first < math.inf:
                return ends.index(first)
            pending = (self._pending.get(key) for need in needs for key in need.left)
            self._wait(each for each in pending if each is not None and each.ended == math.inf)

    def close(self) -> None:
        """Cancel all evaluations that are not done."""
        for pending in self._pending.values():
            pending.future.cancel()
        self._pending.clear()
        self.usage.end()

    def values(self, task: Evaluated, thetas: Array) -> Array:
        """Values (n, ...) of rows (n, d); raises the first error among them."""
        known = self._pending or self._here or (self._journal is not None and len(self._journal))
        if self.worth.short and self._submitted is None and not known:
            brief = self._evaluate_at_once(task, thetas)
            self.worth.rest()
            return brief
        if self._checked is not None:
            self._checked(task.name, partial(self._again, task), task.losses)
        keys: list[Key] = [(task.name, theta.tobytes()) for theta in thetas]
        stores = self._pending, self._here, () if self._journal is None else self._journal
        todo = [k for k, key in enumerate(keys) if not any(key in store for store in stores)]
        if self._submitted is not None:
            if self.worth.measured:
                self._submit(task, keys, thetas, todo)
            self._submitted += keys
            return np.full((len(thetas), *task.shape), math.nan)  # a placeholder
        while todo and not self.worth.measured:
            self._evaluate_here(task, keys, thetas, [todo.pop(0)])
        if todo and not self._submit(task, keys, thetas, todo):
            journaled = self._journal is not None and self.worth.expensive
            if len(todo) == len(keys) and not journaled:  # as without workers and journal
                return self._evaluate_at_once(task, thetas)
            self._evaluate_here(task, keys, thetas, todo)
        # If one row raised, the values of the others are kept for later requests.
        values = [self._value(key) for key in keys]
        errors = [value for value in values if isinstance(value, Raised)]
        if not errors or len(keys) == 1:
            for key in keys:
                self._here.pop(key, None)
        else:
            while len(self._here) > max(MOST_KEPT, len(keys)):
                del self._here[next(iter(self._here))]
        if errors:
            raise errors[0].as_error()
        return np.array(values, dtype=float)

    @property
    def busy(self) -> int:
        """Number of workers in use."""
        waiting = {id(p) for p in self._pending.values() if p.ended == math.inf}
        return min(len(waiting), self.workers)

    def _end_of(self, key: Key) -> float:
        """Position of a value in the order of completion.

        It is infinite while a worker makes the value, and the largest finite number while it is not
        known whether workers make evaluations.
        """
        if key in self._pending:
            return self._pending[key].ended
        if self._journal is not None and key in self._journal:
            return float(self._journal.place(key))
        return -1.0 if key in self._here or self.worth.measured else sys.float_info.max

    def _end_of_all(self, need: Ahead) -> float:
        """Position at which the last value was completed; infinite while a worker makes one."""
        while need.left:
            end = self._end_of(need.left[-1])
            if end == math.inf:
                return end
            need.latest = max(need.latest, end)
            need.left.pop()
        return need.latest

    def _submit(
        self, task: Evaluated, keys: Sequence[Key], thetas: Array, todo: Sequence[int]
    ) -> bool:
        """Submit rows to workers, if that saves time; return whether they were submitted."""
        if self._pool is None or task.send is None or not todo:
            return False
        rows = self.worth.chunk(len(todo), at_once=self._submitted is None)
        if not rows:
            return False
        self._send(task.send, self._pool, rows, [keys[k] for k in todo], thetas[list(todo)])
        return True

    def _send(self, send: Send, pool: Pool, rows: int, keys: Sequence[Key], thetas: Array) -> None:
        """Submit all rows to workers, in chunks of `rows`."""
        self.usage.begin()
        for start in range(0, len(keys), rows):
            members = keys[start : start + rows]
            pending = Pending(send(thetas[start : start + rows]), members)
            self._pending |= dict.fromkeys(members, pending)
            pending.future.add_done_callback(self._arrival(pending))
        pool.flush()

    def _again(self, task: Evaluated, keys: Sequence[Key]) -> list[Array | Raised]:
        """Known, expensive values, evaluated again in parallel."""
        thetas = np.array([np.frombuffer(key[1], dtype=float) for key in keys])
        if self._pool is not None and task.send is not None:
            self._send(task.send, self._pool, 1, keys, thetas)
        else:
            self._evaluate_here(task, keys, thetas, range(len(keys)))
        values = [self._value(key) for key in keys]
        for key in keys:
            self._here.pop(key, None)
        return values

    def _arrival(self, pending: Pending) -> Callable[[Future[Answer]], None]:
        """A callback that records the order of completion and logs expensive answers at once.

        The threads that deliver answers call it.
        """

        def arrived(future: Future[Answer]) -> None:
            with self._arrivals:
                try:
                    self._note(pending.keys, future)
                finally:  # a value is written to the journal before it is used
                    pending.ended, self._latest = next(self._ends), time.monotonic()
            self._news.set()

        return arrived

    def _note(self, keys: Sequence[Key], future: Future[Answer]) -> None:
        """Write an expensive answer to the journal."""
        if self._journal is None or future.cancelled() or future.exception() is not None:
            return
        answer = future.result()
        if not is_expensive(answer.seconds, len(keys)):
            return
        values = answer.value if answer.raised is None else [answer.raised] * len(keys)
        for key, value in zip(keys, values, strict=True):
            if _is_the_models(value):
                self._journal.add(key, as_array(value))

    def _value(self, key: Key) -> Array | Raised:
        """The value of a row; waits for it if necessary."""
        if key in self._here:
            return self._here[key]
        if key not in self._pending and self._journal is not None:
            self.usage.known += self._journal.place(key) < self._journal.loaded
            self.worth.remember()
            return self._journal[key]
        pending = self._pending[key]
        while pending.ended == math.inf:
            self._wait([pending])
        self._take(pending)
        return self._here[key]

    def _take(self, pending: Pending) -> None:
        """Store the values of a completed chunk."""
        rows = len(pending.keys)
        try:
            answer = pending.future.result()
            values: Any = answer.value if answer.raised is None else [answer.raised] * rows
            each = answer.seconds / rows
            self.worth.count(each, rows, here=False, raised=isinstance(values[0], Raised))
            self._lost = 0
        except WorkersGoneError as error:
            raise NoWorkersLeft(str(error)) from None
        except Exception as error:  # noqa: BLE001 -- the worker ended without an answer
            values = [lost(error)] * rows
            self._lost += not isinstance(error, OverdueError)
            if self._lost >= MOST_LOST:
                raise NoWorkersLeft(
                    f"the last {MOST_LOST} evaluations ended their workers ({error}); "
                    "run the model without workers"
                ) from None
        for key, value in zip(pending.keys, values, strict=True):  # in the journal already
            self._pending.pop(key, None)
            self._here[key] = as_array(value)

    def _wait(self, waiting: Iterable[Pending]) -> None:
        """Wait for the next value; then call `check` and give up evaluations that exceed the limit.

        This process cannot end the workers of another library. If no value came for as long as the
        limit, the evaluations that are waited for are given up, and the workers that make them are
        left busy.
        """
        if self._pool is None:  # nothing is in progress
            return
        self._pool.wait(self._news)
        self.check()
        now, limit = time.monotonic(), self._pool.limit
        self._broken = math.inf if self._pool.connected() else min(self._broken, now)
        if now > self._broken + PATIENCE:  # Dask does not report it to every call
            raise NoWorkersLeft("the connection to the Dask scheduler broke")
        if limit is None:
            return
        overdue = [p for p in waiting if now - max(p.begun, self._latest) > limit]
        if overdue and self._pool.empty():  # no worker has begun them
            self._latest = now
            return
        for pending in {id(p): p for p in overdue}.values():
            with contextlib.suppress(InvalidStateError):  # its value has just come
                pending.future.set_exception(
                    HungError(f"no end within {limit:g} s, so it was given up", again=False)
                )

    def _keep(self, key: Key, value: Array | Raised, seconds: float) -> None:
        """Store a value that was evaluated here in `seconds`."""
        self._here[key] = value
        if self._journal is not None and is_expensive(seconds) and _is_the_models(value):
            with self._arrivals:
                self._journal.add(key, value)

    def _evaluate_at_once(self, task: Evaluated, thetas: Array) -> Array:
        started = time.perf_counter()
        values = task.function(thetas)
        self.worth.count((time.perf_counter() - started) / len(thetas), len(thetas), here=True)
        return values

    def _evaluate_here(
        self, task: Evaluated, keys: Sequence[Key], thetas: Array, todo: Sequence[int]
    ) -> None:
        """Evaluate rows one by one, so that each is in the journal before the next begins."""
        by_rows = ByRows(task.function)
        for k in todo:
            started = time.perf_counter()
            value = as_array(by_rows(thetas[k][None])[0])
            seconds = time.perf_counter() - started
            if isinstance(value, Raised) and value.name == MemoryError.__name__:
                raise MemoryError(value.message)  # of this process, not of a worker
            self.worth.count(seconds, 1, here=True, raised=isinstance(value, Raised))
            self._keep(keys[k], value, seconds)
            self.check()


def _is_the_models(value: Array | Raised) -> bool:
    """Return whether a value is a property of the model, not a transient failure of the machine."""
    return not (isinstance(value, Raised) and value.of_machine)
