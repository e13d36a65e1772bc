"""Many methods on many problems: which runs there are, and doing them, several at a time."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

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


def chosen_method(name: str, settings: Mapping[str, Any]) -> list[str]:
    """Hydra's overrides that choose a method of conf/optimizer and replace some of its settings.

    JSON is what Hydra reads too: null, true, numbers and quoted strings.
    """
    replaced = (f"optimizer.{key}={json.dumps(value)}" for key, value in settings.items())
    return [f"optimizer={name}", *replaced]


def plan(cfg: DictConfig, overrides: Sequence[str], *, methods: int = 3, families: int = 2) -> Plan:
    """Compose and check every problem and every method of `cfg.comparison` once.

    A problem whose data cannot be had is left out, and so is a method whose library is not
    installed; raises ConfigError for any other fault, and where fewer `methods` or `families` of
    problems are left than the tests that follow need (Friedman's: 3 on 2).

    Blocks come problem by problem, so that a worker builds each problem once.
    """
    comparison = cfg.comparison
    optimizers = []
    left_out: dict[str, str] = {}
    for name, settings in comparison.methods.items():
        method = composed(chosen_method(name, settings))
        try:
            build_optimizer(method)
        except MissingLibraryError as error:
            left_out[name] = str(error)
            continue
        optimizers.append(method.optimizer)
    settings, kinds = {}, set()
    for name in comparison.problems:
        setting = composed([*overrides, f"problem={name}"])
        try:
            problem = build_problem(setting)
        except DataUnavailableError as error:
            left_out[name] = str(error)
            continue
        build(setting, problem)
        settings[name] = OmegaConf.to_yaml(setting)
        kinds.add(setting.problem.family or name)
    if len(optimizers) < methods or len(kinds) < families:
        reasons = "".join(f"; {name}: {reason}" for name, reason in left_out.items())
        raise ConfigError(
            f"comparison: holds {len(optimizers)} methods on problems of {len(kinds)} families; "
            f"expected at least {methods} on {families}, so add to comparison.methods or "
            f"comparison.problems{reasons}"
        )
    yamls = tuple(OmegaConf.to_yaml(optimizer) for optimizer in optimizers)
    blocks = tuple(
        Block(name, setting, yamls, seed)
        for name, setting in settings.items()
        for seed in range(comparison.repetitions)
    )
    return Plan(blocks, left_out)


def execute_all(planned: Plan, processes: int) -> Iterator[Done]:
    """The runs as they get done, with a bar on a terminal, else a line for each block.

    Raises KeyboardInterrupt once all has stopped after an interrupt, ChildProcessError where the
    system killed the process of a run; what is done stays done.
    """
    context = multiprocessing.get_context("spawn")
    with (
        tqdm(total=planned.runs, desc="runs", smoothing=0.02, disable=None) as bar,
        ProcessPoolExecutor(processes, context, initializer=schema.register) as pool,
    ):
        done = 0
        try:
            jobs = {pool.submit(_run_block, block): block for block in planned.blocks}
            for job in as_completed(jobs):
                block, runs = jobs[job], job.result()
                done += len(runs)
                bar.update(len(runs))
                if bar.disable:
                    print(f"[{done}/{planned.runs}] {block.problem} seed {block.seed}", flush=True)
                yield from runs
                if any(one.status is Status.INTERRUPTED for one in runs):
                    raise KeyboardInterrupt
        except BrokenProcessPool:
            raise ChildProcessError(
                "the process of a run was killed, perhaps for want of memory; what is done is "
                "kept, and the next call goes on from there"
            ) from None
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


@lru_cache(maxsize=1)
def _problem(setting: str) -> tuple[DictConfig, CurveFit]:
    """A problem is built once in a process, whose blocks come problem by problem."""
    cfg = cast(DictConfig, OmegaConf.create(setting))
    return cfg, build_problem(cfg)
