"""A sweep by a launcher of Hydra: a job for each setting, which does all its seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hydra.core.override_parser.types import Override
from hydra.core.plugins import Plugins
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from experiments.app.explain import whole_space
from experiments.app.plan import Request, groups, is_of
from experiments.app.runs import Runs, State, known
from miho.study import Status

BASIC = "hydra._internal.core_plugins.basic_launcher.BasicLauncher"
"""Hydra's own, in whose place our workers do the runs."""
TYPED = ("fresh", "sweep")
"""What says how to go through the runs, for each job as well."""


def launched(
    plan: Sequence[Request],
    task: TaskFunction,
    context: HydraContext,
    cfg: DictConfig,
    overrides: Sequence[Override],
) -> Runs:
    """Have a launcher do a plan; what became of it is then read from the results."""
    launcher = Plugins.instance().instantiate_launcher(
        hydra_context=context, task_function=task, config=cfg
    )
    typed = [str(o.input_line) for o in overrides if is_of(o.key_or_group, TYPED)]
    jobs = [
        [*whole_space(group), *typed, f"sweep.seeds=[{','.join(map(str, seeds))}]"]
        for group, seeds in groups(overrides)
    ]
    try:
        launcher.launch(jobs, initial_job_idx=0)
    except Exception as error:  # noqa: BLE001 -- a job of the launcher died; the others are stored
        print(f"{type(launcher).__name__}: {type(error).__name__}: {error}")
    return Runs([_after_launch(known(request)) for request in plan])


def _after_launch(state: State) -> State:
    """What a launcher was to do and is not done is lost."""
    if state.status is Status.DONE_BEFORE:
        return state
    reason = state.reason or "its job ended without a result"
    return replace(state, status=Status.LOST, reason=reason)
