"""`hydra/sweeper=optuna`: Optuna chooses the jobs of a multirun from what earlier ones reached.

Hydra imports this file at the start of every command, so Optuna is imported where it is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hydra.core.plugins import Plugins
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

if TYPE_CHECKING:
    from optuna.samplers import BaseSampler


class OptunaSweeper(Sweeper):
    """A study of Optuna whose trials are jobs of Hydra.

    Overrides that hold `choice()`, `range()` or `interval()` are the search space, those in
    `params` and those typed; all others are the same for each trial.

    Parameters
    ----------
    sampler
        One of Optuna's samplers.
    direction
        ``minimize`` or ``maximize``.
    n_trials
        Trials of the study in all, with the finished ones of earlier calls.
    n_jobs
        Trials that the launcher gets at a time.
    storage
        URL of the database that keeps the study; without one it is kept in memory.
    study_name
        Name of the study in that database.
    max_failure_rate
        Share of a batch that may end without a finite error before the study ends.
    params
        The search space by setting, such as ``{"optimizer.R": "interval(100, 10000)"}``.
    """

    def __init__(
        self,
        sampler: BaseSampler,
        direction: str = "minimize",
        n_trials: int = 20,
        n_jobs: int = 1,
        storage: str | None = None,
        study_name: str | None = None,
        max_failure_rate: float = 0.0,
        params: Mapping[str, Any] | None = None,
    ) -> None:
        self.sampler, self.direction = sampler, direction
        self.n_trials, self.n_jobs = n_trials, n_jobs
        self.storage, self.study_name = storage, study_name
        self.max_failure_rate, self.params = max_failure_rate, dict(params or {})

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Make the launcher that does the trials."""
        self.hydra_context, self.config = hydra_context, config
        self.launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )

    def sweep(self, arguments: list[str]) -> None:
        """Run the study until it has its trials."""
        from experiments.app.tuning import tune

        if self.launcher is None or self.config is None:
            raise RuntimeError("setup() comes before sweep()")
        tune(self, self.launcher, self.config, arguments)
