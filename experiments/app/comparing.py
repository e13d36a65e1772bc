"""Runs of an arena: many methods on many problems."""

import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from fnmatch import filter as filter_names
from pathlib import Path
from typing import Any

from omegaconf import DictConfig
from tqdm import tqdm

from experiments.app.build import ConfigError, build_optimizer, plain, recorded_optimum
from experiments.app.compose import composed, option_folders
from experiments.app.console import OK, SOME_FAILED
from experiments.app.explain import parse_overrides, unknown_message
from experiments.app.instantiation import MissingLibraryError
from experiments.app.options import options_of, recorded
from experiments.app.plan import Request, Trials, requests
from experiments.app.working import State
from miho.study import Status
from miho.vehicle.data import DataUnavailableError

METHODS, FAMILIES = 3, 2
"""Least numbers of methods and of families of problems for Friedman's test."""
INSTEAD = {"optimizer": "methods", "problem": "problems", "seed": "repetitions"}
"""Settings of a single run, and the settings of an arena in their place."""


def planned_arena(cfg: DictConfig, overrides: Sequence[str]) -> tuple[list[Request], str]:
    """Runs of an arena, and a note on its size for figures."""
    _replace_methods(cfg, overrides)
    _check(cfg, overrides)
    plan, left_out = plan_arena(cfg, overrides)
    for name, reason in left_out.items():
        print(f"{name}: left out: {reason}", file=sys.stderr)
    problems = len({request.identity.problem for request in plan})
    workers = cfg.sweep.workers
    size = [f"{problems} problems", f"{workers} run{'s' * (workers != 1)} at a time"]
    if left_out:
        size.append(f"without {', '.join(left_out)}, which were not available")
    note = note_on_size(cfg, size, cfg.comparison.repetitions)
    if cfg.comparison.target is not None:
        note += f", runs end at {cfg.comparison.target:g} times the optimum"
    return plan, note


def _replace_methods(cfg: DictConfig, overrides: Sequence[str]) -> None:
    """Let comparison.methods={...} replace the methods of the experiment, with which Hydra merges.

    A method that another override adds is kept.
    """
    typed = {override.key_or_group: override.value() for override in parse_overrides(overrides)}
    methods = typed.get("comparison.methods")
    if isinstance(methods, dict):
        merged = cfg.comparison.methods.items()
        added = {name: node for name, node in merged if f"comparison.methods.{name}" in typed}
        cfg.comparison.methods = {**methods, **added}


def _check(cfg: DictConfig, overrides: Sequence[str]) -> None:
    """Raise ConfigError for an impossible arena."""
    if not (cfg.comparison.methods and cfg.comparison.problems):
        raise ConfigError(
            "experiment: compares nothing; choose one that sweeps over methods, such as "
            "experiment=compare, or that names problems, such as experiment=arena_small"
        )
    repetitions = cfg.comparison.repetitions
    if repetitions < 1:
        raise ConfigError(f"comparison.repetitions: is {repetitions}; expected at least 1")
    for key, instead in INSTEAD.items():
        if any(o.lstrip("+").startswith(f"{key}=") for o in overrides):
            raise ConfigError(f"{key}: cannot be chosen here; set comparison.{instead}")


def note_on_size(cfg: DictConfig, size: Sequence[str], repetitions: int) -> str:
    """Note on the size of a comparison, for figures and tables."""
    parts = [cfg.comparison.note] if cfg.comparison.note else []
    parts += [*size, f"{repetitions} repetition{'s' * (repetitions != 1)}"]
    if cfg.budget.seconds is not None:
        parts.append(f"at most {cfg.budget.seconds:g} s per run")
    if cfg.budget.evaluations is not None:
        parts.append(f"at most {cfg.budget.evaluations:,} evaluations per run")
    return ", ".join(parts)


def chosen_problems(
    patterns: Sequence[str],
    folders: Sequence[Path] | None = None,
    *,
    key: str = "comparison.problems",
) -> list[str]:
    """Problems by name or by a pattern such as `nist_*`, each once, in the order of the patterns.

    `folders` of options have the problems; without, they are conf/ and the command's --config-dir.
    Raises ConfigError, which names the setting `key`, for a pattern that matches no problem.
    """
    options = options_of("problem", folders or option_folders())
    known = [*filter(options.__contains__, recorded()), *options]
    names: dict[str, None] = {}
    for pattern in patterns:
        matching = filter_names(known, pattern)
        if not matching:
            raise ConfigError(unknown_message(f"{key}={pattern}", options))
        names |= dict.fromkeys(matching)
    return list(names)


