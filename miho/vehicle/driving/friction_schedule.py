"""Friction of a road that changes during a drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class FrictionSchedule:
    """Friction of a road over time, with linear changes between points.

    Parameters
    ----------
    time : tuple of float
        Times since the start of the drive [s], rising.
    friction : tuple of float
        Friction at each time, relative to the surface of the tire measurement [-]. Before the first
        time and after the last one it is constant.

    Raises
    ------
    ValueError
        If the numbers of times and frictions differ, the times do not rise, or a friction is not
        positive.

    Examples
    --------
    >>> from miho.vehicle.driving import FrictionSchedule
    >>> rain = FrictionSchedule.drop(at=12.0, share=0.3)
    >>> rain.at(11.9), round(rain.at(12.1), 3), rain.at(20.0)
    (1.0, 0.85, 0.7)
    """

    time: tuple[float, ...]
    friction: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", tuple(self.time))
        object.__setattr__(self, "friction", tuple(self.friction))
        time, friction = np.array(self.time, dtype=float), np.array(self.friction, dtype=float)
        if not time.size or time.size != friction.size:
            raise ValueError(
                f"friction has {friction.size} values for {time.size} times; expected as many"
            )
        if not (np.isfinite(time).all() and (np.diff(time) > 0).all()):
            raise ValueError(f"time is {self.time}; expected finite times that rise")
        if not (np.isfinite(friction).all() and (friction > 0).all()):
            raise ValueError(f"friction is {self.friction}; expected numbers above 0")

    @classmethod
    def drop(cls, at: float, share: float, within: float = 0.2) -> FrictionSchedule:
        """Return a friction of 1 that loses a share [-] from a time on, within a duration [s]."""
        return cls((at, at + within), (1.0, 1.0 - share))

    def at(self, time: float) -> float:
        """Return the friction at a time [s]."""
        return float(np.interp(time, self.time, self.friction))
