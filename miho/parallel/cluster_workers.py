"""Jobs on the workers of a cluster of Dask, each in a process of its own there."""

from __future__ import annotations

import contextlib
import multiprocessing
import queue
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic

from miho.parallel.cluster import PATIENCE, ClusterLost
from miho.parallel.worker_process import INTERRUPTED, Job, Result
from miho.parallel.workers import JobOutcome, Workers

if TYPE_CHECKING:
    from distributed import Client, Future

POLL = 0.1
"""Seconds between two looks of a worker whether its job is still wanted."""
COUNTED = 1.0
"""Seconds for which the number of threads of a cluster is believed."""
GRACE = 1.0
"""Seconds that a job has to keep what it has, once nobody waits for it."""


@dataclass(frozen=True)
class _Task(Generic[Job, Result]):
    """What a worker of the cluster is told of all jobs: the arguments of `ClusterWorkers`."""

    owner: str
    work: Callable[[Job, str], Result]
    time_limit: float | None
    modules: Sequence[str]
    prepare: Callable[[Job], object] | None
    alone: Callable[[Job], bool] | None


class ClusterWorkers(Generic[Job, Result]):
    """As `Workers`, but on a cluster: a job for each thread of its workers; a context manager.

    `work` gets a job and an empty folder at the worker, which is removed afterwards. Each job has a
    process of its own there, which the time limit ends. A job whose worker dies or leaves goes to
    another one; one that has lost several workers is given up (`allowed-failures` of Dask). If the
    connection to the scheduler breaks, all jobs in progress end with that reason, and no more can
    be started. What nobody waits for any more, because this process was killed, is interrupted.
    """

    def __init__(
        self,
        client: Client,
        work: Callable[[Job, str], Result],
        time_limit: float | None = None,
        modules: Sequence[str] = (),
        *,
        prepare: Callable[[Job], object] | None = None,
        alone: Callable[[Job], bool] | None = None,
    ) -> None:
        self._client, self._owner = client, uuid.uuid4().hex
        self._task = _Task(self._owner, work, time_limit, tuple(modules), prepare, alone)
        self._jobs: dict[Future, Job] = {}
        self._ended: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._interrupts = self._sent = 0
        self._count, self._counted = 1, float("-inf")
        self._broken = False

    def __enter__(self) -> ClusterWorkers[Job, Result]:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.kill()

    @property
    def idle(self) -> int:
        """How many more jobs can be started now; at least one may wait for a first worker."""
        now = time.monotonic()
        if now > self._counted + COUNTED and not self._broken:
            with contextlib.suppress(Exception):  # a break of the connection shows in the jobs
                self._count = max(1, sum(self._client.nthreads().values()))
            self._counted = now
        return max(0, self._count - self.busy)

    @property
    def busy(self) -> int:
        """How many jobs are being done."""
        return len(self._jobs)

    @property
    def jobs(self) -> list[Job]:
        """The jobs that are being done."""
        return list(self._jobs.values())

    def start(self, job: Job) -> None:
        """Give a job to the cluster; raises ClusterLost if the connection is broken."""
        if self._broken or self._client.status != "running":
            raise ClusterLost(self._break)
        future = self._client.submit(
            _run_at_worker, self._task, job, key=f"miho-{uuid.uuid4().hex}", pure=False
        )
        self._jobs[future] = job
        future.add_done_callback(self._ended.put)

    def wait(self, seconds: float) -> list[JobOutcome[Job, Result]]:
        """The jobs that end within some seconds, as soon as there is one."""
        self._send_interrupts()
        outcomes = []
        with contextlib.suppress(queue.Empty):
            outcomes.append(self._outcome_of(self._ended.get(timeout=seconds)))
            while True:
                outcomes.append(self._outcome_of(self._ended.get_nowait()))
        return [outcome for outcome in outcomes if outcome is not None]

    def interrupt(self) -> None:
        """Interrupt all jobs, with the next `wait`: what they raise or return then comes with it.

        A signal handler may call this: it only counts.
        """
        self._interrupts += 1

    def kill(self) -> None:
        """Give up all jobs: their workers end them soon."""
        futures = list(self._jobs)
        self._jobs.clear()
        if futures and not self._broken:
            _in_background(partial(self._client.cancel, futures, force=True)).join(GRACE)

    def _send_interrupts(self) -> None:
        if self._sent < self._interrupts and not self._broken:
            self._sent = self._interrupts
            _in_background(
                partial(self._client.run, _interrupt, self._owner, self._sent, on_error="ignore")
            )

    @property
    def _break(self) -> str:
        return "the connection to the Dask scheduler broke; the next call does what is not done"

    def _outcome_of(self, future: Future) -> JobOutcome[Job, Result] | None:
        """How a job ended; None if it was given up, or its answer was lost and is made again."""
        if future not in self._jobs:
            return None
        interrupted = self._interrupts > 0
        try:
            result, reason, detail = future.result(timeout=PATIENCE)
        except TimeoutError:
            self._ended.put(future)
            return None
        except Exception as error:  # noqa: BLE001 -- of Dask: a lost worker or scheduler
            self._broken |= future.cancelled()
            result, detail = None, None
            reason = self._break if future.cancelled() else _reason(error)
        return JobOutcome(
            self._jobs.pop(future), result, reason, detail, interrupted and reason != self._break
        )


def _reason(error: BaseException) -> str:
    """Why Dask gave a job up, in one line."""
    attempts = getattr(error, "allowed_failures", None)
    if isinstance(attempts, int):
        return f"each of the {attempts + 1} Dask workers that began it died, perhaps of it"
    return f"its Dask worker: {type(error).__name__}: {' '.join(str(error).split())}"


def _in_background(call: Callable[[], object]) -> threading.Thread:
    """Do a call to the cluster in a thread of its own, since it can wait for a dead machine."""

    def quietly() -> None:
        with contextlib.suppress(Exception):
            call()

    thread = threading.Thread(target=quietly, daemon=True)
    thread.start()
    return thread


_INTERRUPTS: dict[str, int] = {}
"""In a worker of the cluster: how often each owner of jobs has interrupted them."""


def _interrupt(owner: str, times: int) -> None:
    """In a worker of the cluster: interrupt the jobs of an owner, also those that come later."""
    _INTERRUPTS[owner] = max(times, _INTERRUPTS.get(owner, 0))


def _run_at_worker(task: _Task[Any, Any], job: Any) -> tuple[Any, str | None, str | None]:
    """In a thread of a worker of the cluster: do a job in a process of its own.

    Gives its result, or the reason why there is none and the traceback.
    """
    import distributed

    multiprocessing.current_process().daemon = False  # else it may have no children
    worker = distributed.get_worker()
    key = worker.get_current_task()
    with (
        tempfile.TemporaryDirectory(prefix="miho-", dir=worker.local_directory) as folder,
        Workers(
            partial(task.work, folder=folder), 1, task.time_limit, task.modules,
            prepare=task.prepare, alone=task.alone,
        ) as workers,
    ):  # fmt: skip
        workers.start(job)
        sent, until = 0, float("inf")
        while time.monotonic() < until:
            for ended in workers.wait(POLL):
                return ended.result, ended.reason, ended.detail
            times = _INTERRUPTS.get(task.owner, 0)
            state = worker.state.tasks.get(key)
            if until == float("inf") and (state is None or state.state == "cancelled"):
                times, until = sent + 1, time.monotonic() + GRACE
            if times > sent:
                sent = times
                workers.interrupt()
    return None, INTERRUPTED, None
