"""Do the runs of a plan that are not done, in this process or in workers; the state of all.

Single runs, sweeps, comparisons and the parts of a car are all done here.
"""

from __future__ import annotations

import sys
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tqdm import tqdm

from experiments.app.cluster_runs import ClusterRuns, cluster_runs
from experiments.app.execution import execution_of, result_error, result_line, result_unit
from experiments.app.mirror import check_tracking, mirror_runs, say_unmirrored
from experiments.app.plan import MODULES, POLL, Request, experiment_of
from experiments.app.schema import SweepConfig
from experiments.app.signals import Stopped, stopping
from experiments.app.working import State, ended_state, execute, executed_state, own_code, prepare
from miho.parallel.cluster import ClusterLost, is_address
from miho.parallel.workers import JobOutcome, Workers
from miho.study import Status, Store
from miho.study.changes import refuse_changes
from miho.study.files import RESULT
from miho.study.manifest import first_names, write_manifest

HERE = 0
"""Processes for runs that are done in this one."""
REPEAT_AFTER, KILL_AFTER = 1.5, 3.5
"""Seconds after the first signal until it is repeated, because Python loses one that strikes in a
callback of a library, and until what still runs is killed, so that all is over in five."""


@dataclass
class PlanOutcome:
    """The states of all requests of a plan; `stopped` is the interrupt that ended it early."""

    states: list[State] = field(default_factory=list)
    stopped: KeyboardInterrupt | None = None

    def raise_if_stopped(self) -> None:
        """Raise the interrupt, to be called after the states are printed."""
        if self.stopped is not None:
            raise self.stopped


def run(
    plan: Sequence[Request],
    settings: SweepConfig,
    *,
    processes: int | None = None,
    fresh: bool = False,
    overrides: Sequence[str] = (),
    tracking: Mapping[str, Any] = MappingProxyType({}),
) -> PlanOutcome:
    """Do what is not done, `processes` runs at a time (default: by `settings.workers`).

    A run that is asked for twice is done once; one that another process is doing is waited for. A
    run that raises, exits, is killed or takes too long is lost alone. After the first signal the
    runs in progress keep what they found and stop, and the states tell how all stand. With `HERE`
    they are done in this process, one after the other, and a failure of one ends none. Else, if
    `settings.workers` is the address of a cluster, they are done there; if it is lost, the states
    tell which runs are to be done again.

    Raises ResumeRefused if finished runs were made of something else. What is finished goes to the
    tracker of `tracking` at the end, unless a signal ended it.
    """
    runs = PlanOutcome()
    unique = list({request.identity.id: request for request in plan}.values())
    if settings.dry_run:
        runs.states += [replace(stored_state(request), reason=None) for request in unique]
        return runs
    check_tracking(tracking)
    at_once: int | str = settings.workers if processes is None else processes
    if processes != HERE and is_address(settings.workers):
        at_once = settings.workers
    _refuse_and_list(unique, overrides, fresh=fresh, in_process=at_once == HERE)
    try:
        try:
            _do(unique, settings, at_once, runs.states)
        except KeyboardInterrupt:
            say_unmirrored(unique, tracking)
            raise
        except ClusterLost as error:
            runs.states += _unknown(unique, runs.states)
            print(f"{at_once}: {error}", file=sys.stderr)
        mirror_runs(unique, tracking)
    except KeyboardInterrupt as stopped:
        runs.states += _unknown(unique, runs.states)
        runs.stopped = stopped
    return runs


def _refuse_and_list(
    plan: Sequence[Request], overrides: Sequence[str], *, fresh: bool, in_process: bool
) -> None:
    """Refuse, before anything begins, what is stored of other code, data or settings.

    A sweep is also written down in each of its roots, so that runs that go missing are missed.
    """
    for root in dict.fromkeys(request.root for request in plan):
        identities = {r.words: r.identity for r in plan if r.root == root}
        words = None if in_process else overrides
        refuse_changes(Store(Path(root)), identities, fresh=fresh, overrides=words)
        if not in_process:
            write_manifest(Path(root), overrides, identities)


def _do(
    plan: Sequence[Request], settings: SweepConfig, at_once: int | str, states: list[State]
) -> None:
    """Go through a plan and append the state of each request as soon as it is known."""
    in_process = at_once == HERE
    with _bar(len(plan), at_once) as bar:
        todo: list[Request] = []
        executed = _run_here(todo) if in_process else _run_in_workers(todo, settings, at_once)
        for state in chain(_stored_states(plan, todo), executed):
            states.append(state)
            bar.show(state)
            if in_process and state.status is Status.INTERRUPTED:
                raise KeyboardInterrupt


