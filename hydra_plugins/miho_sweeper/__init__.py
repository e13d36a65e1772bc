"""Hydra's -m, made of runs that are done once: the sweeper of this project."""

from __future__ import annotations

from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from experiments.sweep_command import run_sweep


class MihoSweeper(Sweeper):
    """Skips what is done, does every run once and alone, and goes on whatever one of them does."""

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Called by Hydra before the sweep."""
        self._settings = hydra_context, task_function, config

    def sweep(self, arguments: list[str]) -> Any:
        """The runs of all combinations that the arguments give."""
        return run_sweep(arguments, *self._settings)


ConfigStore.instance().store(
    group="hydra/sweeper",
    name="miho",
    node={"_target_": "hydra_plugins.miho_sweeper.MihoSweeper"},
    provider="miho",
)
