"""Whether stored runs are repeated to the last bit.

python -m experiments.check.replay RUN... [--workers 1] [--trust]

Each run is repeated from its folder, with its configuration, its seed, and, for a method whose
decisions depend on the order in which evaluations arrive, that order (`arrivals`), with any number
of workers. The comparison covers the outcome, best parameters and loss, the number of evaluations,
rejected values, and all stored improvements. Exits with 1 if anything differs. Runs that a budget
of seconds ended, and runs from another CPU or version, may differ.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from experiments.app.build import rebuild, stored_part
from experiments.app.console import BUG, OK, run_and_exit
from experiments.app.instantiation import instantiate
from miho.optim import Budget, Optimizer, RunRecord, minimize
from miho.optim.meter import Arrivals
from miho.study import StoredRun, single_thread
from miho.study.store import read_run


def repeated(stored: StoredRun, workers: int = 1, *, trusted: bool = False) -> RunRecord:
    """Repeat the run of a folder with its stored decisions."""
    problem = rebuild(stored, trusted=trusted)
    optimizer = instantiate(stored_part(stored, "optimizer"), "optimizer", Optimizer)
    budget = Budget(**stored_part(stored, "budget"))
    arrivals = stored.result.get("arrivals")
    replay = None if arrivals is None else Arrivals(**arrivals)
    with single_thread():
        return minimize(
            optimizer, problem, budget, stored.result["seed"], workers=workers, replay=replay
        )


def differences(stored: StoredRun, record: RunRecord) -> list[str]:
    """Differences in words."""
    now = {
        "outcome": str(record.outcome),
        "loss": record.loss,
        "theta": None if record.theta is None else record.theta.tolist(),
        "evaluations": record.evaluations,
        "rejected": dict(record.rejected),
    }
    differing = [
        f"{name} is {value!r}, was {stored.result[name]!r}"
        for name, value in now.items()
        if value != stored.result[name]
    ]
    improvements = set(zip(record.trace.evaluations, record.trace.loss, strict=True))
    improvements.add((record.evaluations, record.loss))  # the end of the stored curve
    curve = zip(stored.curve["evaluations"], stored.curve["loss"], strict=True)
    lacking = sum(row not in improvements for row in curve)
    return differing + [f"{lacking} stored improvements did not come again"] * (lacking > 0)


def check(folders: Sequence[Path], workers: int, *, trusted: bool) -> int:
    """Print one line per run; return the exit code."""
    code = OK
    for folder in folders:
        stored = read_run(folder)
        differing = differences(stored, repeated(stored, workers, trusted=trusted))
        print(f"{folder}: {'; '.join(differing) or 'the same to the last bit'}", flush=True)
        code = BUG if differing else code
    return code


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+", help="folders of stored runs")
    parser.add_argument("--workers", type=int, default=1, help="number of processes (1)")
    parser.add_argument(
        "--trust", action="store_true", help="allow to run the model files that a run names"
    )
    arguments = parser.parse_args()
    run_and_exit(lambda: check(arguments.runs, arguments.workers, trusted=arguments.trust))
