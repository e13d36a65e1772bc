"""The methods of the comparison of online methods: settings in use, and the ones that are tried.

`python -m experiments.benchmarks.online --tune` tries the same number of settings of each peer on
the tuning seeds; CHOSEN are its results, which are in `conf/tracker` too.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from baselines.online import (
    Bank,
    ChangePointAlarm,
    ExtendedKalman,
    InteractingModels,
    LevelAlarm,
    ModeAlarm,
    Particles,
    RecursiveLeastSquares,
    UnscentedKalman,
    WindowedLeastSquares,
    change_point_filter,
)
from baselines.online.alarms import Detector
from miho.online import OnlineMethod, TrackerSettings

TRIED = 12
"""Number of settings that each peer may try."""
LEVEL, MODE, POINTS = "level", "mode", "change points"
ROBUST_POINTS = "robust points"


@dataclass(frozen=True)
class Contender:
    """A method of the comparison.

    Parameters
    ----------
    build : callable
        The method from its settings.
    chosen : mapping
        The settings in use.
    grid : mapping of str to tuple
        The values of each setting that `--tune` tries.
    detectors : tuple of str
        Its possible alarms.
    share : float
        Share of the seeds and hours of the quick methods.
    abreast : int
        Largest number of streams in lockstep.
    """

    build: Callable[..., OnlineMethod]
    chosen: Mapping[str, Any]
    grid: Mapping[str, tuple[Any, ...]]
    detectors: tuple[str, ...] = (LEVEL, POINTS)
    share: float = 1.0
    abreast: int = 60

    def method(self) -> OnlineMethod:
        """Return the method with the settings in use."""
        return self.build(**self.chosen)

    def trials(self) -> list[dict[str, Any]]:
        """Return all settings of the grid."""
        return [dict(zip(self.grid, each, strict=True)) for each in product(*self.grid.values())]


def models(quiet: float, quick: float, drift_of_others: float, guards: bool) -> InteractingModels:
    """Return two interacting models."""
    return InteractingModels((quiet, quick), drift_of_others, guards=guards)


def windowed(rows: int, huber: float, iterations: int) -> WindowedLeastSquares:
    """Return least squares on a window."""
    return WindowedLeastSquares(rows, iterations, huber)


def batch(huber: float) -> WindowedLeastSquares:
    """Return least squares on all rows, once a second."""
    return WindowedLeastSquares(None, 20, huber, every=50)


def robust_reset(drift: float, drift_of_others: float) -> InteractingModels:
    """Return an extended Kalman filter with the tracker's guards that change points reset."""
    alarm = ChangePointAlarm(3.0, hold=1.5, outliers=0.02)
    return InteractingModels((drift,), drift_of_others, guards=True, resets=True, detector=alarm)


WALK = {"drift": (0.003, 0.01, 0.03, 0.1), "drift_of_others": (0.01, 0.03, 0.1)}
MODES = {"quiet": (0.001, 0.003), "quick": (0.1, 0.3, 1.0), "drift_of_others": (0.01, 0.03)}
LENGTHS = {"rows": (10, 20, 35, 50, 100, 200), "huber": (1.5, 2.5)}

CONTENDERS: dict[str, Contender] = {
    "tracker": Contender(TrackerSettings, {}, {}, ("own",)),
    "imm_robust": Contender(
        models,
        {"quiet": 0.001, "quick": 0.3, "drift_of_others": 0.01, "guards": True},
        {**MODES, "guards": (True,)},
        (LEVEL, MODE, ROBUST_POINTS),
    ),
    "imm": Contender(
        models,
        {"quiet": 0.001, "quick": 0.1, "drift_of_others": 0.01, "guards": False},
        {**MODES, "guards": (False,)},
        (LEVEL, MODE, POINTS),
    ),
    "ekf_robust_reset": Contender(
        robust_reset,
        {"drift": 0.01, "drift_of_others": 0.1},
        {"drift": (0.001, 0.003, 0.01, 0.03), "drift_of_others": (0.01, 0.03, 0.1)},
        (LEVEL, ROBUST_POINTS),
    ),
    "ekf_reset": Contender(
        change_point_filter, {"drift": 0.01, "drift_of_others": 0.01},
        {"drift": (0.001, 0.003, 0.01, 0.03), "drift_of_others": (0.01, 0.03, 0.1)},
    ),
    "ekf": Contender(ExtendedKalman, {"drift": 0.01, "drift_of_others": 0.01}, WALK),
    "ukf": Contender(UnscentedKalman, {"drift": 0.01, "drift_of_others": 0.01}, WALK),
    "rls": Contender(
        RecursiveLeastSquares,
        {"forgetting": 0.99, "reach": 10.0},
        {"forgetting": (0.95, 0.97, 0.98, 0.99, 0.995, 0.999), "reach": (0.4, 10.0)},
    ),
    "lm_1": Contender(
        windowed, {"rows": 50, "huber": 1.5, "iterations": 1}, {**LENGTHS, "iterations": (1,)},
        share=0.5,
    ),
    "lm": Contender(
        windowed, {"rows": 100, "huber": 1.5, "iterations": 20}, {**LENGTHS, "iterations": (20,)},
        share=0.2, abreast=5,
    ),
    "batch_ls": Contender(
        batch, {"huber": 2.5},
        {"huber": (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0, 4.0, 100.0)},
        share=0.5, abreast=5,
    ),
    "particles": Contender(
        Particles, {"drift": 0.03, "drift_of_others": 0.1},
        {"drift": (0.01, 0.03, 0.1, 0.3), "drift_of_others": (0.01, 0.03, 0.1)},
        share=0.1, abreast=1,
    ),
    "bank": Contender(
        Bank, {"rows": 150}, {"rows": (5, 10, 15, 20, 30, 40, 50, 75, 100, 150, 200, 300)},
        (LEVEL,), share=0.1, abreast=1,
    ),
}  # fmt: skip


def detectors(names: tuple[str, ...], thresholds: Mapping[str, float]) -> dict[str, Detector]:
    """Return detectors by name, with infinite thresholds if none are given."""
    known: dict[str, Detector] = {
        LEVEL: LevelAlarm(),
        MODE: ModeAlarm(),
        POINTS: ChangePointAlarm(),
        ROBUST_POINTS: ChangePointAlarm(outliers=0.02),
    }
    return {
        name: replace(known[name], threshold=thresholds.get(name, float("inf")))
        for name in names
        if name in known
    }
