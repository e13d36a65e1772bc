"""The settings of a tracker."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from miho.identification.report import Report
from miho.online.method import OnlineMethod, Problems
from miho.validate import at_least, between_0_and_1, number_or_infinity, positive, whole

if TYPE_CHECKING:
    from miho.online.tracker import Tracker

Prior = Report | Mapping[str, tuple[float, float]] | None


@dataclass(frozen=True)
class TrackerSettings(OnlineMethod):
    """Settings of a tracker.

    Drifts are standard deviations of a random walk over one second, in jumps of the parameter.

    Parameters
    ----------
    hazard : float, optional
        Probability of a fresh hypothesis of a jump.
    onset : float, optional
        Probability of a fresh hypothesis of a drift that begins without a jump. A larger value
        finds slow changes earlier, and settles later after jumps on which rows say little.
    outliers : float, optional
        Share of rows that are outliers.
    width : float, optional
        Variance of outliers, in variances of the noise.
    threshold : float, optional
        Logarithm of the odds of a change that raise the alarm.
    near : float, optional
        Smallest change that the alarm counts, in jumps.
    drifts : tuple of float, optional
        Drifts of hypotheses of long, middle and short memory.
    use : float, optional
        A row teaches a watched parameter if its information is at least this share of the best
        row's.
    smooth : float, optional
        Memory of the mean and variance of inputs with noise [s].
    hold : float, optional
        Time after an alarm before another one can follow [s].
    repeats : int, optional
        An output that repeats this number of times to the last digit is frozen.
    gap : float, optional
        Longest time between two rows that counts as drift [s].
    every : int, optional
        Number of rows from one fresh hypothesis to the next.
    slots : int, optional
        Number of hypotheses.
    cap : float, optional
        Drift widens a parameter up to this variance, in squared jumps.
    kept : int, optional
        Number of informative rows to keep, see `Tracker.dataset`.
    step_error : float, optional
        Standard deviation of the model's error in one step, relative to the noise of the state.
    burst : float, optional
        Further drift of the watched parameters in a fresh hypothesis, because a jump takes a while.
    settle : float, optional
        Time in which this further drift decays [s].
    wrong : float, optional
        Probability that the inputs of a row are wrong after a row with wrong inputs. One row
        multiplies the odds of a change by at most its reciprocal. With a smaller value the alarm is
        quicker, but fewer wrong rows in succession look like a change.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    hazard: float = 8e-4
    onset: float = 5e-5
    outliers: float = 0.02
    width: float = 400.0
    threshold: float = 3.0
    near: float = 1 / 7
    drifts: tuple[float, float, float] = (0.002, 0.15, 0.43)
    use: float = 0.27
    smooth: float = 2.0
    hold: float = 1.5
    repeats: int = 2
    gap: float = 10.0
    every: int = 3
    slots: int = 16
    cap: float = 0.75
    kept: int = 500
    step_error: float = 0.05
    burst: float = 2.0
    settle: float = 0.1
    wrong: float = 0.04

    def __post_init__(self) -> None:
        for name in ("hazard", "onset", "outliers", "wrong"):
            between_0_and_1(name, getattr(self, name))
        for name in ("width", "near", "use", "smooth", "gap", "cap", "settle"):
            positive(name, getattr(self, name))
        for name in ("hold", "step_error", "burst"):
            at_least(name, getattr(self, name), 0.0)
        number_or_infinity("threshold", self.threshold)
        whole("repeats", self.repeats, 1)
        whole("every", self.every, 1)
        whole("kept", self.kept, 1)
        whole("slots", self.slots, 4, 64)
        drifts = tuple(self.drifts)
        if len(drifts) != 3 or not all(0 <= drift < math.inf for drift in drifts):
            raise ValueError(f"drifts is {self.drifts!r}; expected three numbers of at least 0")
        object.__setattr__(self, "drifts", drifts)

    def start(
        self,
        problem: Problems,
        prior: Prior = None,
        changes: Mapping[str, float] | None = None,
        input_noise: Mapping[str, float] | None = None,
        period: float = 0.02,
    ) -> Tracker:
        """Return a tracker that has seen no row; see `Tracker`."""
        from miho.online.tracker import Tracker

        own = {field.name: getattr(self, field.name) for field in fields(self)}
        return Tracker(problem, prior, changes, input_noise, period, **own)


def settings_of(settings: Mapping[str, Any]) -> TrackerSettings:
    """The settings by name; ValueError for a name that is none of them."""
    known = [field.name for field in fields(TrackerSettings)]
    for name in settings:
        if name not in known:
            raise ValueError(f"Tracker: no setting {name!r}; expected one of {', '.join(known)}")
    return TrackerSettings(**settings)
