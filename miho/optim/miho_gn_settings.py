"""The settings of Hyperband over Gauss-Newton steps."""

from __future__ import annotations

from dataclasses import dataclass

from miho.compiled.gauss_newton_candidates import GNSettings
from miho.optim.brackets import DRAWS, check_brackets
from miho.validate import one_of, positive_settings, whole, whole_settings

ROOM = 1 << 22
"""Numbers that the derivatives of a rung may hold; beyond, each step pays for its own, and for
the residuals again if these come from Python."""


@dataclass(frozen=True)
class MIHOGNSettings:
    """The brackets of `MIHOGN`, whether one goes after the other or several go at a time.

    A bracket looks at configurations on the first rows of the data, `rows` for each parameter, and
    keeps the best. Each rung gives its candidates `steps` Levenberg-Marquardt steps, the best of
    them up to `lead`, and hands the best one in `eta` on to the next, with `eta` times as many
    rows, until the last candidate goes to its end on all rows. A level that would have more than
    the share `jump` of all rows has all of them; so has one after more than `enough` rows for each
    parameter, and so have all levels of a problem that cannot be evaluated on fewer. A rung costs
    about `base` (d + 1) evaluations times Luby's sequence, at most `largest` (d + 1); a bracket
    begins with `least` to `most` configurations.

    Steps are damped by `damping` at first, relative to a scale of each parameter, and no longer
    than `reach` of the widths. In every second bracket a scale never falls, which large residuals
    need; in the others by no more than the factor `fading` from step to step. A descent is
    done where its linear model predicts a gain below the share `tolerance` of the loss; on m rows,
    fewer than all, below `level_tolerance` d / m, which so few do not tell from noise. Up to
    `secants` steps running update the derivatives (Broyden) instead of evaluating them. One bracket
    in `projecting` (0: none) solves for the linear parameters at each look (variable projection).
    `draws` is the distribution of starts, see `draw_starts`. A descent that gains less than the
    share `progress` of its loss in `patience` (d + 1) evaluations is set aside; the best of those
    may spend as much as the next bracket has. A descent that comes to a known minimum ends.

    The search ends when the ends of its brackets are evidence enough (`miho.optim.evidence`).
    Searches get stuck at bounds, where the data leave a parameter undetermined, and where the loss
    is more than noise explains: such an optimum needs the ends of `doubtful` brackets, three
    quarters of those whose loss is known, and a search `longer` times as long as it took to find
    it. Half as many ends do where only its residuals have structure (`miho.optim.structure`), and
    twice as many are needed where it may be a plateau. Before the search ends, `challenges`
    brackets have to fail that start at some of the best minimum's coordinates. Where the loss of a
    minimum is zero to rounding (`miho.optim.zero`), one bracket is enough. After `brackets`
    brackets the search ends in any case, as `Outcome.BRACKETS`. At last it descends from the run's
    best to a tolerance of `digits`. A problem that is linear in all parameters is solved.
    """

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
        """The settings by which brackets go on, before the first."""
        return GNSettings(
            self.eta, self.steps, self.lead, float(self.reach), self.secants, float(self.tolerance),
            float(self.level_tolerance), float(self.digits), float(self.patience),
            float(self.progress), rounding, slope_cost, compiled, projects=False, solved=solved,
            rung_budget=0.0, allowance=0, room=ROOM,
        )  # fmt: skip
