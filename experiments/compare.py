"""Compare methods on one problem, on the clock: interleaved, one at a time, one thread.

python -m experiments.compare                        # reduced size, some three minutes
python -m experiments.compare experiment=paper_fig6  # full size, some 70 minutes
python -m experiments.compare experiment=torque_gap  # gaps to a known optimum, half a minute
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from experiments.build import ConfigError, Experiment, build
from experiments.cli import OK, SOME_FAILED, command, composed
from experiments.figures import COMPARISON, draw_comparison
from experiments.run import line, run
from miho.optim import MIHO
from miho.study import Status, write_text

DEFAULT = "experiment=compare"
failed: list[Experiment] = []


def compare(cfg: DictConfig) -> None:
    """Run every method of `comparison.methods` for each repetition, then draw and judge."""
    overrides = [o for o in HydraConfig.get().overrides.task if not o.startswith("seed=")]
    if not cfg.comparison.methods:
        raise ConfigError("comparison.methods: is empty; choose an experiment that compares some")
    repetitions = cfg.comparison.repetitions
    if repetitions < 1:
        raise ConfigError(f"comparison.repetitions: is {repetitions}; expected at least 1")
    if any(o.startswith("optimizer=") for o in overrides):
        raise ConfigError("optimizer: cannot be chosen here; methods are comparison.methods")

    methods = []
    for name, settings in cfg.comparison.methods.items():
        chosen = [f"optimizer={name}", *(f"optimizer.{k}={v}" for k, v in settings.items())]
        methods.append(composed([*overrides, *chosen]))
    planned = []
    for seed in range(repetitions):
        for method in methods:
            method.seed = seed
            planned.append(build(method))
    for number, experiment in enumerate(planned, start=1):
        execution = run(experiment)
        print(f"[{number}/{len(planned)}] {line(experiment, execution)}", flush=True)
        if execution.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if execution.run is None:
            failed.append(experiment)
    if failed:
        return

    root = Path(cfg.root)
    about = {
        "command": ["python", "-m", "experiments.compare", *overrides],
        "note": _note(cfg, planned),
        "runs": [experiment.identity.id for experiment in planned],
    }
    write_text(root / COMPARISON, json.dumps(about, indent=1) + "\n")
    for path in draw_comparison(root, Path(cfg.comparison.output)):
        print(path)


def _note(cfg: DictConfig, planned: list[Experiment]) -> str:
    """What the figure must say of its size."""
    parts = [cfg.comparison.note] if cfg.comparison.note else []
    miho = next((e.optimizer for e in planned if isinstance(e.optimizer, MIHO)), None)
    parts += [f"R = {miho.R}"] if miho else []
    parts.append(f"{cfg.comparison.repetitions} repetitions")
    limits = planned[0].budget
    if limits.seconds is not None:
        parts.append(f"at most {limits.seconds:g} s per run")
    if limits.evaluations is not None:
        parts.append(f"at most {limits.evaluations:,} evaluations per run")
    return ", ".join(parts)


def summary() -> int:
    """The exit code; without all its runs a comparison is not drawn."""
    if failed:
        print(f"{len(failed)} runs are missing, so nothing is drawn; run again", file=sys.stderr)
    return SOME_FAILED if failed else OK


if __name__ == "__main__":
    if not any(argument.startswith("experiment=") for argument in sys.argv):
        sys.argv.append(DEFAULT)
    command(compare, build, summary)
