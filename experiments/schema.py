"""The typed root of every configuration: what it may hold, and of what type."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING


@dataclass
class ParameterConfig:
    """One parameter of the space; the fields of `miho.Parameter` without the name."""

    unit: str = MISSING
    low: float = MISSING
    high: float = MISSING
    scale: str = "linear"
    mean: float | None = None
    std: float | None = None
    sigma_max: float | None = None
    sigma_min: float = 0.0


@dataclass
class BudgetConfig:
    """The fields of `miho.Budget`, which Hydra could not fill because it is frozen."""

    evaluations: int | None = None
    seconds: float | None = None
    target: float | None = None


@dataclass
class ComparisonConfig:
    """Which methods to compare, how often, and what to write on the figure.

    `methods` maps an optimizer of conf/optimizer to settings that replace its own. Figure and
    tables go to `output`.
    """

    repetitions: int = 5
    methods: dict[str, dict[str, Any]] = field(default_factory=dict)
    note: str = ""
    output: str = "${root}/figures"


@dataclass
class Config:
    """One run, or with `comparison` a set of runs of the same problem."""

    model: dict[str, Any] = MISSING
    dataset: dict[str, Any] = MISSING
    space: dict[str, ParameterConfig] = MISSING
    loss: dict[str, Any] = MISSING
    optimizer: dict[str, Any] = MISSING
    budget: BudgetConfig = field(default_factory=BudgetConfig)
    seed: int = 0
    root: str = "runs/identify"
    comparison: ComparisonConfig = field(default_factory=ComparisonConfig)


def register() -> None:
    """Make the schema known to Hydra under the name `schema`."""
    ConfigStore.instance().store(name="schema", node=Config)
