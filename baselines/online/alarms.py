"""Alarms of the peers: level of a parameter, mode probability, and Bayesian change points."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from miho.online import Alarm
from miho.quantities import Array
from miho.validate import number_or_infinity

if TYPE_CHECKING:
    from baselines.online.peer import Peer
    from baselines.online.setup import Setup

SETTLE = 10.0
"""Time after the start without an alarm [s]."""
WIDER = 20.0
"""Standard deviation of outliers, in standard deviations of the noise."""
MEMORY = 20.0
"""Time constant of the slow mean of a parameter [s]."""


@dataclass(frozen=True)
class Detector(ABC):
    """Abstract base class of an alarm's settings.

    Parameters
    ----------
    threshold : float, optional
        Evidence that raises an alarm.
    hold : float, optional
        Time after an alarm without another one [s], so that one change raises one alarm.
    """

    threshold: float = math.inf
    hold: float = 10.0

    def __post_init__(self) -> None:
        number_or_infinity("threshold", self.threshold)

    @abstractmethod
    def watch(self, setup: Setup) -> Watch:
        """Return a watch that has seen no row."""


class Watch(ABC):
    """Abstract base class of the alarms of S runs, with the slow mean of each parameter.

    Parameters
    ----------
    setup : Setup
        The task of the runs.
    settings : Detector
        Threshold of the evidence, and time without another alarm.

    Attributes
    ----------
    means : ndarray of shape (S, d)
        Slow means of the estimates.
    fired : bool ndarray of shape (S,)
        The runs with an alarm at the last row.
    alarm : Alarm or None
        The latest alarm of the first run.
    """

    def __init__(self, setup: Setup, settings: Detector) -> None:
        self.setup = setup
        self.threshold, self.hold = settings.threshold, settings.hold
        self.means = setup.theta.copy()
        self.fired = np.zeros(len(setup.theta), dtype=bool)
        self.alarm: Alarm | None = None
        self._quiet = np.full(len(setup.theta), SETTLE)

    @abstractmethod
    def statistic(self, peer: Peer) -> Array:
        """Take the row that the peer has learnt, and return the evidence for a change (S,)."""

    @final
    def judge(self, peer: Peer, statistic: Array) -> NDArray[np.bool_]:
        """Return the runs (S,) whose evidence exceeds the threshold, not soon after an alarm."""
        period = self.setup.period
        self._quiet -= period
        fired = (statistic > self.threshold) & (self._quiet <= 0)
        if fired.any():
            self._quiet[fired] = self.hold
            if fired[0]:
                self.alarm = self._described(peer)
            self._restart(fired)
        self.means += (peer.theta - self.means) * (period / MEMORY)
        ended = np.abs(self._quiet) < period / 2
        self.means[ended] = peer.theta[ended]
        self.fired = fired
        return fired

    @abstractmethod
    def _restart(self, fired: NDArray[np.bool_]) -> None:
        """Begin again after an alarm of some runs."""

    def _described(self, peer: Peer) -> Alarm:
        """The alarm of the first run: its parameter that has moved most."""
        k = self.setup.watched
        moves = np.abs(peer.theta - self.means)[0, k] / self.setup.changes[0, k]
        most = int(k[np.argmax(moves)])
        error = float(np.sqrt(peer.covariance[0, most, most]))
        before, after = float(self.means[0, most]), float(peer.theta[0, most])
        return Alarm(float(peer.time[0]), self.setup.names[most], before, after, error)


@dataclass(frozen=True)
class LevelAlarm(Detector):
    """A watched parameter differs from its own slow mean by a share of its offline value.

    Parameters
    ----------
    threshold : float, optional
        Share that raises an alarm.
    hold : float, optional
        Time after an alarm without another one [s].
    """

    def watch(self, setup: Setup) -> Watch:
        """Return a watch that has seen no row."""
        return _LevelWatch(setup, self)


class _LevelWatch(Watch):
    def statistic(self, peer: Peer) -> Array:
        moves = np.abs(peer.theta - self.means) / self.setup.sizes
        return np.asarray(moves[:, self.setup.watched].max(axis=1))

    def _restart(self, fired: NDArray[np.bool_]) -> None:
        """The means start again when the alarm is possible again."""


@dataclass(frozen=True)
class ModeAlarm(Detector):
    """Log odds of the quick mode of interacting multiple models.

    Parameters
    ----------
    threshold : float, optional
        Log odds that raise an alarm.
    hold : float, optional
        Time after an alarm without another one [s].

    References
    ----------
    Blom and Bar-Shalom, IEEE Trans. Automatic Control 33 (1988), Eq. 12 (mode probabilities).
    """

    def watch(self, setup: Setup) -> Watch:
        """Return a watch that has seen no row."""
        return _ModeWatch(setup, self)


class _ModeWatch(Watch):
    def statistic(self, peer: Peer) -> Array:
        p = np.clip(peer.probability, 1e-300, 1 - 1e-16)
        return np.asarray(np.log(p / (1 - p)))

    def _restart(self, fired: NDArray[np.bool_]) -> None:
        """The filter itself falls back to its quiet mode."""


@dataclass(frozen=True)
class ChangePointAlarm(Detector):
    """Log odds of a change within the latest rows, by Bayesian online change point detection.

    The observations are the values of a watched parameter that explain each row alone: the
    estimate plus residual / derivative, with the variance noise / derivative^2. Their mean is
    constant between changes and has a normal prior: the estimate and the size of a jump.

    Parameters
    ----------
    threshold, hold : float, optional
        Log odds that raise an alarm, and time without another one [s].
    hazard : float, optional
        Probability of a change in a row.
    recent : int, optional
        A change within this number of rows counts.
    longest : int, optional
        Number of run lengths that are kept; the last one stands for all longer ones.
    outliers : float, optional
        Share of observations with 20 times the standard deviation. The source has none.

    References
    ----------
    Adams and MacKay, Bayesian online changepoint detection (2007), Algorithm 1.
    """

    hazard: float = 1e-3
    recent: int = 25
    longest: int = 60
    outliers: float = 0.0

    def watch(self, setup: Setup) -> Watch:
        """Return a watch that has seen no row."""
        return _ChangePointWatch(setup, self)


class _ChangePointWatch(Watch):
    """Runs of 0 to longest - 1 informative rows, of each watched parameter of each run."""

    def __init__(self, setup: Setup, settings: ChangePointAlarm) -> None:
        super().__init__(setup, settings)
        self.settings = settings
        k = setup.watched
        self.start = setup.theta[:, k], setup.changes[:, k] ** 2
        shape = (*self.start[0].shape, settings.longest)
        self.shares = np.zeros(shape)
        self.shares[..., -1] = 1.0
        self.centres = np.broadcast_to(setup.theta[:, k, None], shape).copy()
        self.variances = np.broadcast_to(setup.deviations[:, k, None] ** 2, shape).copy()

    def _restart(self, fired: NDArray[np.bool_]) -> None:
        """The likeliest of the recent runs becomes the only one."""
        best = np.argmax(self.shares[..., : self.settings.recent], axis=-1)[..., None]
        for values in (self.centres, self.variances):
            values[fired, :, -1:] = np.take_along_axis(values, best, -1)[fired]
        self.shares[fired, :, :-1], self.shares[fired, :, -1] = 0.0, 1.0

    def statistic(self, peer: Peer) -> Array:
        f, J, r = self.setup.predicted(peer.theta, peer.x)
        k = self.setup.watched
        seen = np.isfinite(peer.y)
        weighted = J[..., k] * (seen / r)[..., None]  # (S, m, watched)
        information = np.sum(weighted * J[..., k], axis=1)
        informs = information * self.start[1] >= 1  # a row that says less than the prior is skipped
        residuals = np.where(seen, peer.y - f, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            values = peer.theta[:, k] + np.sum(weighted * residuals[..., None], 1) / information
            self._observe(informs, values[..., None], 1 / information[..., None])
        recent = self.shares[..., : self.settings.recent].sum(axis=-1)
        odds = np.log(np.maximum(recent, 1e-300) / np.maximum(1 - recent, 1e-16))
        return np.asarray(odds.max(axis=1))

    def _observe(self, informs: NDArray[np.bool_], value: Array, variance: Array) -> None:
        """Lines 3 to 8 of the algorithm, for one value of each parameter that the row informs."""
        total = self.variances + variance
        square = (value - self.centres) ** 2
        likelihood, trust = -0.5 * (square / total + np.log(total)), 1.0
        if self.settings.outliers:
            wide = total + WIDER**2 * variance
            inlier = np.log(1 - self.settings.outliers) + likelihood
            outlier = np.log(self.settings.outliers) - 0.5 * (square / wide + np.log(wide))
            likelihood = np.logaddexp(inlier, outlier)
            trust = np.maximum(np.exp(inlier - likelihood), 1e-6)
        predictive = np.log(np.maximum(self.shares, 1e-300)) + likelihood
        shares = np.exp(predictive - predictive.max(axis=-1, keepdims=True))
        shares /= shares.sum(axis=-1, keepdims=True)
        gain = trust * self.variances / total
        hazard = np.full(shares.shape[:-1], self.settings.hazard)
        grown = _longer(hazard, (1 - self.settings.hazard) * shares)
        centres = _longer(self.start[0], self.centres + gain * (value - self.centres), shares)
        variances = _longer(self.start[1], self.variances * (1 - gain), shares)
        self.shares = np.where(informs[..., None], grown, self.shares)
        self.centres = np.where(informs[..., None], centres, self.centres)
        self.variances = np.where(informs[..., None], variances, self.variances)


def _longer(first: Array, values: Array, shares: Array | None = None) -> Array:
    """Runs grow by a row: `first` is the new run's value; the two longest runs are added up.

    With shares, the two are averaged with these weights.
    """
    if shares is None:
        last = values[..., -2] + values[..., -1]
    else:
        both = shares[..., -2:]
        last = np.sum(both * values[..., -2:], -1) / np.maximum(both.sum(axis=-1), 1e-300)
        last = np.where(both.sum(axis=-1) > 0, last, values[..., -1])
    return np.concatenate([first[..., None], values[..., :-2], last[..., None]], axis=-1)
