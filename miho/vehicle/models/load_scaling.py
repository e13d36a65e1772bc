"""Transfer of a tire's curve to another load, by the similarity method.

Pacejka (Tire and Vehicle Dynamics, 2012, Sec. 4.2) transfers a curve F_y0 at the load F_z0 to
another load. The curve is stretched along both axes, so that peak and slope are correct:

    F_y(alpha) - x Sy = s_D (F_y0(alpha_0) - Sy),   alpha_0 - Sx = (s_K / s_D) (alpha - Sx)

    x = F_z / F_z0     s_D = x (1 + q_D (x - 1))     s_K = x / (1 - q_K (x^2 - 1) / 2)

The peak follows the linear friction of the Magic Formula (4.E23), and the stiffness its
sin(2 arctan(F_z / c)) (4.E25 with PKY4 = 2), where q_K = -2 F_z0^2 / (c^2 + F_z0^2).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from miho.quantities import Array
from miho.vehicle.models.axle import curve_model


class LoadSensitivity(NamedTuple):
    """Degressive dependence of a tire's force on its load: d ln(s / x) / d ln(x) at x = 1 [-].

    Both numbers are about -0.1 to -0.4 for racing tires, and 0 if forces are proportional to the
    load.

    Attributes
    ----------
    peak : float or ndarray
        q_D of the largest force, one number or one per tire.
    stiffness : float or ndarray
        q_K of the cornering stiffness.
    """

    peak: float | Array
    stiffness: float | Array

    def at_load(self, ratio: ArrayLike) -> LoadSensitivity:
        """Return the sensitivity of the tire at `ratio` times the load."""
        x = np.asarray(ratio, dtype=float)
        peak, stiffness = growth(x, self)
        return LoadSensitivity(self.peak * x * x / peak, self.stiffness * x * stiffness)


PROPORTIONAL = LoadSensitivity(0.0, 0.0)
"""Sensitivity of forces that are proportional to the load."""


def growth(ratio: ArrayLike, sensitivity: LoadSensitivity) -> tuple[Array, Array]:
    """Return s_D and s_K, the factors of peak and stiffness at `ratio` times the load [-].

    Raises ValueError if the ratio is negative, or so large that no friction is left by q_D.
    """
    x, q_D = np.asarray(ratio, dtype=float), np.asarray(sensitivity.peak, dtype=float)
    friction = 1 + q_D * (x - 1)
    if not ((x >= 0) & (friction > 0) & np.isfinite(x)).all():
        raise ValueError(
            f"ratio of the loads is from {np.min(x):g} to {np.max(x):g} with a sensitivity of the "
            f"peak of {np.min(q_D):g}; expected 0 or more, and friction above 0 at these loads"
        )
    stiffness = x / (1 - np.asarray(sensitivity.stiffness) * (x * x - 1) / 2)
    return np.asarray(x * friction), np.asarray(stiffness)


def at_load(theta: ArrayLike, ratio: ArrayLike, sensitivity: LoadSensitivity) -> Array:
    """Return the parameters of a tire's curve at another load.

    Parameters
    ----------
    theta : array_like of shape (..., 5) or (..., 6)
        Parameters of `Pacejka` or `PacejkaCurvature`.
    ratio : array_like of shape (...)
        Load divided by the load of theta [-], at least 0; broadcasts with theta.
    sensitivity : LoadSensitivity
        Load sensitivity of the tire at the load of theta.

    Returns
    -------
    ndarray of shape (..., 5) or (..., 6)
        Parameters with new D, B and Sy; C, E and Sx are unchanged.

    Raises
    ------
    ValueError
        If a ratio is negative, or so large that q_D leaves no friction.

    Examples
    --------
    >>> lighter = at_load([12.0, 1.6, 5000.0, 0.0, 100.0], 0.5, LoadSensitivity(-0.2, -0.3))
    >>> lighter.round(2).tolist()
    [12.29, 1.6, 2750.0, 0.0, 50.0]
    """
    x = np.asarray(ratio, dtype=float)
    peak, stiffness = growth(x, sensitivity)
    stretch = np.divide(stiffness, peak, where=peak > 0, out=np.ones_like(peak))
    names = list(curve_model(theta).parameters)
    factor = {"B": stretch, "D": peak, "Sy": x}
    columns = np.moveaxis(np.asarray(theta, dtype=float), -1, 0)
    scaled = [column * factor.get(name, 1.0) for name, column in zip(names, columns, strict=True)]
    return np.stack(np.broadcast_arrays(*scaled), axis=-1)


def load_sensitivity(
    theta: ArrayLike, alpha: ArrayLike, Fz: ArrayLike, Fy: ArrayLike, load: float
) -> LoadSensitivity:
    """Estimate the load sensitivity of a tire from the data of its curve.

    The two numbers are the least-squares solution of the similarity method to first order in the
    load. They describe the dependence of the residuals on the load.

    Parameters
    ----------
    theta : array_like of shape (5,) or (6,)
        Identified parameters of `Pacejka` or `PacejkaCurvature`.
    alpha, Fz, Fy : array_like of shape (n,)
        Slip angles [rad], wheel loads [N] and lateral forces [N] of the rows, ISO-W.
    load : float
        Load of theta [N], usually the middle of the loads of the rows.

    Returns
    -------
    LoadSensitivity
        Sensitivity at this load, as two numbers.

    Raises
    ------
    ValueError
        If all loads are equal.
    """
    model, values = curve_model(theta), np.asarray(theta, dtype=float)
    slip, off = np.asarray(alpha, dtype=float), np.asarray(Fz, dtype=float) / load - 1
    if np.ptp(off) == 0:
        raise ValueError(f"all loads are {load * (1 + off[0]):g} N; expected rows at several loads")
    names = list(model.parameters)
    Sx, Sy = values[names.index("Sx")], values[names.index("Sy")]
    force = model.predict(values[None], slip)[0]
    slope = -model.jacobian(values, slip)[:, names.index("Sx")]  # along alpha
    stretched = (slip - Sx) * slope
    columns = off[:, None] * np.stack([force - Sy - stretched, stretched], axis=1)
    left_over = np.asarray(Fy, dtype=float) - (1 + off) * force
    (q_D, q_K), *_ = np.linalg.lstsq(columns, left_over, rcond=None)
    return LoadSensitivity(float(q_D), float(q_K))
