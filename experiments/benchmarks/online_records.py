"""Runs of online methods over streams: estimates, intervals and alarms in each row, and scores."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.online import Stream
from baselines.online.alarms import Detector
from baselines.online.peer import Peer, PeerMethod
from miho.online import OnlineMethod
from miho.quantities import Array

SETTLED = 10.0
"""Time at the start of a stream that no score counts [s]."""
STAYS = 50
"""Rows for which an estimate must stay within a tolerance."""
LATEST_ALARM, SPAN_OF_ALARMS = 3.0, 10.0
"""A change is missed without an alarm in the first time; alarms in the second belong to it [s]."""
DIGITS = 9
"""Digits of a delay after the point: a difference of two times is rounded."""
ORDINATE = 1.959964
"""Half width of a normal distribution's 95 % interval, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Record:
    """A method's run over a stream; W parameters are watched, N rows are recorded.

    Attributes
    ----------
    stream : Stream
        The stream.
    rows : ndarray of int, shape (N,)
        The recorded rows of the stream.
    theta, reach : ndarray, shape (N, W)
        Estimates, and half widths of their 95 % intervals (NaN without them).
    alarms : mapping of str to ndarray
        Times of the alarms by each detector, on the stream's true clock [s].
    peaks : mapping of str to float
        Largest evidence of a change after the first 10 s, by detector.
    """

    stream: Stream
    rows: NDArray[np.intp]
    theta: Array
    reach: Array
    alarms: Mapping[str, Array]
    peaks: Mapping[str, float]

    @property
    def clock(self) -> Array:
        """True times of the recorded rows [s]."""
        return self.stream.clock[self.rows]

    @property
    def start(self) -> float:
        """Time of the change [s]."""
        return self.stream.start or 0.0

    @property
    def truth(self) -> Array:
        """True values of the watched parameters (N, W)."""
        return np.stack([self.stream.truth[n][self.rows] for n in self.stream.changes], axis=1)

    def errors(self, start: float = SETTLED, end: float = np.inf) -> Array:
        """Relative errors in a span of time (n, W), in percent."""
        inside = (self.clock >= start - 1e-9) & (self.clock < end - 1e-9)
        return np.asarray(100 * np.abs(self.theta / self.truth - 1)[inside])

    def coverage(self, start: float = SETTLED, end: float = np.inf, scale: float = 1.0) -> float:
        """Share of the rows and parameters whose interval contains the truth."""
        inside = (self.clock >= start - 1e-9) & (self.clock < end - 1e-9)
        if np.isnan(self.reach).all():
            return float("nan")
        return float((np.abs(self.theta - self.truth) < scale * self.reach)[inside].mean())

    def delay(self, tolerance: float) -> float:
        """Time after the change from which all estimates stay within a tolerance for 1 s."""
        off = np.abs(self.theta / self.truth[-1] - 1)
        return round(self._stays(off < tolerance, self.start), DIGITS)

    def alarm_delay(self, detector: str) -> float:
        """Time from the change to the first alarm, infinite if it is missed."""
        after = self.alarms[detector] - self.start
        after = after[(after > -1e-9) & (after < LATEST_ALARM)]
        return round(float(after[0]), DIGITS) if after.size else np.inf

    def alarm_count(self, detector: str) -> int:
        """Number of alarms after the change."""
        after = self.alarms[detector] - self.start
        return int(np.count_nonzero((after > -1e-9) & (after < SPAN_OF_ALARMS)))

    def recovery(self, tolerance: float) -> float:
        """Time after the end of a fault from which all errors stay within percents for 1 s."""
        off = 100 * np.abs(self.theta / self.truth - 1)
        return self._stays(off < tolerance, self.stream.end or 0.0)

    def _stays(self, close: NDArray[np.bool_], since: float) -> float:
        """Time after `since` from which all columns of `close` (N, W) are true for 1 s."""
        runs = np.convolve(close.all(axis=1), np.ones(STAYS), "full")[STAYS - 1 :] > STAYS - 0.5
        later = np.flatnonzero(runs & (self.clock >= since - 1e-9))
        return float(self.clock[later[0]] - since) if later.size else np.inf


def arguments(stream: Stream) -> dict[str, Any]:
    """Return the arguments of `OnlineMethod.start` for a stream."""
    return {
        "problem": stream.problem if len(stream.problem) > 1 else stream.problem[0],
        "prior": stream.prior,
        "changes": stream.changes,
        "input_noise": stream.input_noise,
    }


