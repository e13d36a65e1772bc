"""From the command line's -m to a sweep: which runs are wanted, and which launcher does them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.types import Override
from hydra.core.plugins import Plugins
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from experiments.cli import composed
from experiments.explain import ConfigError, whole_space
from experiments.schema import SweepConfig
from experiments.sweep import Done, found, sweep, wanted
from miho.study import Status

finished: list[Done] = []
"""What the sweep of this process did, for the command that asked for it."""
BASIC = "hydra._internal.core_plugins.basic_launcher.BasicLauncher"
OURS = ("seed", "fresh", "sweep")
"""What says how to go through the runs, or which repetition, but not what they are."""


def run_sweep(
    task: TaskFunction, context: HydraContext, config: DictConfig, overrides: Sequence[Override]
) -> list[Done]:
    """Do what the overrides of -m ask for, here or by a launcher, and keep it in `finished`.

    A launcher gets one job for each setting but for the seed, which does all seeds; what became of
    them is then read from the results.
    """
    plan, settings = groups(overrides), sweep_settings(config)
    limit = settings.time_limit
    runs = [
        one
        for group, seeds in plan
        for one in wanted(composed(group), " ".join(group), seeds, limit)
    ]
    if config.hydra.launcher._target_ == BASIC or settings.dry_run:
        asked = [str(o.input_line) for o in overrides if not _ours(o, ("fresh", "sweep"))]
        how = {"fresh": config.fresh, "overrides": asked, "tracking": config.tracking}
        return sweep(runs, settings, ended=finished, **how)
    launcher = Plugins.instance().instantiate_launcher(
        hydra_context=context, task_function=task, config=config
    )
    typed = [str(o.input_line) for o in overrides if _ours(o, ("fresh", "sweep"))]
    jobs = [
        [*whole_space(group), *typed, f"sweep.seeds=[{','.join(map(str, seeds))}]"]
        for group, seeds in plan
    ]
    try:
        launcher.launch(jobs, initial_job_idx=0)
    except Exception as error:  # noqa: BLE001 -- a job of the launcher died; the others are stored
        print(f"{type(launcher).__name__}: {type(error).__name__}: {error}")
    finished.extend(_after_launch(found(one)) for one in runs)
    return finished


def _after_launch(done: Done) -> Done:
    """What a launcher was to do and is not done is lost."""
    if done.status is Status.DONE_BEFORE:
        return done
    reason = done.reason or "its job ended without a result"
    return replace(done, status=Status.LOST, reason=reason)


def sweep_settings(config: DictConfig) -> SweepConfig:
    """The checked settings of `sweep`; raises ConfigError."""
    settings = SweepConfig(**{str(key): value for key, value in config.sweep.items()})
    if settings.processes < 1:
        raise ConfigError(f"sweep.processes: is {settings.processes}; expected at least 1")
    if settings.time_limit is not None and not settings.time_limit > 0:
        raise ConfigError(f"sweep.time_limit: is {settings.time_limit}; expected seconds above 0")
    return settings


def groups(overrides: Sequence[Override]) -> list[tuple[tuple[str, ...], list[int]]]:
    """The settings of a sweep but for the seed, each with its seeds, in the order asked."""
    jobs = BasicSweeper.split_arguments(list(overrides), max_batch_size=None)[0]
    seeds_of: dict[tuple[str, ...], dict[int, None]] = {}
    for job in jobs:
        rest = tuple(text for text in job if not _is_of(text.partition("=")[0].lstrip("+~"), OURS))
        seeds = [text.partition("=")[2] for text in job if text.startswith("seed=")]
        seeds_of.setdefault(rest, {})[_whole(seeds[-1]) if seeds else 0] = None
    return [(rest, list(seeds)) for rest, seeds in seeds_of.items()]


def _whole(seed: str) -> int:
    if not seed.isdecimal():
        raise ConfigError(f"seed: is {seed}; expected a whole number of at least 0")
    return int(seed)


def _ours(override: Override, keys: Sequence[str]) -> bool:
    return _is_of(override.key_or_group, keys)


def _is_of(key: str, keys: Sequence[str]) -> bool:
    return key.partition(".")[0] in keys
