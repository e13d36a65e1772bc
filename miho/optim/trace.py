"""The error-over-time record of one run: a row for every improvement."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass
class Trace:
    """Columns of equal length, a row per improvement of the best loss.

    `evaluations` counts full evaluations up to and including the improving one; `seconds` and
    `cpu_seconds` are the method's own clock, without set-up and recording; `loss` decreases
    strictly; `theta` is in units.
    """

    evaluations: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    cpu_seconds: list[float] = field(default_factory=list)
    loss: list[float] = field(default_factory=list)
    theta: list[Array] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.loss)

    def add(
        self, evaluations: float, seconds: float, cpu_seconds: float, loss: float, theta: Array
    ) -> None:
        """Append one improvement."""
        self.evaluations.append(evaluations)
        self.seconds.append(seconds)
        self.cpu_seconds.append(cpu_seconds)
        self.loss.append(loss)
        self.theta.append(np.array(theta, dtype=float))
