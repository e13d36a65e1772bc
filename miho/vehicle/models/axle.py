"""Axles of the single-track model: two tires at one slip angle, and their cornering stiffness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from miho.quantities import Array
from miho.vehicle.models.tire import Pacejka, PacejkaCurvature

_MODELS = {len(model.parameters): model for model in (Pacejka(), PacejkaCurvature())}


@dataclass(frozen=True, eq=False)
class Axle:
    """The left and the right tire of an axle, which have the same slip angle.

    The sum of two curves is not itself a curve of `Pacejka`; a single curve that is identified
    from data of the axle approximates it closely.

    Parameters
    ----------
    left, right : array_like of shape (5,) or (6,)
        Parameters of `Pacejka` (B, C, D, Sx, Sy) or `PacejkaCurvature` (B, C, D, E, Sx, Sy), each
        at the load of its wheel. The two may have different models.

    Raises
    ------
    ValueError
        If parameters are not finite or have another shape.
    """

    left: Array
    right: Array

    def __post_init__(self) -> None:
        for side in ("left", "right"):
            theta = np.array(getattr(self, side), dtype=float)
            if theta.ndim != 1 or theta.size not in _MODELS or not np.isfinite(theta).all():
                raise ValueError(
                    f"{side} is {theta.tolist()}; expected the 5 finite parameters of Pacejka or "
                    "the 6 of PacejkaCurvature"
                )
            theta.flags.writeable = False
            object.__setattr__(self, side, theta)

    def force(self, alpha: ArrayLike) -> Array:
        """Return the lateral force of both tires [N] at slip angles [rad] of any shape, ISO-W."""
        slip = np.asarray(alpha, dtype=float)
        forces = (
            _MODELS[theta.size].predict(theta[None], slip.ravel())[0]
            for theta in (self.left, self.right)
        )
        return np.asarray(sum(forces)).reshape(slip.shape)

    @property
    def cornering_stiffness(self) -> float:
        """Cornering stiffness of the axle [N/rad], the sum of both tires at zero slip angle."""
        return float(cornering_stiffness(self.left) + cornering_stiffness(self.right))


def cornering_stiffness(theta: ArrayLike) -> Array:
    """Return the cornering stiffness -dFy/dalpha at alpha = 0.

        B C D cos(C arctan(w)) / (1 + w^2) (1 - E z^2 / (1 + z^2)),   z = B Sx,
                                                                      w = z - E (z - arctan(z))

    For E = 0 this is B C D cos(C arctan(B Sx)) / (1 + B^2 Sx^2). A controller that is linearized
    about straight driving needs this slope; Eq. 14 is the slope at alpha = Sx
    (`central_stiffness`).

    Parameters
    ----------
    theta : array_like of shape (..., 5) or (..., 6)
        Parameters of `Pacejka` or `PacejkaCurvature`.

    Returns
    -------
    ndarray of shape (...)
        Cornering stiffness [N/rad], positive for usual tires.

    Examples
    --------
    >>> float(cornering_stiffness([10.0, 1.5, 4000.0, 0.0, 0.0]))
    60000.0
    """
    B, C, D, E, Sx = _curve(theta)
    z = B * Sx
    w = z - E * (z - np.arctan(z))
    slope = B * C * D * np.cos(C * np.arctan(w)) / (1 + w * w)
    return np.asarray(slope * (1 - E * z * z / (1 + z * z)))


def central_stiffness(theta: ArrayLike) -> Array:
    """Return the slope -dFy/dalpha at alpha = Sx, which is B C D (Eq. 14).

    The slope does not depend on E. For Sx = 0 it equals `cornering_stiffness`.

    Parameters
    ----------
    theta : array_like of shape (..., 5) or (..., 6)
        Parameters of `Pacejka` or `PacejkaCurvature`.

    Returns
    -------
    ndarray of shape (...)
        Slope [N/rad].
    """
    B, C, D, _, _ = _curve(theta)
    return np.asarray(B * C * D)


def curve_model(theta: ArrayLike) -> Pacejka | PacejkaCurvature:
    """Return the model of parameters (..., 5) or (..., 6); raises ValueError for other shapes."""
    values = np.asarray(theta, dtype=float)
    size = values.shape[-1] if values.ndim else 0
    if size not in _MODELS:
        raise ValueError(
            f"theta has shape {values.shape}; expected (..., 5) for Pacejka or (..., 6) for "
            "PacejkaCurvature"
        )
    return _MODELS[size]


def _curve(theta: ArrayLike) -> tuple[Array, Array, Array, Array, Array]:
    """Return B, C, D, E and Sx; E is 0 for `Pacejka`."""
    columns = np.moveaxis(np.asarray(theta, dtype=float), -1, 0)
    parameters = dict(zip(curve_model(theta).parameters, columns, strict=True))
    B, C, D, Sx = (parameters[name] for name in ("B", "C", "D", "Sx"))
    return B, C, D, parameters.get("E", np.zeros_like(B)), Sx
