"""Compare methods: on one problem on the clock, or on many problems at once.

On one problem runs are interleaved, one at a time, on one thread. On many problems several run at a
time, so that evaluations are what compares, and seconds are those of a machine in full use. Runs
have processes of their own, so that one that is killed ends alone.

python -m experiments.compare                        # reduced size, some three minutes
python -m experiments.compare experiment=paper_fig6  # full size, some 70 minutes
python -m experiments.compare experiment=torque_gap  # gaps to a known optimum, half a minute
python -m experiments.compare experiment=arena       # many methods on many problems, 41 minutes
python -m experiments.compare experiment=arena_small # the same, small, two minutes
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from experiments.arena import chosen_method, plan
from experiments.build import ConfigError, build_optimizer
from experiments.cli import OK, SOME_FAILED, command, composed
from experiments.comparison import COMPARISON
from experiments.sweep import Wanted, mirrors, sweep, wanted
from experiments.sweep_command import sweep_settings
from miho.optim import MIHO
from miho.study import Store, write_text

DEFAULT = "experiment=compare"
SETTINGS = {
    "experiment": "what is compared; experiment --help lists them",
    "comparison.repetitions": "runs of each method, with seeds 0, 1, ...",
    "comparison.methods": "'+comparison.methods.pso_100={}' adds one of optimizer --help",
    "comparison.processes": "runs at a time, where several problems are compared",
    "comparison.target": "runs on several problems end at so many times the optimum",
    "budget.evaluations, budget.seconds": "what a run may spend; it ends at the first of them",
    "root, fresh": "where results go; fresh=true sets aside what is outdated",
}
failed: list[str] = []


def compare(cfg: DictConfig) -> None:
    """Run every method of `comparison.methods` for each repetition, then draw and judge."""
    overrides = [o for o in HydraConfig.get().overrides.task if not o.startswith("seed=")]
    if not cfg.comparison.methods:
        raise ConfigError("comparison.methods: is empty; choose an experiment that compares some")
    for key in ("repetitions", "processes"):
        if cfg.comparison[key] < 1:
            raise ConfigError(f"comparison.{key}: is {cfg.comparison[key]}; expected at least 1")
    for group in ("optimizer", *(("problem",) if cfg.comparison.problems else ())):
        if any(o.startswith(f"{group}=") for o in overrides):
            raise ConfigError(f"{group}: cannot be chosen here; see comparison.{group}s")
    on = _on_problems if cfg.comparison.problems else _on_one
    ids, note = on(cfg, overrides)
    if failed:
        return
    root = Path(cfg.root)
    about = {
        "command": ["python", "-m", "experiments.compare", *overrides],
        "note": note,
        "runs": ids,
    }
    write_text(root / COMPARISON, json.dumps(about, indent=1) + "\n")
    # Here, because a worker process needs no figures, and they take a second to import.
    from experiments.arena_results import draw_arena
    from experiments.figures import draw_comparison

    draw = draw_arena if cfg.comparison.problems else draw_comparison
    for path in draw(root, Path(cfg.comparison.output)):
        print(path)


def _on_one(cfg: DictConfig, overrides: list[str]) -> tuple[list[str], str]:
    """One problem, one run at a time, methods interleaved; the runs and what to say of them."""
    by_method: list[list[Wanted]] = []
    size: list[str] = []
    for name, replaced in cfg.comparison.methods.items():
        chosen = chosen_method(name, replaced)
        method = composed([*overrides, *chosen])
        by_method.append(wanted(method, " ".join(chosen), range(cfg.comparison.repetitions)))
        optimizer = build_optimizer(method)
        if isinstance(optimizer, MIHO) and not size:
            size = [f"R = {optimizer.R}"]
    runs = [one for seed in zip(*by_method, strict=True) for one in seed]
    store = Store(Path(cfg.root))
    if cfg.fresh:
        _set_aside_disturbed(runs, store)
    _sweep(runs, cfg, overrides, processes=1, tracking={})
    with mirrors([cfg.root], cfg.tracking) as opened:  # after the last run: they were on the clock
        for stored in (store.find(one.identity) for one in runs if opened):
            if stored is not None:
                opened[cfg.root].push(stored)
    return [one.identity.id for one in runs], _note(cfg, size)


def _set_aside_disturbed(runs: Sequence[Wanted], store: Store) -> None:
    """Make room for runs on a quieter machine: those whose seconds count are kept."""
    for one in runs:
        stored = store.find(one.identity)
        if stored is not None and not stored.result["facts"].get("timing_valid"):
            store.set_aside(stored.folder)


def _on_problems(cfg: DictConfig, overrides: list[str]) -> tuple[list[str], str]:
    """Several problems, `processes` runs at a time; the runs and what to say of them."""
    planned = plan(cfg, overrides)
    for name, reason in planned.left_out.items():
        print(f"{name}: left out: {reason}", file=sys.stderr)
    _sweep(planned.runs, cfg, overrides, cfg.comparison.processes, cfg.tracking)
    problems = len({one.identity.problem for one in planned.runs})
    size = [f"{problems} problems", f"{cfg.comparison.processes} runs at a time"]
    if planned.left_out:
        size.append(f"without {', '.join(planned.left_out)}, which were not to be had here")
    return [one.identity.id for one in planned.runs], _note(cfg, size)


def _sweep(
    runs: Sequence[Wanted],
    cfg: DictConfig,
    overrides: list[str],
    processes: int,
    tracking: Mapping[str, Any],
) -> None:
    """Do the runs in processes of their own and say which are missing."""
    settings = sweep_settings(cfg)
    settings.processes = processes
    ended = sweep(runs, settings, fresh=cfg.fresh, overrides=overrides, tracking=tracking)
    failed.extend(done.line for done in ended if done.error is None and done.reason is not None)
    for told in failed:
        print(told, file=sys.stderr)


def _note(cfg: DictConfig, size: list[str]) -> str:
    """What figures and tables must say of the size of the comparison."""
    parts = [cfg.comparison.note] if cfg.comparison.note else []
    parts += [*size, f"{cfg.comparison.repetitions} repetitions"]
    if cfg.budget.seconds is not None:
        parts.append(f"at most {cfg.budget.seconds:g} s per run")
    if cfg.budget.evaluations is not None:
        parts.append(f"at most {cfg.budget.evaluations:,} evaluations per run")
    if cfg.comparison.problems and cfg.comparison.target is not None:
        parts.append(f"runs end at {cfg.comparison.target:g} times the optimum")
    return ", ".join(parts)


def summary() -> int:
    """The exit code; without all its runs a comparison is not drawn."""
    if failed:
        print(f"runs missing: {len(failed)}; nothing is drawn, run again", file=sys.stderr)
    return SOME_FAILED if failed else OK


def main() -> None:
    """The command."""
    if not any(argument.startswith(("experiment=", "--help", "-h")) for argument in sys.argv):
        sys.argv.append(DEFAULT)
    command(compare, summary, settings=SETTINGS)


if __name__ == "__main__":
    main()
