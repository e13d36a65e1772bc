"""A sweep by a launcher of Hydra: a job for each setting, which does all its seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hydra.core.override_parser.types import Override
from hydra.core.plugins import Plugins
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from experiments.app.explain import replace_spaces
from experiments.app.mirror import check_tracking, mirror_runs, say_unmirrored
from experiments.app.plan import Request, is_of, seed_groups
from experiments.app.runs import PlanOutcome, stored_state
from experiments.app.working import State
from miho.study import Status

BASIC = "hydra._internal.core_plugins.basic_launcher.BasicLauncher"
"""Hydra's own, in whose place our workers do the runs."""
FOR_EVERY_JOB = ("fresh", "sweep")
"""Keys that say how to go through the runs, to each job as well."""


def launch_plan(
    plan: Sequence[Request],
    task: TaskFunction,
    context: HydraContext,
    cfg: DictConfig,
    overrides: Sequence[Override],
) -> PlanOutcome:
    """Have a launcher do a plan; what became of it is then read from the results, and mirrored."""
    check_tracking(cfg.tracking)
    launcher = Plugins.instance().instantiate_launcher(
        hydra_context=context, task_function=task, config=cfg
    )
    shared = [str(o.input_line) for o in overrides if is_of(o.key_or_group, FOR_EVERY_JOB)]
    jobs = [
        [*replace_spaces(group), *shared, f"sweep.seeds=[{','.join(map(str, seeds))}]"]
        for group, seeds in seed_groups(overrides)
    ]
    try:
        launcher.launch(jobs, initial_job_idx=0)
    except KeyboardInterrupt:
        say_unmirrored(plan, cfg.tracking)
        raise
    except Exception as error:  # noqa: BLE001 -- a job of the launcher died; the others are stored
        print(f"{type(launcher).__name__}: {type(error).__name__}: {error}")
    states = [_after_launch(stored_state(request)) for request in plan]
    mirror_runs(plan, cfg.tracking)
    return PlanOutcome(states)


def _after_launch(state: State) -> State:
    """The state of a run after its launcher has ended: what is not done is lost."""
    if state.status is Status.DONE_BEFORE:
        return state
    reason = state.reason or "its job ended without a result"
    return replace(state, status=Status.LOST, reason=reason)
