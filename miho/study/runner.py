"""Run what has no stored result yet, once, and store the result."""

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
    """How a requested run ended; `lost` are those whose process ended, or had to be killed."""

    RAN = "ran"
    DONE_BEFORE = "done before"
    RUNNING_ELSEWHERE = "running elsewhere"
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    LOST = "lost"
    TO_DO = "to do"


@dataclass(frozen=True)
class Execution:
    """A requested run: its status, and the stored run, or else the file of its partial result."""

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
    """Run `job` on one thread unless the store has its result, and commit what it returns.

    A failed or interrupted run is stored as partial and will run again. So is one whose every
    evaluation raised: that is a fault of the model or the installation. One whose values were all
    not finite is done, with the outcome that says so.
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
                message = f"not one evaluation gave a value: {reasons}"
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
    """Whether every evaluation raised, and there was one at least."""
    reasons = record.rejected
    no_value = record.outcome is Outcome.NO_FINITE_VALUE and len(reasons) > 0
    return no_value and not any(reason.startswith(NOT_FINITE) for reason in reasons)