def chosen_method(name: str, settings: Mapping[str, Any]) -> list[str]:
    """Overrides of Hydra that choose a method of conf/optimizer and replace some of its settings.

    Hydra can read JSON: null, true, numbers and quoted strings.
    """
    replaced = (f"optimizer.{key}={json.dumps(value)}" for key, value in settings.items())
    return [f"optimizer={name}", *replaced]


def plan_arena(cfg: DictConfig, overrides: Sequence[str]) -> tuple[list[Request], dict[str, str]]:
    """Compose and check every problem and every method of `cfg.comparison` once.

    A problem is left out if its data are not available, and a method if its library is not
    installed; the reasons are returned by name. Raises ConfigError for other faults, and if fewer
    methods or families of problems are left than Friedman's test needs.

    Runs are ordered by problem, so that a worker builds each problem once, and then by seed, so
    that all methods run under the same load of the machine.
    """
    comparison = cfg.comparison
    left_out: dict[str, str] = {}
    optimizers = []
    plan: list[Request] = []
    kinds = set()
    problems = chosen_problems(comparison.problems)
    count = len(comparison.methods) + len(problems)
    with (
        Trials(cfg.sweep.time_limit) as trials,
        tqdm(total=count, desc="planning", leave=False, disable=None) as bar,
    ):
        # Methods first: a method that is not installed is left out on every problem.
        for name, replaced in comparison.methods.items():
            bar.update()
            method = plain(composed(chosen_method(name, replaced)))
            try:
                build_optimizer(method)
            except MissingLibraryError as error:
                left_out[name] = str(error)
                continue
            optimizers.append({key: method[key] for key in ("optimizer", "method")})
        # Then each problem with all methods, interleaved by seed.
        for name in problems:
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
                        {**setting, **optimizer},
                        f"problem={name} optimizer={optimizer['method']}",
                        range(comparison.repetitions),
                        trials,
                    )
                    for optimizer in optimizers
                ]
            except DataUnavailableError as error:
                left_out[name] = str(error)
                continue
            plan += [request for seed in zip(*by_method, strict=True) for request in seed]
            kinds.add(problem.problem.family or name)
    if len(optimizers) < METHODS or len(kinds) < FAMILIES:
        reasons = "".join(f"; {name}: {reason}" for name, reason in left_out.items())
        raise ConfigError(
            f"comparison: holds {len(optimizers)} methods on problems of {len(kinds)} families; "
            f"expected at least {METHODS} on {FAMILIES}, so add to comparison.methods or "
            f"comparison.problems{reasons}"
        )
    return plan, left_out


def draw(
    cfg: DictConfig,
    plan: Sequence[Request],
    states: Sequence[State],
    words: Sequence[str],
    note: str,
) -> int:
    """Draw and judge a comparison, unless some of its runs are missing; return the exit code.

    `words` of the command line are recorded with the comparison.
    """
    failed = [s.line for s in states if s.error is None and s.reason is not None]
    if failed:
        print("\n".join(failed), file=sys.stderr)
        again = "no figure is drawn, run again"
        if not cfg.comparison.problems:  # figure 6 states which runs are missing
            words = ["python", "-m", "experiments.figures", "fig6", f"root={cfg.root}"]
            again += f", or draw the others: {shlex.join(words)}"
        print(f"runs missing: {len(failed)}; {again}", file=sys.stderr)
        return SOME_FAILED
    if any(state.status is Status.TO_DO for state in states):  # of a dry run
        return OK
    # Imported here: worker processes need no figures, and the import takes a second.
    from experiments.app.drawing import draw_arena, draw_comparison
    from miho.analysis.compare.comparison import write_comparison

    root, output = Path(cfg.root), Path(cfg.comparison.output)
    multirun = [word for word in sys.argv[1:] if word in ("-m", "--multirun")]
    command = ["python", "-m", "experiments.compare", *multirun, *map(shlex.quote, words)]
    ids = [request.identity.id for request in plan]
    write_comparison(root, command, note, ids)
    if cfg.comparison.problems:
        paths = draw_arena(root, output)
    else:
        paths = draw_comparison(root, output, ids=ids, command=command)
    print("\n".join(map(str, paths)))
    return OK
