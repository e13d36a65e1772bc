"""Run what is not done yet, once, and keep what was found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from miho.optim import Outcome, RunRecord, Space
from miho.optim.oracle import NOT_FINITE
from miho.study.environment import environment_stamp, single_thread
from miho.study.identity import Identity
from miho.study.redaction import without_secrets
from miho.study.store import RunInUse, Store, StoredRun
from miho.study.validity import stamped


class Status(StrEnum):
    """What became of a requested run; `lost` are those whose process ended, or never did."""

    RAN = "ran"
    DONE_BEFORE = "done before"
    RUNNING_ELSEWHERE = "running elsewhere"
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    LOST = "lost"
    TO_DO = "to do"


@dataclass(frozen=True)
class Execution:
    """A requested run: its status, the stored run if there is one, else where the rest lies."""

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

    A failed or interrupted run is kept as partial and will run again, and so is one of whose
    evaluations not one gave a value: that is a fault of the model or the installation. One that saw
    only values that are not finite is done, with the outcome that says so.
    """
    done = store.find(identity)
    if done is not None:
        return Execution(Status.DONE_BEFORE, done)
    try:
        with store.claim(identity):
            done = store.find(identity)
            if done is not None:
                return Execution(Status.DONE_BEFORE, done)
            with single_thread(), stamped() as stamp:
                environment = environment_stamp()
                record = without_secrets(job())
            if _only_raised(record):
                reasons = ", ".join(f"{n:,} x {reason}" for reason, n in record.rejected.items())
                told = f"not one evaluation gave a value: {reasons}"
                record = replace(record, outcome=Outcome.FAILED, error=told)
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
    """Whether whatever was evaluated raised; nothing was if nothing was rejected."""
    reasons = record.rejected
    without = record.outcome is Outcome.NO_FINITE_VALUE and len(reasons) > 0
    return without and not any(reason.startswith(NOT_FINITE) for reason in reasons)
