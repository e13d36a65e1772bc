"""Settings of Hyperband over Gauss-Newton steps."""

from __future__ import annotations

from dataclasses import dataclass

from miho.compiled.gauss_newton_candidates import GNSettings
from miho.optim.brackets import DRAWS, Brackets, check_brackets
from miho.validate import one_of, positive_settings, whole, whole_settings

ROOM = 1 << 22
"""Largest number of stored derivatives of a rung. Beyond it each step evaluates its derivatives
again, and the residuals too if they come from Python."""


@dataclass(frozen=True)
class MIHOGNSettings(Brackets):
    """Settings of `MIHOGN` and `AsynchronousMIHOGN`; see `MIHOGN`."""

    damping: float = 0.1
    scale_decay: float = 0.3
    max_secants: int = 4
    projection_period: int = 2
    draws: str = "turns"
    final_tolerance: float = 1e-16
    doubtful_brackets: int = 20
    doubtful_cost: float = 10.0
    challenges: int = 3

    def __post_init__(self) -> None:
        check_brackets(self)
        whole("doubtful_brackets", self.doubtful_brackets, 1)
        whole_settings(self, ("max_secants", "projection_period"), 0)
        whole("challenges", self.challenges, 1)
        one_of("draws", self.draws, DRAWS)
        positive_settings(self, ("damping", "scale_decay", "final_tolerance", "doubtful_cost"))
        if self.scale_decay > 1:
            raise ValueError(f"scale_decay is {self.scale_decay:g}; expected at most 1")

    def block_settings(
        self, rounding: float, slope_cost: int, compiled: bool, solved: bool = False
    ) -> GNSettings:
        """Settings of the machine before the first bracket."""
        return GNSettings(
            self.eta, self.steps_per_rung, self.leader_steps, float(self.max_step),
            self.max_secants, float(self.tolerance), float(self.level_tolerance),
            float(self.final_tolerance), float(self.patience),
            float(self.min_progress), rounding, slope_cost, compiled, projects=False, solved=solved,
            rung_budget=0.0, allowance=0, room=ROOM,
        )  # fmt: skip
