"""The time limit of a report, and the time that a refit takes."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from miho.identification.curve_fit import CurveFit
from miho.identification.refit import OutOfTimeError
from miho.quantities import Array

FEW = 5
"""Smallest number of evaluations of a refit."""


@dataclass
class Deadline:
    """The time limit of a report, in seconds of `time.perf_counter`."""

    at: float = math.inf

    def check(self) -> None:
        """Raise OutOfTimeError if the time is over."""
        if self.over:
            raise OutOfTimeError

    @property
    def over(self) -> bool:
        """Whether the time is over."""
        return time.perf_counter() > self.at

    def __getstate__(self) -> float:
        """The seconds left, because other machines have other clocks."""
        return self.at - time.perf_counter()

    def __setstate__(self, left: float) -> None:
        self.at = time.perf_counter() + left


def seconds_of_refit(problem: CurveFit, theta: Array) -> float:
    """Smallest duration of a refit in seconds, from the duration of one evaluation."""
    started = time.perf_counter()
    problem.residuals(theta)
    return FEW * (time.perf_counter() - started)
