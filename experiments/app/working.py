"""Execution of a requested run in a worker, and the resulting state."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from experiments.app.build import build_optimizer
from experiments.app.execution import execution_of, name_of, result_error, result_line
from experiments.app.origin import our_code, packages_of
from experiments.app.plan import Request, dataset_of, experiment_of, setting_of
from miho.identification import CurveFit
from miho.parallel.errors import SPURIOUS_INTERRUPT
from miho.parallel.workers import JobOutcome
from miho.study import Execution, Status, Store, StoredRun, environment_stamp, single_thread
from miho.study.contention import reference_work
from miho.study.redaction import redacted


@dataclass(frozen=True)
class State:
    """State of a request: its status, a line to print, and the reason if there is no result.

    `run`: the stored run, if this process executed it. `unit` is the unit of `error`.
    """

    request: Request
    status: Status
    line: str = ""
    error: float | None = None
    unit: str = "-"
    reason: str | None = None
    run: StoredRun | None = None


def with_result(request: Request, status: Status, result: Mapping[str, Any]) -> State:
    """State of a request that has a result."""
    line = result_line(request.identity, result, status)
    return State(request, status, line, result_error(result), str(result["facts"]["unit"]))


def executed_state(request: Request, execution: Execution) -> State:
    """State after an execution."""
    if execution.run is not None:
        state = with_result(request, execution.status, execution.run.result)
        return replace(state, run=execution.run)
    last = (execution.error or "").strip().splitlines()[-1:]
    again = f"; the next call repeats it (best result so far in {execution.partial})"
    ending = ": ".join([str(execution.status), *last]) + again * bool(execution.partial)
    line = f"{name_of(request.identity)}: {ending}"
    return State(request, execution.status, line, reason=last[0] if last else None)


def ended_state(ended: JobOutcome[Request, State]) -> State:
    """State that a worker returned, or the state of a run whose worker ended without a result."""
    request, reason, interrupted = ended.job, ended.reason, ended.interrupted
    if ended.result is not None:
        if interrupted or ended.result.status is not Status.INTERRUPTED:
            return replace(ended.result, request=request)
        reason = SPURIOUS_INTERRUPT
    reason = redacted(reason or "no answer")
    status, identity = Status.INTERRUPTED if interrupted else Status.LOST, request.identity
    if ended.result is None:  # else it has kept its curve
        Store(Path(request.root)).keep_reason(identity, reason, ended.detail, str(status))
    ending = status if reason == status else f"{status}: {reason}"
    return State(request, status, f"{name_of(identity)}: {ending}", reason=reason)


def prepare(request: Request) -> None:
    """In a worker: load objects that runs of a user's file share, before each run is forked."""
    if not request.own_code:
        return
    with single_thread():
        reference_work().recent()
        environment_stamp()
        optimizer = build_optimizer(setting_of(request.setting))
        our_code(frozenset({CurveFit.__module__, type(optimizer).__module__}))
        dataset_of(request.setting)
        packages_of(optimizer)


def execute(request: Request) -> State:
    """In a worker: execute a run, unless it is stored."""
    root = Path(request.root).absolute()  # before the user's model can change the working folder
    experiment = replace(experiment_of(request.setting), identity=request.identity, root=root)
    return replace(executed_state(request, execution_of(experiment, quiet=True)), run=None)