def records(
    method: OnlineMethod,
    streams: Sequence[Stream],
    detectors: Mapping[str, Detector],
    abreast: int = 60,
    every: int = 1,
) -> list[Record]:
    """Return the run of a method over each stream.

    Peers advance over `abreast` streams of equal length in lockstep, with several detectors. Other
    methods get `every` rows in an update, and have the one detector "own".
    """
    if not isinstance(method, PeerMethod):
        return [_record(method, stream, every) for stream in streams]
    by_place: dict[int, Record] = {}
    for length in {len(stream) for stream in streams}:
        equal = [k for k, stream in enumerate(streams) if len(stream) == length]
        for first in range(0, len(equal), abreast):
            places = equal[first : first + abreast]
            each = _lockstep(method, [streams[k] for k in places], detectors)
            by_place |= zip(places, each, strict=True)
    return [by_place[k] for k in range(len(streams))]


def _lockstep(
    method: PeerMethod, streams: Sequence[Stream], detectors: Mapping[str, Detector]
) -> list[Record]:
    peer = method.start_abreast([arguments(stream) for stream in streams])
    watches = {name: detector.watch(peer.setup) for name, detector in detectors.items()}
    T, X, Y = _rows(peer, streams)
    N, S, k = len(T), len(streams), peer.setup.watched
    theta, variance = np.empty((N, S, k.size)), np.empty((N, S, k.size))
    fired = {name: np.zeros((N, S), dtype=bool) for name in watches}
    peaks = {name: np.full(S, -np.inf) for name in watches}
    for i in range(N):
        peer.advance(T[i], X[i], Y[i])
        theta[i], variance[i] = peer.theta[:, k], peer.covariance[:, k, k]
        for name, watch in watches.items():
            statistic = watch.statistic(peer)
            fired[name][i] = watch.judge(peer, statistic)
            if i >= SETTLED / peer.setup.period:
                peaks[name] = np.maximum(peaks[name], statistic)
    with np.errstate(invalid="ignore"):  # forgetting may lose the covariance
        reach = ORDINATE * np.sqrt(variance)
    return [
        Record(
            stream,
            np.arange(N),
            theta[:, s],
            reach[:, s],
            {name: stream.clock[fired[name][:, s]] for name in watches},
            {name: float(peaks[name][s]) for name in watches},
        )
        for s, stream in enumerate(streams)
    ]


def _rows(peer: Peer, streams: Sequence[Stream]) -> tuple[Array, Array, Array]:
    """Times (N, S), inputs (N, S, p) and outputs (N, S, m) of streams of equal length."""
    outputs = [output.column for output in peer.setup.system.outputs]
    T = np.stack([stream.columns["time"] for stream in streams], axis=1)
    X, Y = (
        np.stack([np.stack([stream.columns[n] for n in names], 1) for stream in streams], 1)
        for names in (peer.setup.columns, outputs)
    )
    return T, X, Y


def _record(method: OnlineMethod, stream: Stream, every: int) -> Record:
    run = method.start(**arguments(stream))
    rows: list[Any] = list(stream) if every == 1 else _pieces(stream, every)
    names = list(stream.changes)
    theta, reach = np.empty((len(rows), len(names))), np.empty((len(rows), len(names)))
    at = np.minimum(every * np.arange(1, len(rows) + 1), len(stream)) - 1
    alarms: list[float] = []
    peak, k = -np.inf, [0]
    for i, row in enumerate(rows):
        state = run.update(row)
        if i == 0:
            k = [state.names.index(name) for name in names]
        theta[i] = state.theta[k]
        ends = state.intervals()[k]
        reach[i] = np.max(np.abs(ends - state.theta[k][:, None]), axis=1)
        if state.alarm is not None and stream.clock[at[i]] >= SETTLED:
            alarms.append(float(stream.clock[at[i]]))
        if stream.clock[at[i]] >= SETTLED:
            peak = max(peak, state.odds)
    return Record(stream, at, theta, reach, {"own": np.array(alarms)}, {"own": peak})


def _pieces(stream: Stream, every: int) -> list[dict[str, Array]]:
    """The rows of a stream in pieces of `every` rows."""
    return [
        {name: column[i : i + every] for name, column in stream.columns.items()}
        for i in range(0, len(stream), every)
    ]


def seconds_of_row(method: OnlineMethod, stream: Stream, rows: int = 600) -> float:
    """Return the CPU time of an update by one row [s], the least of three pieces of the stream."""
    run = method.start(**arguments(stream))
    each = list(stream)
    best = np.inf
    for k in range(3):
        started = time.process_time()
        for row in each[k * rows : (k + 1) * rows]:
            run.update(row)
        best = min(best, (time.process_time() - started) / rows)
    return best
