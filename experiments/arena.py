"""Many methods on many problems: which runs there are, and doing them, several at a time."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from experiments import schema
from experiments.build import (
    ConfigError,
    MissingLibraryError,
    build,
    build_optimizer,
    build_problem,
)
from experiments.cli import composed
from experiments.run import line, run
from miho.data import DataUnavailableError
from miho.identification import CurveFit
from miho.study import Status


@dataclass(frozen=True)
class Block:
    """All methods on one problem with one seed, one after the other: they share the machine's mood.

    `setting` and each of `methods` are YAML: the problem with its budget, and the optimizers.
    """

    problem: str
    setting: str
    methods: tuple[str, ...]
    seed: int


@dataclass(frozen=True)
class Done:
    """One run of a block: what to print of it, its identity and what became of it."""

    line: str
    id: str
    status: Status


@dataclass(frozen=True)
class Plan:
    """What an arena consists of, and the problems and methods left out, with the reason."""

    blocks: tuple[Block, ...]
    left_out: Mapping[str, str]

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return sum(len(block.methods) for block in self.blocks)


def plan(cfg: DictConfig, overrides: Sequence[str]) -> Plan:
    """Compose and check every problem and every method of `cfg.comparison` once.

    A problem whose data cannot be had is left out, and so is a method whose library is not
    installed; raises ConfigError for any other fault.
    """
    comparison = cfg.comparison
    optimizers = []
    left_out: dict[str, str] = {}
    for name, settings in comparison.methods.items():
        chosen = [f"optimizer={name}", *(f"optimizer.{k}={v}" for k, v in settings.items())]
        method = composed(chosen)
        try:
            build_optimizer(method)
        except MissingLibraryError as error:
            left_out[name] = str(error)
            continue
        optimizers.append(method.optimizer)
    settings = {}
    for name in comparison.problems:
        setting = composed([*overrides, f"problem={name}"])
        try:
            problem = build_problem(setting)
        except DataUnavailableError as error:
            left_out[name] = str(error)
            continue
        build(setting, problem)
        settings[name] = OmegaConf.to_yaml(setting)
    if not settings:
        raise ConfigError(f"comparison.problems: {', '.join(left_out.values())}")
    methods = tuple(OmegaConf.to_yaml(optimizer) for optimizer in optimizers)
    blocks = tuple(
        Block(name, setting, methods, seed)
        for seed in range(comparison.repetitions)
        for name, setting in settings.items()
    )
    return Plan(blocks, left_out)


def execute_all(planned: Plan, processes: int) -> Iterator[Done]:
    """The runs as they get done, with a bar on a terminal, else a line for each block.

    Raises KeyboardInterrupt once all has stopped after an interrupt; what is done stays done.
    """
    context = multiprocessing.get_context("spawn")
    with (
        tqdm(total=planned.runs, desc="runs", smoothing=0.02, disable=None) as bar,
        ProcessPoolExecutor(processes, context, initializer=schema.register) as pool,
    ):
        jobs = {pool.submit(_run_block, block): block for block in planned.blocks}
        done = 0
        try:
            for job in as_completed(jobs):
                block, runs = jobs[job], job.result()
                done += len(runs)
                bar.update(len(runs))
                if bar.disable:
                    print(f"[{done}/{planned.runs}] {block.problem} seed {block.seed}", flush=True)
                yield from runs
                if any(one.status is Status.INTERRUPTED for one in runs):
                    raise KeyboardInterrupt
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _run_block(block: Block) -> list[Done]:
    setting, problem = _problem(block.setting)
    setting.seed = block.seed
    runs = []
    for method in block.methods:
        setting.optimizer = OmegaConf.create(method)
        experiment = build(setting, problem)
        execution = run(experiment, quiet=True)
        runs.append(Done(line(experiment, execution), experiment.identity.id, execution.status))
        if execution.status is Status.INTERRUPTED:
            break
    return runs


@lru_cache(maxsize=2)
def _problem(setting: str) -> tuple[DictConfig, CurveFit]:
    """A problem is built once in a process, for all methods and seeds that come there in a row."""
    cfg = cast(DictConfig, OmegaConf.create(setting))
    return cfg, build_problem(cfg)
