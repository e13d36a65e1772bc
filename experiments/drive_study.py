"""What identification buys: the same lap on true, identified and poor parameters, over seeds.

python -m experiments.drive_study experiment=identification_buys                          # 20 seeds
python -m experiments.drive_study experiment=identification_buys comparison.repetitions=2 # a look

A seed draws the noise of all measurements, of the dyno and of the lap. Seeds that were done before
by the same code and settings are not done again.
"""

from __future__ import annotations

import json
import sys
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from experiments.app.build import ConfigError
from experiments.app.console import OK, SOME_FAILED, command
from experiments.app.origin import driving_code, regenerates
from experiments.driving.laps import VARIANTS, Job, laps_before, laps_of, methods_of
from experiments.driving.settings import factors, prepared
from miho.analysis import save
from miho.analysis.figures.driving import lap_figure, lap_table, lap_text
from miho.study import write_text
from miho.study.workers import Workers

SETTINGS = {
    "experiment": "identification_buys",
    "comparison.repetitions": "how many seeds",
    "sweep.processes": "laps at a time",
    "seed": "the first of the seeds",
    "root": "where laps, table and figure go",
}
NEEDED = ("miho", "least_squares")
POLL = 0.5
TIME_LIMIT = 1800.0


def study(cfg: DictConfig) -> int:
    """Do what is not done yet, then the table as text and CSV, the figure, and what made them."""
    check(cfg)
    root = Path(cfg.root)
    root.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    failed: list[str] = []
    for seed in _each_seed(_jobs(cfg, root), cfg.sweep.processes):
        if isinstance(seed, str):
            failed.append(seed)
        else:
            rows += seed
    for line in failed:
        print(line, file=sys.stderr)
    if rows:
        _write(cfg, root, rows)
    return SOME_FAILED if failed else OK


def _write(cfg: DictConfig, root: Path, rows: list[dict[str, Any]]) -> None:
    """The laps, their table as text and CSV, the figure, and what made them."""
    laps = pd.DataFrame(rows)
    laps["variant"] = pd.Categorical(laps["variant"], [variant.name for variant in VARIANTS])
    laps = laps.sort_values(["variant", "seed"]).reset_index(drop=True)
    table = lap_table(laps, np.random.default_rng(cfg.seed))
    write_text(root / "laps.csv", laps.to_csv(index=False, float_format="%.6g"))
    write_text(root / "table.csv", table.to_csv(index=False, float_format="%.6g"))
    write_text(root / "table.txt", lap_text(table) + "\n")
    note = f"one lap of {cfg.drive.track.name.upper()}, {factors(cfg)}, at most "
    note += f"{3.6 * cfg.drive.top_speed:.0f} km/h; {laps['seed'].nunique()} seeds"
    paths = save(lap_figure(laps, table, note=note), root / "figures" / "identification_buys")
    about = regenerates("experiments.drive_study", methods_of(cfg).values())
    about |= {"seeds": sorted(set(laps["seed"].tolist()))}
    write_text(root / "drive_study.json", json.dumps(about, indent=1) + "\n")
    print(lap_text(table))
    names = ("laps.csv", "table.csv", "table.txt", "drive_study.json")
    print("\n".join(map(str, [*paths, *(root / name for name in names)])))


def check(cfg: DictConfig) -> None:
    """Everything that can be wrong before the first seed."""
    prepared(cfg)
    for key, value in (
        ("comparison.repetitions", cfg.comparison.repetitions),
        ("sweep.processes", cfg.sweep.processes),
    ):
        if value < 1:
            raise ConfigError(f"{key}: is {value}; expected at least 1")
    missing = [method for method in NEEDED if method not in cfg.comparison.methods]
    if missing:
        raise ConfigError(f"comparison.methods.{missing[0]}: is missing; the variants need it")


def _jobs(cfg: DictConfig, root: Path) -> list[Job]:
    """A job per seed; what only says how many there are and where is no part of a setting."""
    parts = ("drive", "budget")
    setting = {part: OmegaConf.to_container(cfg[part], resolve=True) for part in parts}
    methods = OmegaConf.to_container(cfg.comparison.methods, resolve=True)
    setting["comparison"] = {"methods": methods}
    text = OmegaConf.to_yaml(OmegaConf.create(setting))
    code = driving_code(methods_of(cfg).values())
    return [
        Job(text, code, seed, str(root / f"seed_{seed:03d}"))
        for seed in range(cfg.seed, cfg.seed + cfg.comparison.repetitions)
    ]


def _each_seed(jobs: list[Job], processes: int) -> Iterator[list[dict[str, Any]] | str]:
    """The rows of each job, done before or now in worker processes; or why it has none."""
    waiting: deque[Job] = deque()
    for job in jobs:
        before = laps_before(job)
        if before is None:
            waiting.append(job)
        else:
            yield before
    count = len(jobs) - len(waiting)
    bar = tqdm(total=len(jobs), initial=count, desc="seeds", disable=None)
    workers: Workers[Job, list[dict[str, Any]]] = Workers(
        laps_of, processes, TIME_LIMIT, (laps_of.__module__,)
    )
    with bar, workers:
        while waiting or workers.busy:
            while waiting and workers.idle:
                workers.start(waiting.popleft())
            for ended in workers.wait(POLL):
                count += 1
                bar.update()
                line = f"seed {ended.job.seed}: {ended.reason or 'done'} ({count} of {len(jobs)})"
                tqdm.write(line, file=sys.stderr)
                yield line if ended.result is None else ended.result


if __name__ == "__main__":
    command(study, settings=SETTINGS)