def stored_state(request: Request) -> State:
    """The state of a request by the store alone: it is done, it was tried in vain, or neither."""
    store = Store(Path(request.root))
    result = store.result(request.identity)
    if result is not None:
        line, error = f"done before: {request.words}", result_error(result)
        return State(request, Status.DONE_BEFORE, line, error, result_unit(result))
    reason = store.reason(request.identity)
    if reason is None:
        return State(request, Status.TO_DO, f"to do: {request.words}")
    return State(request, Status.TO_DO, f"to do again: {request.words}", reason=reason)


def _unknown(plan: Sequence[Request], states: Sequence[State]) -> list[State]:
    """The states of the runs that were not begun when all ended, from a look at their folders."""
    known = {state.request.identity.id for state in states}
    unknown = [request for request in plan if request.identity.id not in known]
    stored = [Store(Path(request.root)).has_result(request.identity) for request in unknown]
    return [
        State(request, Status.DONE_BEFORE if is_stored else Status.TO_DO, "")
        for request, is_stored in zip(unknown, stored, strict=True)
    ]


def _stored_states(plan: Sequence[Request], todo: list[Request]) -> Iterator[State]:
    """The runs that need not be done: stored, or lost before they began; `todo` gets the others.

    Prints which of the others were stored before and have no result now.
    """
    deleted = []
    for request in plan:
        store = Store(Path(request.root))
        if request.lost is not None:
            yield ended_state(JobOutcome(request, reason=request.lost))
            continue
        if request.experiment is None:  # what is done in this process looks for itself
            result = store.result(request.identity)
            if result is not None:
                line = result_line(request.identity, result, Status.DONE_BEFORE)
                error, unit = result_error(result), result_unit(result)
                yield State(request, Status.DONE_BEFORE, line, error, unit)
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


def _run_here(plan: Sequence[Request]) -> Iterator[State]:
    """The runs as they end, each in this process with a bar of its own."""
    for request in plan:
        execution = execution_of(request.experiment or experiment_of(request.setting))
        yield replace(executed_state(request, execution), run=execution.run)


def _workers(
    plan: Sequence[Request], settings: SweepConfig, at_once: int | str
) -> AbstractContextManager[Workers[Request, State] | ClusterRuns]:
    """Processes of this machine, or the workers of the cluster at an address."""
    if isinstance(at_once, str):
        return cluster_runs(at_once, settings, own_code=any(map(own_code, plan)))
    return Workers(execute, at_once, settings.time_limit, MODULES, prepare=prepare, alone=own_code)


def _run_in_workers(
    plan: Sequence[Request], settings: SweepConfig, at_once: int | str
) -> Iterator[State]:
    """The runs as they end, each in a process of its own."""
    if not plan:
        return
    todo, elsewhere = deque(plan), deque[Request]()
    with _workers(plan, settings, at_once) as workers, stopping(workers.interrupt) as stop:
        while todo or elsewhere or workers.busy:
            # Once a signal has come, nothing more is started. It is repeated, and in the end what
            # has not stopped is killed.
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
            # Idle workers get what is to do; what another process is doing is asked for again.
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


@contextmanager
def _bar(total: int, at_once: int | str) -> Iterator[Progress]:
    """A bar on a terminal, else a line for each run; runs in this process have their own bars."""
    if at_once == HERE:
        yield Progress(total, at_once, None)
        return
    with tqdm(total=total, desc="runs", smoothing=0.02, disable=None) as bar:
        yield Progress(total, at_once, bar)


@dataclass
class Progress:
    """What a sweep has done so far."""

    total: int
    at_once: int | str
    bar: Any
    counts: Counter[Status] = field(default_factory=Counter)
    best: dict[str, float] = field(default_factory=dict)

    def show(self, state: State) -> None:
        """Count one run and show where the sweep stands."""
        if self.bar is None:
            return
        self.counts[state.status] += 1
        problem = state.request.identity.problem
        if state.error is not None:
            self.best[problem] = min(state.error, self.best.get(problem, float("inf")))
        bad = self.counts[Status.FAILED] + self.counts[Status.LOST]
        if self.bar.disable:
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
