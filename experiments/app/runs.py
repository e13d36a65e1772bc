"""Execute the unfinished runs of a plan, in this process or in workers.

Single runs, sweeps, comparisons and the identification of a car's parts all run here.
"""

import sys
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, chdir, nullcontext
from dataclasses import dataclass, field, replace
from itertools import chain
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tqdm import tqdm

from experiments.app.cluster_runs import ClusterRuns, cluster_runs
from experiments.app.execution import execution_of
from experiments.app.mirror import check_tracking, mirror_runs
from experiments.app.plan import MODULES, POLL, Request, experiment_of
from experiments.app.schema import SweepConfig
from experiments.app.signals import Stopped, stopping
from experiments.app.working import (
    State,
    ended_state,
    execute,
    executed_state,
    prepare,
    with_result,
)
from miho.parallel.cluster import ClusterLost
from miho.parallel.workers import JobOutcome, Workers
from miho.study import Status, Store
from miho.study.files import RESULT
from miho.study.manifest import IDENTIFY, first_names, refuse_changes, write_manifest

HERE = 0
"""Number of worker processes if the runs are executed in this process."""
REPEAT_AFTER, KILL_AFTER = 1.5, 3.5
"""Seconds after the first signal until it is repeated and until running processes are killed. It is
repeated because Python loses a signal that arrives in a callback of a library. Within five seconds
all processes have ended."""


@dataclass
class PlanOutcome:
    """States of all requests of a plan; `stopped` is the interrupt that ended it early."""

    states: list[State] = field(default_factory=list)
    stopped: KeyboardInterrupt | None = None

    def raise_if_stopped(self) -> None:
        """Raise the interrupt, if any; called after the states are printed."""
        if self.stopped is not None:
            raise self.stopped


def run(
    plan: Sequence[Request],
    settings: SweepConfig,
    *,
    here: bool = False,
    folder: Path | None = None,
    fresh: bool = False,
    command: str = IDENTIFY,
    overrides: Sequence[str] = (),
    tracking: Mapping[str, Any] = MappingProxyType({}),
) -> PlanOutcome:
    """Execute the unfinished runs in `settings.workers`, or one after the other in this process.

    A run that is requested twice is executed once, and a run that another process executes is
    waited for. A run that raises, exits, is killed or takes too long does not affect other runs.
    After the first signal the active runs save their progress and stop, and the returned states
    describe all runs. With `here` the runs are executed in this process, in the working directory
    `folder` if it is given. Otherwise, if `settings.workers` is the address of a cluster, the runs
    are executed there; if the cluster is lost, the states say which runs are to do. `command`
    begins the command line of a sweep, for its record.

    Raises ResumeRefused if stored runs used other code, data or settings. At the end finished runs
    are sent to the tracker of `tracking`, unless a signal stopped the runs.
    """
    runs = PlanOutcome()
    unique = list({request.key: request for request in plan}.values())
    if settings.dry_run:
        runs.states += [replace(stored_state(request), reason=None) for request in unique]
        return runs
    check_tracking(tracking)
    if settings.timed and fresh:
        set_aside_disturbed(unique)
    at_once: int | str = HERE if here else settings.workers
    # The manifest of a sweep in each of its roots lets later commands notice lost runs.
    for root in dict.fromkeys(request.root for request in unique):
        identities = {r.words: r.identity for r in unique if r.root == root}
        words = None if here else overrides
        refuse_changes(Store(Path(root)), identities, fresh=fresh, overrides=words)
        if not here:
            write_manifest(Path(root), overrides, identities, command)
    try:
        try:
            _do(unique, settings, at_once, runs.states, folder)
        except KeyboardInterrupt:
            mirror_runs(unique, tracking, interrupted=True)
            raise
        except ClusterLost as error:
            runs.states += _unknown(unique, runs.states)
            print(f"{at_once}: {error}", file=sys.stderr)
        mirror_runs(unique, tracking)
    except KeyboardInterrupt as stopped:
        runs.states += _unknown(unique, runs.states)
        runs.stopped = stopped
    return runs


def set_aside_disturbed(plan: Sequence[Request]) -> None:
    """Set aside the finished runs whose seconds are not valid, so that they are repeated."""
    for request in plan:
        store = Store(Path(request.root))
        stored = store.find(request.identity)
        if stored is not None and not stored.result["facts"].get("timing_valid"):
            store.set_aside(stored.folder)


def _do(
    plan: Sequence[Request],
    settings: SweepConfig,
    at_once: int | str,
    states: list[State],
    folder: Path | None,
) -> None:
    """Execute a plan and append the state of each request as soon as it is known."""
    in_process = at_once == HERE
    # A bar on a terminal, otherwise a line per run; runs in this process show one bar each.
    quiet = in_process or None
    with tqdm(total=len(plan), desc="runs", smoothing=0.02, disable=quiet) as tqdm_bar:
        bar = Progress(len(plan), at_once, tqdm_bar)
        todo: list[Request] = []
        executed = (
            _run_here(todo, folder) if in_process else _run_in_workers(todo, settings, at_once)
        )
        for state in chain(_stored_states(plan, todo), executed):
            done = state.status is Status.DONE_BEFORE and bar.is_log
            states.append(replace(state, line="") if done else state)  # for the summary
            bar.show(state)
            if in_process and state.status is Status.INTERRUPTED:
                raise KeyboardInterrupt


