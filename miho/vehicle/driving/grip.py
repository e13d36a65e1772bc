"""Largest forces of the tires over the load, for planning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from miho.quantities import Array
from miho.vehicle.models.axle import Axle, curve_model
from miho.vehicle.models.magic_formula import MagicFormula

SLIP = np.linspace(-0.35, 0.35, 1401)
"""Slip angles [rad] and slip ratios [-] of the search for peaks."""
LOADS = (0.4, 0.7, 1.0, 1.4, 1.9)
"""Loads relative to the nominal load, for the sensitivity of a tire."""


@dataclass(frozen=True, eq=False)
class Grip:
    """Largest forces of the four tires, (4,) each: front left, front right, rear left, rear right.

        peak(F_z) = mu (F_z / load) P (1 + q (F_z / load - 1))

    mu [-] is the performance factor. q, above -1 and at most 0, is 0 for the load ratio of Eq. 10,
    in which load transfer between equal tires has no effect. Forces to the left and to the right
    differ by the offsets of the tires.
    """

    load: Array  # nominal [N]
    left: Array  # P of the lateral force to the left, as in a left turn [N]
    right: Array  # P of the lateral force to the right [N]
    drive: Array  # P along the wheel [N]
    lateral_sensitivity: Array  # q [-]
    longitudinal_sensitivity: Array

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            values = np.array(getattr(self, name), dtype=float)
            if values.shape != (4,) or not np.isfinite(values).all():
                raise ValueError(f"{name} of the grip is {values}; expected 4 finite numbers")
            sensitivity = name.endswith("sensitivity")
            if not ((values <= 0) & (values > -1) if sensitivity else values > 0).all():
                expected = "above -1 and at most 0" if sensitivity else "above 0 N"
                raise ValueError(f"{name} of the grip is {values}; expected numbers {expected}")
            values.flags.writeable = False
            object.__setattr__(self, name, values)

    @classmethod
    def of_tires(
        cls, tires: Sequence[MagicFormula], loads: ArrayLike, inclination: ArrayLike = 0.0
    ) -> Grip:
        """Return the grip of full tires at nominal loads [N] and inclinations [rad], ISO-W.

        A line is fitted to the peaks divided by load between 0.4 and 1.9 nominal loads.
        """
        load = np.broadcast_to(np.asarray(loads, dtype=float), 4)
        lean = np.broadcast_to(np.asarray(inclination, dtype=float), 4)
        rows = []
        for tire, nominal, gamma in zip(tires, load, lean, strict=True):
            Fz = nominal * np.array(LOADS)[:, None]
            Fy = tire.forces(Fz, 0.0, SLIP, gamma).Fy
            Fx = tire.forces(Fz, SLIP, 0.0, gamma).Fx
            peaks = Fy.max(axis=1), -Fy.min(axis=1), np.minimum(Fx.max(axis=1), -Fx.min(axis=1))
            rows.append([_line(peak) for peak in peaks])
        lines = np.array(rows)
        P, q = lines[:, :, 0], np.minimum(lines[:, :, 1], 0.0)
        left, right, drive = P.T
        return cls(load, left, right, drive, q[:, :2].mean(axis=1), q[:, 2])

    @classmethod
    def of_axles(
        cls,
        front: Axle,
        rear: Axle,
        loads: ArrayLike,
        *,
        drive: float = 1.0,
        sensitivity: ArrayLike = 0.0,
    ) -> Grip:
        """Return the grip of identified curves (Eq. 4), each at its nominal load [N], (4,).

        drive is the ratio of the longitudinal to the lateral peak [-]. sensitivity is q of both
        directions [-], broadcast to (4,); curves at one load do not determine it.
        """
        curves = [front.left, front.right, rear.left, rear.right]
        Fy = np.array([curve_model(theta).predict(theta[None], SLIP)[0] for theta in curves])
        left, right = Fy.max(axis=1), -Fy.min(axis=1)
        q = np.broadcast_to(np.asarray(sensitivity, dtype=float), 4)
        load = np.broadcast_to(np.asarray(loads, dtype=float), 4)
        return cls(load, left, right, drive * np.minimum(left, right), q, q)


def _line(peaks: Array) -> Array:
    """Return P and q, (2,), fitted to peaks at `LOADS`: P (1 + q (x - 1)) = peak / x."""
    x = np.array(LOADS)
    slope, level = np.polyfit(x - 1, peaks / x, 1)
    return np.array([level, slope / level])
