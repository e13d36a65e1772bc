"""The seeds of a study of laps: its jobs, their execution in workers, and its table."""

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
from experiments.app.origin import driving_code, regenerates
from experiments.app.plan import sweep_settings
from experiments.driving.laps import VARIANTS, SeedJob, laps_of, methods_of, stored_laps
from experiments.driving.settings import factors_text, track_and_vehicle
from miho.analysis import save
from miho.analysis.figures.driving import lap_figure, lap_table, lap_text
from miho.analysis.text import csv_text
from miho.parallel.cluster import is_address
from miho.parallel.workers import Workers
from miho.study import write_text

NEEDED = ("miho", "least_squares")
POLL = 0.5
TIME_LIMIT = 1800.0


def write_study(cfg: DictConfig, root: Path, rows: list[dict[str, Any]]) -> None:
    """Write the laps, their table as text and CSV, the figure, and their provenance."""
    laps = pd.DataFrame(rows)
    laps["variant"] = pd.Categorical(laps["variant"], [variant.name for variant in VARIANTS])
    laps = laps.sort_values(["variant", "seed"]).reset_index(drop=True)
    table = lap_table(laps, np.random.default_rng(cfg.seed))
    write_text(root / "laps.csv", csv_text(laps, float_format="%.6g"))
    write_text(root / "table.csv", csv_text(table, float_format="%.6g"))
    write_text(root / "table.txt", lap_text(table) + "\n")
    note = f"one lap of {cfg.drive.track.name.upper()}, {factors_text(cfg)}, at most "
    note += f"{3.6 * cfg.drive.top_speed:.0f} km/h; {laps['seed'].nunique()} seeds"
    paths = save(lap_figure(laps, table, note=note), root / "figures" / "identification_buys")
    about = regenerates("experiments.drive_study", methods_of(cfg).values())
    about |= {"seeds": sorted(set(laps["seed"].tolist()))}
    write_text(root / "drive_study.json", json.dumps(about, indent=1) + "\n")
    print(lap_text(table))
    names = ("laps.csv", "table.csv", "table.txt", "drive_study.json")
    print("\n".join(map(str, [*paths, *(root / name for name in names)])))


def check_study(cfg: DictConfig) -> None:
    """Raise ConfigError for bad settings before the first seed."""
    track_and_vehicle(cfg)
    repetitions, workers = cfg.comparison.repetitions, sweep_settings(cfg.sweep).workers
    if repetitions < 1:
        raise ConfigError(f"comparison.repetitions: is {repetitions}; expected at least 1")
    if is_address(workers):
        raise ConfigError(f"sweep.workers: is {workers}; a study of drives runs on this machine")
    if cfg.drive.sensitivity is None:
        raise ConfigError(
            "drive.sensitivity: is null; expected a number, because drives do not determine it as "
            "property data do"
        )
    missing = [method for method in NEEDED if method not in cfg.comparison.methods]
    if missing:
        raise ConfigError(f"comparison.methods.{missing[0]}: is missing; the variants need it")


def jobs_of(cfg: DictConfig, root: Path) -> list[SeedJob]:
    """One job per seed, whose configuration leaves out the number of seeds and the root."""
    setting: dict[str, Any] = {
        part: OmegaConf.to_container(cfg[part], resolve=True) for part in ("drive", "budget")
    }
    methods = OmegaConf.to_container(cfg.comparison.methods, resolve=True)
    setting["comparison"] = {"methods": methods}
    setting["drive"].pop("output")
    text = OmegaConf.to_yaml(OmegaConf.create(setting))
    code = driving_code(methods_of(cfg).values())
    return [
        SeedJob(text, code, seed, str(root / f"seed_{seed:03d}"))
        for seed in range(cfg.seed, cfg.seed + cfg.comparison.repetitions)
    ]


def each_seed(jobs: list[SeedJob], processes: int) -> Iterator[list[dict[str, Any]] | str]:
    """Rows of each job, stored or computed in worker processes, or a line with the reason."""
    waiting: deque[SeedJob] = deque()
    for job in jobs:
        stored = stored_laps(job)
        if stored is None:
            waiting.append(job)
        else:
            yield stored
    count = len(jobs) - len(waiting)
    bar = tqdm(total=len(jobs), initial=count, desc="seeds", disable=None)
    workers: Workers[SeedJob, list[dict[str, Any]]] = Workers(
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
