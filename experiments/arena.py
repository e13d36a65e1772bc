"""Many methods on many problems: which runs there are."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from omegaconf import DictConfig

from experiments.build import (
    ConfigError,
    MissingLibraryError,
    build,
    build_optimizer,
    build_problem,
    recorded_optimum,
)
from experiments.cli import composed
from experiments.own_code import runs_own_code
from experiments.sweep import Wanted, wanted
from miho.data import DataUnavailableError


@dataclass(frozen=True)
class Plan:
    """The runs of an arena, and the problems and methods left out, with the reason."""

    runs: tuple[Wanted, ...]
    left_out: Mapping[str, str]


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

    Runs come problem by problem, so that a worker builds each problem once, and all methods with
    one seed after the other: they share the machine's mood.
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
        if not runs_own_code(setting):  # else `wanted` tries it, in a process of its own
            try:
                problem = build_problem(setting)
            except DataUnavailableError as error:
                left_out[name] = str(error)
                continue
            build(setting, problem)
        optimum = recorded_optimum(setting)
        if comparison.target is not None and optimum is not None:
            setting.budget.target = (comparison.target * optimum) ** 2  # of the loss, not its root
        settings[name] = setting
        kinds.add(setting.problem.family or name)
    if len(optimizers) < methods or len(kinds) < families:
        reasons = "".join(f"; {name}: {reason}" for name, reason in left_out.items())
        raise ConfigError(
            f"comparison: holds {len(optimizers)} methods on problems of {len(kinds)} families; "
            f"expected at least {methods} on {families}, so add to comparison.methods or "
            f"comparison.problems{reasons}"
        )
    runs = []
    for name, setting in settings.items():
        by_method = []
        for method in optimizers:
            setting.optimizer = method
            asked = f"problem={name} optimizer={method.name}"
            by_method.append(wanted(setting, asked, range(comparison.repetitions)))
        runs += [one for seed in zip(*by_method, strict=True) for one in seed]
    return Plan(tuple(runs), left_out)
