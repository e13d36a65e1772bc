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

import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from experiments.app.comparing import planned_comparison
from experiments.app.console import OK, SOME_FAILED, command
from experiments.app.plan import sweep_settings
from experiments.app.runs import run

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


def compare(cfg: DictConfig) -> int:
    """Run every method of `comparison.methods` for each repetition, then draw and judge.

    Without all its runs a comparison is not drawn.
    """
    overrides = [o for o in HydraConfig.get().overrides.task if not o.startswith("seed=")]
    plan, processes, note = planned_comparison(cfg, overrides)
    runs = run(
        plan, sweep_settings(cfg), processes=processes, fresh=cfg.fresh, overrides=overrides,
        tracking=cfg.tracking,
    )  # fmt: skip
    failed = [s.line for s in runs.states if s.error is None and s.reason is not None]
    for line in failed:
        print(line, file=sys.stderr)
    if failed:
        print(f"runs missing: {len(failed)}; nothing is drawn, run again", file=sys.stderr)
    runs.raise_if_stopped()
    if failed:
        return SOME_FAILED
    # Here, because a worker process needs no figures, and they take a second to import.
    from experiments.app.drawing import draw_arena, draw_comparison
    from miho.analysis.compare.comparison import write_comparison

    root, command = Path(cfg.root), ["python", "-m", "experiments.compare", *overrides]
    write_comparison(root, command, note, [request.identity.id for request in plan])
    draw = draw_arena if cfg.comparison.problems else draw_comparison
    for path in draw(root, Path(cfg.comparison.output)):
        print(path)
    return OK


def main() -> None:
    """The command."""
    if not any(argument.startswith(("experiment=", "--help", "-h")) for argument in sys.argv):
        sys.argv.append(DEFAULT)
    command(compare, settings=SETTINGS)


if __name__ == "__main__":
    main()
