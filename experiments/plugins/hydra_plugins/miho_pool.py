"""`hydra/launcher=pool`: the jobs of a multirun are runs of the store, done by a pool of workers.

Hydra imports this file at the start of every command, so it imports what it needs when it launches.
"""

from collections.abc import Sequence
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, env_override
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig


class PoolLauncher(Launcher):
    """Each run is done once and fails alone; see `experiments.app.launch`.

    Parameters
    ----------
    **settings
        The fields of `experiments.app.schema.SweepConfig`.
    """

    def __init__(self, **settings: Any) -> None:
        self.settings = settings

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Keep the configuration and the task of the multirun, whose jobs Hydra composes next."""
        from experiments.app.launch import Compositions

        loader = hydra_context.config_loader
        self.compositions = Compositions(loader.load_sweep_config)
        loader.load_sweep_config = self.compositions  # type: ignore[method-assign]
        HydraConfig.instance().set_config(config)  # for ${hydra:...} in root
        self.hydra_context, self.task_function, self.config = hydra_context, task_function, config

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Do the jobs of a batch that are not done; gives the error that each of them reached."""
        from experiments.app.launch import launch

        with env_override(self.config.hydra.job.env_set):
            returned = launch(
                job_overrides, initial_job_idx, self.hydra_context, self.task_function, self.config,
                self.settings,
            )  # fmt: skip
        self.compositions.made.clear()
        return returned
