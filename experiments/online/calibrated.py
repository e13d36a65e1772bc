"""Alarms of peers in a comparison, calibrated on streams without a change on other seeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

from baselines.online import bicycle, tire
from baselines.online.alarms import Watch
from baselines.online.peer import Peer
from experiments.benchmarks.online_methods import CONTENDERS, detectors
from experiments.benchmarks.online_scores import Family, thresholds
from miho.online import OnlineMethod, Running, TrackerState
from miho.online.method import Rows

FAMILIES: Mapping[str, Family] = {
    "baselines.online.tire": tire,
    "baselines.online.bicycle": bicycle,
}
"""Streams on which alarms are calibrated, by their targets."""
CONTENDER = {"miho": "tracker", "batch": "batch_ls", "lm_window": "lm"}
"""Names in the benchmark of the options of `tracker` that have another name there."""


@dataclass
class Watched(Running):
    """A peer with a calibrated alarm.

    Parameters
    ----------
    peer : Peer
        The run.
    watch : Watch
        Its alarm.
    """

    peer: Peer
    watch: Watch

    def update(self, rows: Rows) -> TrackerState:
        """Take one row, and return the state after it."""
        state = self.peer.update(rows)
        [fired] = self.watch.judge(self.peer, self.watch.statistic(self.peer))
        return replace(state, alarm=self.watch.alarm if fired else None)


def watched(running: Running, name: str, method: OnlineMethod, family: str) -> Running:
    """Return a run of a peer with its quickest calibrated alarm; another run as it is."""
    contender = CONTENDER.get(name, name)
    if not isinstance(running, Peer) or contender not in CONTENDERS or family not in FAMILIES:
        return running
    limits, best = _calibration(contender, method, FAMILIES[family])
    return Watched(running, detectors((best,), limits)[best].watch(running.setup))


@lru_cache
def _calibration(
    contender: str, method: OnlineMethod, family: Family
) -> tuple[Mapping[str, float], str]:
    return thresholds(CONTENDERS[contender], method, family)
