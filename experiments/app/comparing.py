"""Which runs a comparison is made of: methods on one problem, or many methods on many."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig
from tqdm import tqdm

from experiments.app.build import (
    ConfigError,
    build_optimizer,
    plain,
    recorded_optimum,
)
from experiments.app.compose import composed
from experiments.app.instantiation import MissingLibraryError
from experiments.app.plan import Request, requests
from miho.data import DataUnavailableError
from miho.optim import MIHO
from miho.study import Store


def planned_comparison(cfg: DictConfig, overrides: Sequence[str]) -> tuple[list[Request], int, str]:
    """The runs of a comparison, how many at a time, and a note on its size for figures."""
    _check(cfg, overrides)
    on = _on_problems if cfg.comparison.problems else _on_one
    plan, processes, size = on(cfg, overrides)
    return plan, processes, _note(cfg, size)


def _check(cfg: DictConfig, overrides: Sequence[str]) -> None:
    """Raise ConfigError for what a comparison cannot be."""
    if not cfg.comparison.methods:
        raise ConfigError("comparison.methods: is empty; choose an experiment that compares some")
    for key in ("repetitions", "processes"):
        if cfg.comparison[key] < 1:
            raise ConfigError(f"comparison.{key}: is {cfg.comparison[key]}; expected at least 1")
    for group in ("optimizer", *(("problem",) if cfg.comparison.problems else ())):
        if any(o.startswith(f"{group}=") for o in overrides):
            raise ConfigError(f"{group}: cannot be chosen here; see comparison.{group}s")


def _on_one(cfg: DictConfig, overrides: Sequence[str]) -> tuple[list[Request], int, list[str]]:
    """One problem, one run at a time, methods interleaved; how many at a time, and its size."""
    by_method: list[list[Request]] = []
    size: list[str] = []
    for name, replaced in cfg.comparison.methods.items():
        method_overrides = chosen_method(name, replaced)
        method = composed([*overrides, *method_overrides])
        seeds = range(cfg.comparison.repetitions)
        by_method.append(requests(method, " ".join(method_overrides), seeds, cfg.sweep.time_limit))
        optimizer = build_optimizer(method)
        if isinstance(optimizer, MIHO) and not size:
            size = [f"R = {optimizer.R}"]
    plan = [request for seed in zip(*by_method, strict=True) for request in seed]
    if cfg.fresh:
        set_aside_disturbed(plan, Store(Path(cfg.root)))
    return plan, 1, size


def set_aside_disturbed(plan: Sequence[Request], store: Store) -> None:
    """Make room for runs on a quieter machine: those whose seconds count are kept."""
    for request in plan:
        stored = store.find(request.identity)
        if stored is not None and not stored.result["facts"].get("timing_valid"):
            store.set_aside(stored.folder)


def _on_problems(cfg: DictConfig, overrides: Sequence[str]) -> tuple[list[Request], int, list[str]]:
    """Several problems; their runs, how many at a time, and the parts of a note on their size."""
    arena = plan_arena(cfg, overrides)
    for name, reason in arena.left_out.items():
        print(f"{name}: left out: {reason}", file=sys.stderr)
    problems = len({request.identity.problem for request in arena.plan})
    size = [f"{problems} problems", f"{cfg.comparison.processes} runs at a time"]
    if arena.left_out:
        size.append(f"without {', '.join(arena.left_out)}, which were not to be had here")
    return list(arena.plan), cfg.comparison.processes, size


def _note(cfg: DictConfig, size: list[str]) -> str:
    """The note on the size of the comparison, for figures and tables."""
    parts = [cfg.comparison.note] if cfg.comparison.note else []
    parts += [*size, f"{cfg.comparison.repetitions} repetitions"]
    if cfg.budget.seconds is not None:
        parts.append(f"at most {cfg.budget.seconds:g} s per run")
    if cfg.budget.evaluations is not None:
        parts.append(f"at most {cfg.budget.evaluations:,} evaluations per run")
    if cfg.comparison.problems and cfg.comparison.target is not None:
        parts.append(f"runs end at {cfg.comparison.target:g} times the optimum")
    return ", ".join(parts)


@dataclass(frozen=True)
class ArenaPlan:
    """The runs of an arena, and the problems and methods left out, with the reason."""

    plan: tuple[Request, ...]
    left_out: Mapping[str, str]


def chosen_method(name: str, settings: Mapping[str, Any]) -> list[str]:
    """Hydra's overrides that choose a method of conf/optimizer and replace some of its settings.

    JSON is what Hydra reads too: null, true, numbers and quoted strings.
    """
    replaced = (f"optimizer.{key}={json.dumps(value)}" for key, value in settings.items())
    return [f"optimizer={name}", *replaced]


def plan_arena(
    cfg: DictConfig, overrides: Sequence[str], *, methods: int = 3, families: int = 2
) -> ArenaPlan:
    """Compose and check every problem and every method of `cfg.comparison` once.

    A problem whose data cannot be had is left out, and so is a method whose library is not
    installed; raises ConfigError for any other fault, and where fewer `methods` or `families` of
    problems are left than the tests that follow need (Friedman's: 3 on 2).

    Runs come problem by problem, so that a worker builds each problem once, and all methods with
    one seed after the other: they meet the same load of the machine.
    """
    comparison = cfg.comparison
    left_out: dict[str, str] = {}
    optimizers = []
    plan: list[Request] = []
    kinds = set()
    count = len(comparison.methods) + len(comparison.problems)
    with tqdm(total=count, desc="planning", leave=False, disable=None) as bar:
        # Methods first: what is not installed is left out of every problem.
        for name, replaced in comparison.methods.items():
            bar.update()
            method = plain(composed(chosen_method(name, replaced)))
            try:
                build_optimizer(method)
            except MissingLibraryError as error:
                left_out[name] = str(error)
                continue
            optimizers.append(method["optimizer"])
        # A problem with each of the methods, interleaved by seed.
        for name in comparison.problems:
            bar.update()
            problem = composed([*overrides, f"problem={name}"])
            setting = dict(plain(problem))
            optimum = recorded_optimum(setting)
            if comparison.target is not None and optimum is not None:
                target = (comparison.target * optimum) ** 2  # of the loss, not of its root
                setting["budget"] = {**setting["budget"], "target": target}
            try:
                by_method = [
                    requests(
                        {**setting, "optimizer": optimizer},
                        f"problem={name} optimizer={optimizer['name']}",
                        range(comparison.repetitions),
                        cfg.sweep.time_limit,
                    )
                    for optimizer in optimizers
                ]
            except DataUnavailableError as error:
                left_out[name] = str(error)
                continue
            plan += [request for seed in zip(*by_method, strict=True) for request in seed]
            kinds.add(problem.problem.family or name)
    if len(optimizers) < methods or len(kinds) < families:
        reasons = "".join(f"; {name}: {reason}" for name, reason in left_out.items())
        raise ConfigError(
            f"comparison: holds {len(optimizers)} methods on problems of {len(kinds)} families; "
            f"expected at least {methods} on {families}, so add to comparison.methods or "
            f"comparison.problems{reasons}"
        )
    return ArenaPlan(tuple(plan), left_out)
