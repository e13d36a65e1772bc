"""Discretized equations of CUTEst in the benchmark of Cartis and Roberts, for any length.

Boundary value problems, integral equations and reactors are from J. J. Moré, A collection of
nonlinear model problems, Lectures in Applied Mathematics 26 (1990) 723-762, with their names in
CUTEst. MGH is Moré, Garbow and Hillstrom (1981).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from baselines.problems.records import System, Values, all_at, counted, same

TURNING = 6.80812
"""Parameter of Bratu's equation on a coarse grid, next to the turning point, as in CUTEst."""
DAMKOEHLER, HEAT, ACTIVATION, COOLING = 0.135, 0.5, 25.0, 2.0
PECLET_MASS, PECLET_HEAT = 1.0, 5.0
"""Parameters of the reactor: D, B, GAMMA, BETA, PEM and PEH of CUTEst."""


def morebvne(x: Values, m: int, ahead: int = 0) -> Values:
    """MGH 28, boundary value: 2 x_i - x_i-1 - x_i+1 + h^2/2 (x_i + t + 1)^3, t = (i + ahead) h."""
    h = 1 / (len(x) + 1)
    padded, t = np.pad(x, ((1, 1), (0, 0))), h * (counted(len(x)) + ahead)
    return 2 * x - padded[:-2] - padded[2:] + h**2 / 2 * (x + t + 1) ** 3


def bdvalues(x: Values, m: int) -> Values:
    """`morebvne` with t of the next point, because CUTEst counts the left end as a point."""
    return morebvne(x, m, ahead=1)


def luksan21(x: Values, m: int) -> Values:
    """Modified boundary value, problem 21 of Luksan (1996): `morebvne` plus 1."""
    return morebvne(x, m) + 1


def integreq(x: Values, m: int) -> Values:
    """MGH 29, an integral equation: x_i + h/2 sum K(t_i, t_j) (x_j + t_j + 1)^3."""
    h = 1 / (len(x) + 1)
    t = h * counted(len(x))
    kernel = np.where(t >= t.T, (1 - t) * t.T, t * (1 - t.T))
    return x + h / 2 * kernel @ (x + t + 1) ** 3


def chandheq(x: Values, m: int) -> Values:
    """Chandrasekhar's H-equation: x_i - 1 - x_i / (2 n) sum t_i / (t_i + t_j) x_j, t_i = i/n."""
    t = counted(len(x)) / len(x)
    return x - 1 - x / (2 * len(x)) * ((t / (t + t.T)) @ x)


def _laplacian(u: Values, axes: int) -> Values:
    """Return the negative Laplacian of a grid (p, ..., k) along `axes` axes, with 0 outside."""
    total = 2.0 * axes * u
    for axis in range(axes):
        padded = np.pad(u, [(1, 1) if k == axis else (0, 0) for k in range(u.ndim)])
        for side in (slice(None, -2), slice(2, None)):
            total = total - padded[(slice(None),) * axis + (side,)]
    return total


def bratu(axes: int, weight: float, x: Values, m: int) -> Values:
    """Bratu's equation on the inner points of a square or a cube: -h^2 (Laplace u + w exp u)."""
    p = round(len(x) ** (1 / axes))
    u = x.reshape(*(p,) * axes, x.shape[1])
    return (_laplacian(u, axes) - weight / (p + 1) ** 2 * np.exp(u)).reshape(len(x), -1)


def cbratu2d(x: Values, m: int) -> Values:
    """Bratu's equation for a complex function on a square, w = 5: its real, then imaginary part."""
    p = round((len(x) / 2) ** 0.5)
    u, v = x.reshape(2, p, p, -1)
    c = 5 / (p + 1) ** 2
    real = _laplacian(u, 2) - c * np.exp(u) * np.cos(v)
    imaginary = _laplacian(v, 2) - c * np.exp(u) * np.sin(v)
    return np.concatenate([real.reshape(p * p, -1), imaginary.reshape(p * p, -1)])


def _transport(u: Values, peclet: float) -> Values:
    """u'' / Pe - u' at the inner points of an even grid on [0, 1], with the flow."""
    h = 1 / (len(u) - 1)
    return (u[:-2] - 2 * u[1:-1] + u[2:]) / (h**2 * peclet) - (u[1:-1] - u[:-2]) / h


def _ends(u: Values, peclet: float) -> tuple[Values, Values]:
    """CUTEst's conditions of inflow and of outflow."""
    h = 1 / (len(u) - 1)
    return h * peclet * (1 - u[1:2]) - u[:1], u[-1:] - u[-2:-1]


def chemrcta(x: Values, m: int) -> Values:
    """Tubular reactor: concentration u and temperature T, n/2 points each."""
    u, T = np.split(x, 2)
    rate = DAMKOEHLER * u[1:-1] * np.exp(ACTIVATION - ACTIVATION / T[1:-1])
    mass = _transport(u, PECLET_MASS) - rate
    heat = _transport(T, PECLET_HEAT) + COOLING * (1 - T[1:-1]) + HEAT * rate
    return np.concatenate([mass, heat, *_ends(u, PECLET_MASS), *_ends(T, PECLET_HEAT)])


def chemrctb(x: Values, m: int) -> Values:
    """The tubular reactor without cooling and with one Peclet number: temperature only."""
    T = x[1:-1]
    rate = DAMKOEHLER * (HEAT + 1 - T) * np.exp(ACTIVATION - ACTIVATION / T)
    return np.concatenate([_transport(x, PECLET_HEAT) + rate, *_ends(x, PECLET_HEAT)])


def _parabola(scale: float, n: int) -> Values:
    """t (t - 1) at the inner points of [0, 1], times a scale."""
    t = counted(n)[:, 0] / (n + 1)
    return scale * t * (t - 1)


SYSTEMS = {
    "bdvalues": System(bdvalues, partial(_parabola, 1000.0), same),
    "morebvne": System(morebvne, partial(_parabola, 1.0), same),
    "luksan21": System(luksan21, partial(_parabola, 1.0), same),
    "integreq": System(integreq, partial(_parabola, 1.0), same),
    "chandheq": System(chandheq, all_at(1.0), same, low=all_at(0.0)),
    "bratu2d": System(partial(bratu, 2, 4.0), all_at(0.0), same),
    "bratu2dt": System(partial(bratu, 2, TURNING), all_at(0.0), same),
    "bratu3d": System(partial(bratu, 3, TURNING), all_at(0.0), same),
    "cbratu2d": System(cbratu2d, all_at(0.0), same),
    "chemrcta": System(chemrcta, all_at(1.0), same, low=lambda n: np.repeat([0.0, 1e-6], n // 2)),
    "chemrctb": System(chemrctb, all_at(1.0), same, low=all_at(1e-6)),
}