def stored_state(request: Request) -> State:
    """State of a request according to the store: done, failed before or not yet executed."""
    store = Store(Path(request.root))
    result = store.result(request.identity)
    if result is not None:
        state = with_result(request, Status.DONE_BEFORE, result)
        return replace(state, line=f"done before: {request.words}")
    reason = store.reason(request.identity)
    if reason is None:
        return State(request, Status.TO_DO, f"to do: {request.words}")
    return State(request, Status.TO_DO, f"to do again: {request.words}", reason=reason)


def _unknown(plan: Sequence[Request], states: Sequence[State]) -> list[State]:
    """States of the requests that have none yet, from the store."""
    known = {state.request.key for state in states}
    unknown = [request for request in plan if request.key not in known]
    stored = [Store(Path(request.root)).has_result(request.identity) for request in unknown]
    return [
        State(request, Status.DONE_BEFORE if is_stored else Status.TO_DO)
        for request, is_stored in zip(unknown, stored, strict=True)
    ]


def _stored_states(plan: Sequence[Request], todo: list[Request]) -> Iterator[State]:
    """Yield the states of stored runs and of runs lost before their start; add the rest to `todo`.

    Prints which of the rest were stored before and have no result now.
    """
    deleted = []
    for request in plan:
        store = Store(Path(request.root))
        if request.lost is not None:
            yield ended_state(JobOutcome(request, reason=request.lost))
            continue
        if request.experiment is None:  # a run in this process checks the store itself
            result = store.result(request.identity)
            if result is not None:
                yield with_result(request, Status.DONE_BEFORE, result)
                continue
            if store.lost_result(request.identity):
                deleted.append(request.words)
        todo.append(request)
    if deleted:
        print(
            f"{len(deleted)} runs were stored before and have no {RESULT} now, because it was "
            "deleted or their process was killed while it stored them; they run again: "
            f"{first_names(deleted)}",
            file=sys.stderr,
        )


def _run_here(plan: Sequence[Request], folder: Path | None) -> Iterator[State]:
    """Execute the runs in this process, each with a progress bar, and yield their states."""
    for request in plan:
        experiment = request.experiment or experiment_of(request.setting)
        with nullcontext() if folder is None else chdir(folder):
            execution = execution_of(experiment)
        yield executed_state(request, execution)


def _workers(
    plan: Sequence[Request], settings: SweepConfig, at_once: int | str
) -> AbstractContextManager[Workers[Request, State] | ClusterRuns]:
    """Worker processes on this machine, or the workers of a cluster."""
    if isinstance(at_once, str):
        return cluster_runs(at_once, settings, own_code=any(request.own_code for request in plan))
    return Workers(
        execute, at_once, settings.time_limit, MODULES, prepare=prepare,
        alone=attrgetter("own_code"),
    )  # fmt: skip


def _run_in_workers(
    plan: Sequence[Request], settings: SweepConfig, at_once: int | str
) -> Iterator[State]:
    """Execute each run in a separate process, and yield the states in the order of completion."""
    if not plan:
        return
    todo, elsewhere = deque(plan), deque[Request]()
    with _workers(plan, settings, at_once) as workers, stopping(workers.interrupt) as stop:
        while todo or elsewhere or workers.busy:
            # After a signal no run is started. The signal is repeated, and finally runs that have
            # not stopped are killed.
            if stop.number is not None:
                todo.clear()
                elsewhere.clear()
            if stop.overdue(REPEAT_AFTER) and not stop.repeated:
                stop.repeated = True
                workers.interrupt()
            if stop.overdue(KILL_AFTER):
                unstopped = workers.jobs
                workers.kill()
                for job in unstopped:
                    reason = "did not stop in time"
                    yield ended_state(JobOutcome(job, reason=reason, interrupted=True))
                break
            # Idle workers get new runs; a run that another process executes is checked again.
            while todo and workers.idle:
                workers.start(todo.popleft())
            if elsewhere and workers.idle:
                time.sleep(POLL)
                todo.append(elsewhere.popleft())
            for ended in workers.wait(POLL) if workers.busy else ():
                state = ended_state(ended)
                if state.status is Status.RUNNING_ELSEWHERE:
                    elsewhere.append(ended.job)
                    continue
                if state.status in (Status.FAILED, Status.LOST) and settings.stop_on_failure:
                    todo.clear()
                    elsewhere.clear()
                yield state
        if stop.number is not None:
            raise Stopped(stop.number)


@dataclass
class Progress:
    """Numbers of finished runs and best errors of a sweep so far."""

    total: int
    at_once: int | str
    bar: Any
    counts: Counter[Status] = field(default_factory=Counter)
    best: dict[str, float] = field(default_factory=dict)

    @property
    def is_log(self) -> bool:
        """Whether each run has a line, because there is no terminal."""
        return self.at_once != HERE and bool(self.bar.disable)

    def show(self, state: State) -> None:
        """Count one run and show the progress of the sweep."""
        if self.at_once == HERE:
            return
        self.counts[state.status] += 1
        problem = state.request.identity.problem
        if state.error is not None:
            self.best[problem] = min(state.error, self.best.get(problem, float("inf")))
        bad = self.counts[Status.FAILED] + self.counts[Status.LOST]
        if self.is_log:
            print(f"[{self.counts.total()}/{self.total}] {state.line}", flush=True)
            return
        self.bar.update()
        best = "" if len(self.best) != 1 else f", best {next(iter(self.best.values())):.5g}"
        running = ""  # a cluster shows it on its dashboard
        if isinstance(self.at_once, int):
            running = f"{min(self.at_once, self.total - self.counts.total())} running, "
        self.bar.set_postfix_str(f"{running}{bad} failed{best}")
        if state.reason is not None:
            self.bar.write(state.line, file=sys.stderr)
