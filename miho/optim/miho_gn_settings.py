"""Settings of Hyperband over Gauss-Newton steps."""

from __future__ import annotations

from dataclasses import dataclass

from miho.compiled.gauss_newton_candidates import GNSettings
from miho.optim.brackets import DRAWS, check_brackets
from miho.validate import one_of, positive_settings, whole, whole_settings

ROOM = 1 << 22
"""Largest number of stored derivatives of a rung. Beyond it each step evaluates its derivatives
again, and the residuals too if they come from Python."""


@dataclass(frozen=True)
class MIHOGNSettings:
    """Settings of `MIHOGN` and `AsynchronousMIHOGN`; see `MIHOGN`."""

    eta: int = 3
    rows: float = 4.0
    jump: float = 0.5
    enough: float = 200.0
    base: float = 0.5
    largest: float = 32.0
    least: int = 3
    most: int = 243
    steps: int = 3
    lead: int = 20
    damping: float = 0.1
    fading: float = 0.3
    reach: float = 0.25
    secants: int = 4
    projecting: int = 2
    draws: str = "turns"
    tolerance: float = 1e-8
    level_tolerance: float = 0.1
    digits: float = 1e-16
    patience: float = 4.0
    progress: float = 0.05
    doubtful: int = 20
    longer: float = 10.0
    challenges: int = 3
    brackets: int = 200

    def __post_init__(self) -> None:
        check_brackets(self)
        whole("doubtful", self.doubtful, 1)
        whole_settings(self, ("secants", "projecting"), 0)
        whole("challenges", self.challenges, 1)
        one_of("draws", self.draws, DRAWS)
        positive_settings(self, ("damping", "fading", "reach", "digits", "longer"))
        if self.fading > 1:
            raise ValueError(f"fading is {self.fading:g}; expected at most 1")

    def block_settings(
        self, rounding: float, slope_cost: int, compiled: bool, solved: bool = False
    ) -> GNSettings:
        """Settings of the machine before the first bracket."""
        return GNSettings(
            self.eta, self.steps, self.lead, float(self.reach), self.secants, float(self.tolerance),
            float(self.level_tolerance), float(self.digits), float(self.patience),
            float(self.progress), rounding, slope_cost, compiled, projects=False, solved=solved,
            rung_budget=0.0, allowance=0, room=ROOM,
        )  # fmt: skip
