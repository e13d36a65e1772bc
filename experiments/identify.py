"""Identify the parameters of one model from one dataset; with -m, sweep.

python -m experiments.identify model=pacejka dataset=tire_lf optimizer=miho seed=0
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import pandas as pd
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from experiments.build import build
from experiments.cli import OK, SOME_FAILED, command
from experiments.run import line, report, run
from miho.study import Status

statuses: Counter[Status] = Counter()
found: list[tuple[str, str, float]] = []
roots: set[Path] = set()


def identify(cfg: DictConfig) -> None:
    """Run one composed configuration and print what was identified."""
    experiment = build(cfg)
    execution = run(experiment)
    statuses[execution.status] += 1
    roots.add(experiment.root)
    if execution.run is not None and execution.run.result["loss"] is not None:
        identity, loss = experiment.identity, execution.run.result["loss"]
        found.append((identity.problem, identity.optimizer, math.sqrt(loss)))
    print(line(experiment, execution), flush=True)
    if execution.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if execution.run is not None and HydraConfig.get().mode is RunMode.RUN:
        print("\n" + report(experiment, execution.run))


def summary() -> int:
    """Say what became of the runs, if there were several; the exit code of the command."""
    if statuses.total() > 1:
        counts = {status: statuses[status] for status in Status}
        told = ", ".join(
            f"{n} {status}" for status, n in counts.items() if n or status is Status.RAN
        )
        if found:
            table = pd.DataFrame(found, columns=["problem", "method", "error"])
            errors = table.groupby(["problem", "method"])["error"]
            print(errors.agg(["count", "min", "median", "max"]).to_string(float_format="%.5g"))
        for root in roots:
            print(f"how far to trust the best of them: python -m experiments.report {root}")
        print(f"{statuses.total()} runs: {told}")
    return SOME_FAILED if statuses[Status.FAILED] else OK


if __name__ == "__main__":
    command(identify, build, summary)
