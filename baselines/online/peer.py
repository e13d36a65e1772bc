"""The common part of all peers: rows, time, missing values and the state after an update."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from baselines.online.alarms import Detector, LevelAlarm
from baselines.online.setup import Setup, abreast, setup_of
from miho.online import OnlineMethod, Running, TrackerState
from miho.online.method import Problems, Rows
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification import Report


class PeerMethod(OnlineMethod):
    """Abstract base class of the settings of a peer."""

    @abstractmethod
    def run(self, setup: Setup) -> Peer:
        """Return a run that has seen no row."""

    @final
    def start(
        self,
        problem: Problems,
        prior: Report | Mapping[str, tuple[float, float]] | None = None,
        changes: Mapping[str, float] | None = None,
        input_noise: Mapping[str, float] | None = None,
        period: float = 0.02,
    ) -> Peer:
        """Return a run that has seen no row; see `OnlineMethod.start`."""
        return self.run(setup_of(problem, prior, changes, input_noise, period))

    @final
    def start_abreast(self, arguments: Sequence[Mapping[str, Any]]) -> Peer:
        """Return runs that advance in lockstep, from the arguments of `start` of each run.

        All runs have the model of the first one.
        """
        defaults = {"prior": None, "changes": None, "input_noise": None, "period": 0.02}
        return self.run(abreast([setup_of(**{**defaults, **own}) for own in arguments]))


class Peer(Running):
    """Abstract base class of S runs of a peer in lockstep; `start` gives a single one.

    Parameters
    ----------
    setup : Setup
        The task of the runs.
    detector : Detector, optional
        The alarm; by default a change of the level.
    skips_repeats : bool, optional
        Whether an output that repeats exactly counts as missing.

    Attributes
    ----------
    theta : ndarray of shape (S, d)
        Estimates.
    covariance : ndarray of shape (S, d, d)
        Covariances of the estimates; NaN for a method without them.
    probability : ndarray of shape (S,)
        Probability of a change in the view of the method; NaN for a method without it.
    statistic : ndarray of shape (S,)
        The quantity that the detector compares with its threshold.
    x, y : ndarray of shape (S, p) and (S, m)
        The last row; an output that was not used is NaN.
    """

    def __init__(
        self, setup: Setup, detector: Detector | None = None, skips_repeats: bool = False
    ) -> None:
        self.setup = setup
        self.watch = (detector or LevelAlarm()).watch(setup)
        self.theta = setup.theta.copy()
        self.covariance = setup.covariance.copy()
        self.probability = np.full(len(setup.theta), np.nan)
        self.statistic = np.zeros(len(setup.theta))
        self.time = np.full(len(setup.theta), np.nan)
        self.count = 0
        self.x = setup.example
        self.y = np.full((len(setup.theta), len(setup.system.outputs)), np.nan)
        self._last = self.y
        self._skips_repeats = skips_repeats
        self._steps = None if setup.steps is None else setup.steps.anew()

    @abstractmethod
    def drift(self, seconds: Array) -> None:
        """Let time (S,) [s] pass since the last row."""

    @abstractmethod
    def learn(self, x: Array, y: Array) -> None:
        """Take a row of finite inputs (S, p) and of outputs (S, m), of which some may be NaN."""

    @final
    def advance(self, times: Array, x: Array, y: Array) -> NDArray[np.bool_]:
        """Take one row of each run, and return the runs that raise an alarm (S,).

        Times (S,) [s], inputs (S, p) and outputs (S, m) are NaN if they are missing.
        """
        period = self.setup.period
        first = self.count == 0
        now = np.where(np.isnan(times), 0.0 if first else self.time + period, times)
        self.drift(np.full(len(x), period) if first else np.maximum(now - self.time, 0.0))
        self.time = now
        whole = np.isfinite(x).all(axis=1, keepdims=True)
        repeats = (y == self._last) & self._skips_repeats
        self.x, self._last = np.where(whole, x, self.x), y
        self.y = np.where(whole & ~repeats, y, np.nan)
        self.learn(self.x, self.y)
        self.count += 1
        self.statistic = self.watch.statistic(self)
        return self.watch.judge(self, self.statistic)

    @final
    def update(self, rows: Rows) -> TrackerState:
        """Take one or several rows of a single run, and return the state after the last of them."""
        started = time.perf_counter()
        alarm = None
        if self._steps is not None:
            rows = self._steps.take(rows)
        for now, x, y in self.setup.rows(rows):
            if self.advance(np.array([now]), x[None], y[None])[0]:
                alarm = self.watch.alarm
        setup = self.setup
        return TrackerState(
            time=float(self.time[0]),
            names=setup.names,
            theta=self.theta[0],
            covariance=self.covariance[0],
            identifiable=np.ones(self.theta.shape[1], dtype=bool),
            alarm=alarm,
            rows=self.count,
            seconds=time.perf_counter() - started,
            bounds=(setup.low, setup.high),
        )
