"""Run a job unless its result is stored, and store the result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from miho.optim import Outcome, RunRecord, Space
from miho.optim.usable_values import NOT_FINITE
from miho.study.contention import stamped
from miho.study.environment import environment_stamp, single_thread
from miho.study.identity import Identity
from miho.study.redaction import without_secrets
from miho.study.store import RunInUse, Store, StoredRun


class Status(StrEnum):
    """Outcome of a requested run; `lost` means that its process ended or was killed."""

    RAN = "ran"
    DONE_BEFORE = "done before"
    RUNNING_ELSEWHERE = "running elsewhere"
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    LOST = "lost"
    TO_DO = "to do"


@dataclass(frozen=True)
class Execution:
    """A requested run: its status, and a stored run, or the file of a partial result and error."""

    status: Status
    run: StoredRun | None = None
    partial: Path | None = None
    error: str | None = None


def execute(
    store: Store,
    identity: Identity,
    job: Callable[[], RunRecord],
    space: Space,
    facts: Mapping[str, Any],
) -> Execution:
    """Run `job` on one thread and store its result, unless the store has the result.

    A failed or interrupted run is stored as partial and will run again, and so is a run in which
    every evaluation raised, because that indicates a fault of the model or the installation. A run
    whose values were all not finite is finished, with that outcome. `facts` of the problem are
    stored with the result.
    """
    stored = store.find(identity)
    if stored is not None:
        return Execution(Status.DONE_BEFORE, stored)
    try:
        with store.claim(identity):
            stored = store.find(identity)  # another process may have committed it meanwhile
            if stored is not None:
                return Execution(Status.DONE_BEFORE, stored)
            with single_thread(), stamped() as stamp:
                environment = environment_stamp()
                record = without_secrets(job())
            if _only_raised(record):
                reasons = ", ".join(f"{n:,} x {reason}" for reason, n in record.rejected.items())
                message = f"no evaluation gave a value: {reasons}"
                record = replace(record, outcome=Outcome.FAILED, error=message)
            if record.outcome in (Outcome.FAILED, Outcome.INTERRUPTED):
                partial = store.keep_partial(identity, record)
                failed = record.outcome is Outcome.FAILED
                status = Status.FAILED if failed else Status.INTERRUPTED
                return Execution(status, partial=partial, error=record.error)
            timing = stamp.judge(record.seconds, record.cpu_seconds)
            environment["timing"] = timing.as_dict()
            facts = {**facts, "timing_valid": timing.valid}
            return Execution(Status.RAN, store.commit(identity, record, space, environment, facts))
    except RunInUse:
        return Execution(Status.RUNNING_ELSEWHERE)


def _only_raised(record: RunRecord) -> bool:
    """Return whether there was an evaluation and every evaluation raised."""
    reasons = record.rejected
    no_value = record.outcome is Outcome.NO_FINITE_VALUE and len(reasons) > 0
    return no_value and not any(reason.startswith(NOT_FINITE) for reason in reasons)
