"""What identification buys: the same lap on true, identified and poor parameters, over seeds.

python -m experiments.drive_study experiment=identification_buys                          # 20 seeds
python -m experiments.drive_study experiment=identification_buys comparison.repetitions=2 # a look

A seed draws the noise of all measurements, of the dyno and of the lap. Seeds that were done before
by the same code and settings are not done again.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

if not __package__:  # as python experiments/drive_study.py, like python -m experiments.drive_study
    sys.path[0] = str(Path(__file__).parents[1])

from omegaconf import DictConfig

from experiments.app.console import SOME_FAILED, EndedError, command
from experiments.app.plan import sweep_settings
from experiments.driving.study import check_study, each_seed, jobs_of, write_study

SETTINGS = {
    "experiment": "identification_buys",
    "comparison.repetitions": "how many seeds",
    "sweep.workers": "laps at a time, on this machine",
    "seed": "the first of the seeds",
    "root": "where laps, table and figure go",
}


def study(cfg: DictConfig) -> None:
    """Do what is not done yet, then the table as text and CSV, the figure, and what made them."""
    check_study(cfg)
    root = Path(cfg.root)
    root.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    failures: list[str] = []
    for laps in each_seed(jobs_of(cfg, root), sweep_settings(cfg.sweep).workers):
        if isinstance(laps, str):
            failures.append(laps)
        else:
            rows += laps
    for line in failures:
        print(line, file=sys.stderr)
    if rows:
        write_study(cfg, root, rows)
    if failures:
        raise EndedError(SOME_FAILED)


if __name__ == "__main__":
    command(study, config_name="drive", settings=SETTINGS)
