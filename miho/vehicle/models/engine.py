"""Engine torque at one throttle opening: the cubic in the engine speed (Eq. 8)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, pi
from types import MappingProxyType
from typing import Any

import numpy as np

from miho.compiled.kernel import Formula
from miho.models.derived import Derived
from miho.models.expression import Expression
from miho.quantities import Array
from miho.vehicle.models.features import torque_features

RPM = pi / 30
"""One revolution per minute in rad/s."""


@dataclass(frozen=True)
class TorqueCubic(Expression):
    """Engine torque T [Nm] over the engine speed omega [rad/s] at one throttle opening (Eq. 8).

        T = p0 + p1 w + p2 w^2 + p3 w^3,   w = omega / omega_max

    The paper normalizes the speed by the largest engine speed, so all parameters are torques [Nm]
    of similar size. Engine braking is negative. A cubic cannot represent a turbo that spools up:
    fit it over speeds and throttles with a smooth curve, and store this range (`TorqueCurve`).

    Parameters
    ----------
    omega_max : float, optional
        Largest engine speed [rad/s], which the parameters refer to.
    """

    omega_max: float = 7000 * RPM

    inputs = MappingProxyType({"omega": "rad/s"})
    parameters = MappingProxyType({"p0": "Nm", "p1": "Nm", "p2": "Nm", "p3": "Nm"})
    output = "Nm"
    linear = ("p0", "p1", "p2", "p3")

    def __post_init__(self) -> None:
        if not 0 < self.omega_max < np.inf:
            raise ValueError(
                f"omega_max is {self.omega_max}; expected the engine's largest speed in rad/s, "
                "above 0"
            )

    @property
    def value(self) -> Formula:
        """Torque [Nm]."""
        omega_max = self.omega_max

        def torque(inputs: tuple[Any, ...], theta: tuple[Any, ...]) -> Any:
            w = inputs[0] / omega_max
            p0, p1, p2, p3 = theta
            return ((p3 * w + p2) * w + p1) * w + p0

        return torque

    @property
    def derivatives(self) -> Formula:
        """Powers 0 to 3 of the normalised speed: the torque is linear in (p0, ..., p3)."""
        omega_max = self.omega_max

        def powers(inputs: tuple[Any, ...], theta: tuple[Any, ...]) -> tuple[Any, ...]:
            w = inputs[0] / omega_max
            return w * 0 + 1, w, w * w, w * w * w

        return powers

    def derived_quantities(self, columns: Mapping[str, Array]) -> tuple[Derived, ...]:
        """Return the peak torque and its engine speed."""
        return torque_features(self, columns)


@dataclass(frozen=True)
class TorqueCurve:
    """A learned cubic at one throttle opening, valid in an interval of engine speeds.

    Parameters
    ----------
    parameters : tuple of float
        (p0, p1, p2, p3) [Nm] of `TorqueCubic`.
    omega_max : float
        Engine speed of the normalization [rad/s].
    throttle : float
        Opening from 0 (closed) to 1.
    valid : tuple of float
        Lowest and highest engine speed [rad/s] of the data. A cubic diverges outside of them.

    Raises
    ------
    ValueError
        If a value is out of range.
    """

    parameters: tuple[float, float, float, float]
    omega_max: float
    throttle: float
    valid: tuple[float, float]

    def __post_init__(self) -> None:
        if len(self.parameters) != 4 or not all(map(isfinite, self.parameters)):
            raise ValueError(f"parameters are {self.parameters}; expected four finite torques [Nm]")
        if not 0 <= self.throttle <= 1:
            raise ValueError(f"throttle is {self.throttle}; expected an opening from 0 to 1")
        low, high = self.valid
        if not 0 <= low < high < np.inf:
            raise ValueError(
                f"valid is ({low}, {high}); expected two engine speeds in rad/s, the lower first"
            )
        TorqueCubic(self.omega_max)

    def torque(self, omega: Array) -> Array:
        """Return the torque [Nm] at engine speeds [rad/s] of any shape.

        Raises ValueError for speeds outside the valid interval, where no data support the cubic.
        """
        omega = np.asarray(omega, dtype=float)
        low, high = self.valid
        outside = ~((low <= omega) & (omega <= high))
        if outside.any():
            raise ValueError(
                f"{np.count_nonzero(outside)} of {omega.size} engine speeds, for example "
                f"{omega[outside].flat[0]:.6g} rad/s, are outside the valid interval {low:.6g} to "
                f"{high:.6g} rad/s of the curve at {100 * self.throttle:g} % throttle; clip them "
                "or learn the curve from more speeds"
            )
        theta = np.array([self.parameters])
        T = TorqueCubic(self.omega_max).predict(theta, omega.ravel())[0]
        return np.asarray(T.reshape(omega.shape))
