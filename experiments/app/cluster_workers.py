"""Run jobs on the workers of a Dask cluster, as `Workers` does on this machine."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from typing import TYPE_CHECKING, Any, Generic

from miho.parallel.cluster import PATIENCE, ClusterLost
from miho.parallel.cluster_process import Placed, dismiss, interrupt, run_at_worker
from miho.parallel.worker_process import Job, Result
from miho.parallel.workers import JobOutcome, Workers

if TYPE_CHECKING:
    from distributed import Client, Future

COUNTED = 1.0
"""Lifetime of the cached number of threads of a cluster [s]."""
BROKEN = "the connection to the Dask scheduler broke; call again to do the jobs that are left"
LEAVING = 1.0
"""Time limit [s] for giving up jobs, in case a machine does not answer."""


class ClusterWorkers(AbstractContextManager["ClusterWorkers[Job, Result]"], Generic[Job, Result]):
    """Workers on a Dask cluster, one job per thread; a context manager like `Workers`.

    Each job runs in a process of its worker that no other job shares at the same time, with the
    time limit and the isolation of `Workers`. A job whose worker dies or leaves is sent to another
    worker. A job that has lost several workers is given up (Dask's setting `allowed-failures`). If
    the connection to the scheduler breaks, all jobs in progress end with that reason, and no more
    can be started. If this process is killed, its jobs are interrupted.
    """

    def __init__(
        self,
        client: Client,
        work: Callable[[Placed[Job]], Result],
        time_limit: float | None = None,
        modules: Sequence[str] = (),
        *,
        prepare: Callable[[Placed[Job]], object] | None = None,
        alone: Callable[[Placed[Job]], bool] | None = None,
    ) -> None:
        self._client, self._owner = client, uuid.uuid4().hex
        self._process: Callable[[], Workers[Placed[Job], Result]] = partial(
            Workers, work, 1, time_limit, tuple(modules), prepare=prepare, alone=alone
        )
        self._jobs: dict[Future[Any], Job] = {}
        self._ended: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()
        self._interrupts = self._sent = 0
        self._count, self._counted = 1, float("-inf")
        self._broken = False

    def __exit__(self, *_: object) -> None:
        self.kill()

    @property
    def idle(self) -> int:
        """Number of jobs that can be started now; at least one may wait for the first worker.

        After a break of the connection it is 0 until all jobs in progress have ended with that
        reason; then it is 1, and `start` raises.
        """
        if self._is_broken:
            return 0 if self._jobs else 1
        now = time.monotonic()
        if now > self._counted + COUNTED:
            with contextlib.suppress(Exception):  # a broken connection shows in the jobs
                self._count = max(1, sum(self._client.nthreads().values()))
            self._counted = now
        return max(0, self._count - self.busy)

    @property
    def busy(self) -> int:
        """Number of jobs in progress."""
        return len(self._jobs)

    @property
    def jobs(self) -> list[Job]:
        """The jobs in progress."""
        return list(self._jobs.values())

    def start(self, job: Job) -> None:
        """Send a job to the cluster; raises ClusterLost if the connection is broken."""
        if self._is_broken:
            raise ClusterLost(BROKEN)
        future = self._client.submit(
            run_at_worker,
            self._owner,
            self._process,
            job,
            key=f"miho-{uuid.uuid4().hex}",
            pure=False,
        )
        self._jobs[future] = job
        future.add_done_callback(self._ended.put)

    def wait(self, seconds: float) -> list[JobOutcome[Job, Result]]:
        """Outcomes of the jobs that end within `seconds`; returns as soon as there is one."""
        self._send_interrupts()
        outcomes = []
        with contextlib.suppress(queue.Empty):
            outcomes.append(self._outcome_of(self._ended.get(timeout=seconds)))
            while True:
                outcomes.append(self._outcome_of(self._ended.get_nowait()))
        return [outcome for outcome in outcomes if outcome is not None]

    def interrupt(self) -> None:
        """Interrupt all jobs at the next `wait`, which then returns their results or errors.

        This is safe in a signal handler: it only increments a counter.
        """
        self._interrupts += 1

    def kill(self) -> None:
        """Give up all jobs; their workers end them soon after."""
        futures = list(self._jobs)
        self._jobs.clear()
        if self._broken:
            return
        calls = [partial(self._client.run, dismiss, self._owner, on_error="ignore")]
        if futures:
            calls.insert(0, partial(self._client.cancel, futures, force=True))
        _in_background(*calls).join(LEAVING)

    def _send_interrupts(self) -> None:
        if self._sent < self._interrupts and not self._broken:
            self._sent = self._interrupts
            _in_background(
                partial(self._client.run, interrupt, self._owner, self._sent, on_error="ignore")
            )

    @property
    def _is_broken(self) -> bool:
        return self._broken or self._client.status != "running"

    def _outcome_of(self, future: Future[Any]) -> JobOutcome[Job, Result] | None:
        """Outcome of a job, or None if it was given up or its lost answer is being made again."""
        if future not in self._jobs:
            return None
        interrupted = self._interrupts > 0
        try:
            result, reason, detail = future.result(timeout=PATIENCE)
        except TimeoutError:
            self._ended.put(future)
            return None
        except Exception as error:  # noqa: BLE001 -- from Dask: a lost worker or scheduler
            self._broken |= future.cancelled()
            result, detail = None, None
            reason = BROKEN if future.cancelled() else _reason(error)
        return JobOutcome(
            self._jobs.pop(future), result, reason, detail, interrupted and reason != BROKEN
        )


def _reason(error: BaseException) -> str:
    """Dask's reason for giving a job up, in one line."""
    attempts = getattr(error, "allowed_failures", None)
    if isinstance(attempts, int):
        return f"each of the {attempts + 1} Dask workers that began it died, perhaps because of it"
    return f"its Dask worker: {type(error).__name__}: {' '.join(str(error).split())}"


def _in_background(*calls: Callable[[], object]) -> threading.Thread:
    """Run calls to the cluster in a thread, because a call may wait for a dead machine."""

    def quietly() -> None:
        for call in calls:
            with contextlib.suppress(Exception):
                call()

    thread = threading.Thread(target=quietly, daemon=True)
    thread.start()
    return thread
