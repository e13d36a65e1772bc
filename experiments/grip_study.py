"""Compare laps in which the grip falls by 30 %, with different knowledge of the grip.

python -m experiments.grip_study experiment=grip_falls                          # 20 seeds
python -m experiments.grip_study experiment=grip_falls comparison.repetitions=1 # a look

A seed draws the time of the fall, in the middle of the lap, and the noise of the measurements.
"""

import json
import sys
from pathlib import Path
from typing import Any

if not __package__:  # as python experiments/grip_study.py, like python -m experiments.grip_study
    sys.path[0] = str(Path(__file__).parents[1])

import numpy as np
import pandas as pd
from omegaconf import DictConfig
from tqdm import tqdm

from experiments.app.build import ConfigError
from experiments.app.console import command
from experiments.app.explain import BAD_SETTINGS, as_config_error
from experiments.app.origin import regenerates
from experiments.driving import falling_grip
from experiments.driving.falling_grip import (
    CAUTIOUS,
    ORACLE,
    TRACKER,
    Constant,
    FallingGrip,
    Oracle,
)
from miho.analysis.text import csv_text
from miho.study import write_text

SETTINGS = {
    "experiment": "grip_falls",
    "comparison.repetitions": "number of seeds",
    "drive.performance_factor": "share of the grip that the plan uses",
    "seed": "the first seed",
    "root": "folder of laps, table and figure",
}


def study(cfg: DictConfig) -> None:
    """Drive the laps of all seeds, then write laps, table, figure and provenance."""
    if cfg.comparison.repetitions < 1:
        raise ConfigError(
            f"comparison.repetitions: is {cfg.comparison.repetitions}; expected at least 1"
        )
    with as_config_error("drive", BAD_SETTINGS):
        laps = FallingGrip.of(cfg)
    root = Path(cfg.root)
    root.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for seed in tqdm(range(cfg.seed, cfg.seed + cfg.comparison.repetitions), disable=None):
        tracked = laps.tracked(laps.earlier(seed))
        schedule = laps.schedule(seed)
        sources = {
            falling_grip.BLIND: Constant(), TRACKER: tracked, ORACLE: Oracle(schedule),
            CAUTIOUS: Constant(1 - laps.fall),
        }  # fmt: skip
        drives = {
            name: laps.lap(seed, source, falling_grip.RESERVE if name == TRACKER else 0.0)
            for name, source in sources.items()
        }
        rows += [falling_grip.row(seed, name, drive) for name, drive in drives.items()]
        rows[-3] |= falling_grip.detection(tracked, schedule)
        if seed == cfg.seed:
            del drives[CAUTIOUS]
            falling_grip.draw(root, laps, drives, tracked, schedule)
        write_text(root / "laps.csv", csv_text(pd.DataFrame(rows), float_format="%.6g"))
    text = falling_grip.table(pd.DataFrame(rows), np.random.default_rng(cfg.seed))
    write_text(root / "table.txt", text + "\n")
    about = regenerates("experiments.grip_study", [])
    write_text(root / "grip_study.json", json.dumps(about, indent=1) + "\n")
    print(text)


if __name__ == "__main__":
    command(study, config_name="drive", settings=SETTINGS)
