"""Compare the same lap on true, identified and poor parameters, over several seeds.

python -m experiments.drive_study experiment=identification_buys                          # 20 seeds
python -m experiments.drive_study experiment=identification_buys comparison.repetitions=2 # a look

A seed draws the noise of the measurements, of the dyno and of the lap. Seeds that are stored for
the same code and settings are not repeated.
"""

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
    "comparison.repetitions": "number of seeds",
    "sweep.workers": "number of simultaneous laps, on this machine",
    "seed": "the first seed",
    "root": "folder of laps, table and figure",
}


def study(cfg: DictConfig) -> None:
    """Drive the laps that are not stored, then write the table, the figure and the provenance."""
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
