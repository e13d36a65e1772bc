"""Peers of MIHO's tracker, and streams with known truth for all of them."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from baselines.online.alarms import ChangePointAlarm, LevelAlarm, ModeAlarm
    from baselines.online.bank import Bank
    from baselines.online.bicycle import bicycle
    from baselines.online.extended_kalman import ExtendedKalman, change_point_filter
    from baselines.online.interacting_models import InteractingModels
    from baselines.online.longitudinal import longitudinal
    from baselines.online.particles import Particles
    from baselines.online.recursive_least_squares import RecursiveLeastSquares
    from baselines.online.streams import Stream, tire
    from baselines.online.unscented_kalman import UnscentedKalman
    from baselines.online.windowed_least_squares import WindowedLeastSquares

__all__ = [
    "Bank", "ChangePointAlarm", "ExtendedKalman", "InteractingModels", "LevelAlarm", "ModeAlarm",
    "Particles", "RecursiveLeastSquares", "Stream", "UnscentedKalman", "WindowedLeastSquares",
    "bicycle", "change_point_filter", "longitudinal", "tire",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
