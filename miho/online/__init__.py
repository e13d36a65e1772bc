"""Tracking: parameters that change while data arrive, with intervals and an alarm."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.online.method import OnlineMethod, Running
    from miho.online.motion import one_step
    from miho.online.settings import TrackerSettings
    from miho.online.state import Alarm, Mixture, TrackerState
    from miho.online.tracker import Tracker

__all__ = [
    "Alarm", "Mixture", "OnlineMethod", "Running", "Tracker", "TrackerSettings", "TrackerState",
    "one_step",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(
    __name__, {"Calibration": "intervals need no scale, and `threshold` sets the alarm's odds"}
)
