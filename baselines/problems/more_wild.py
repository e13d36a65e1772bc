"""Systems of Moré and Wild (2009) that are not fits to data, for all lengths of the formulas.

The smooth problems of J. J. Moré and S. M. Wild, Benchmarking derivative-free optimization
algorithms, SIAM J. Optim. 20 (2009) 172-191, are 22 functions of CUTEr. Of these, 18 are from Moré,
Garbow and Hillstrom (1981, MGH). Six fit data and are in `mgh` and `nist`. No system declares
linear variables, because the benchmark gives methods residuals only.
"""

from __future__ import annotations

import numpy as np

from baselines.problems.records import System, Values, all_at, counted, same


def linear_full_rank(x: Values, m: int) -> Values:
    """MGH 32: x_i, or 0 for i > n, less 2/m sum x_j + 1."""
    padded = np.zeros((m, x.shape[1]), x.dtype)
    padded[: len(x)] = x
    return padded - (2 / m * x.sum(axis=0) + 1)


def linear_rank_1(x: Values, m: int) -> Values:
    """MGH 33: i sum j x_j - 1."""
    return counted(m) * (counted(len(x)) * x).sum(axis=0) - 1


def linear_rank_1_zeros(x: Values, m: int) -> Values:
    """MGH 34: (i - 1) sum j x_j - 1 without the first and last x_j, and -1 for i = m."""
    inner = (counted(len(x)) * x)[1:-1].sum(axis=0)
    return np.append(np.arange(m - 1.0), 0.0)[:, None] * inner - 1


def rosenbrock(x: Values, m: int) -> Values:
    """MGH 1: 10 (x_2 - x_1^2), 1 - x_1."""
    return np.stack([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def helical_valley(x: Values, m: int) -> Values:
    """MGH 7: 10 (x_3 - 10 theta), 10 (r - 1), x_3, with the angle theta in turns."""
    theta = np.arctan(x[1] / x[0]) / (2 * np.pi) + np.where(x[0].real < 0, 0.5, 0.0)
    radius = np.sqrt(x[0] ** 2 + x[1] ** 2)
    return np.stack([10 * (x[2] - 10 * theta), 10 * (radius - 1), x[2]])


def powell_singular(x: Values, m: int) -> Values:
    """MGH 13 and 22: of every four a, b, c, d: a + 10 b, 5^.5 (c - d), (b - 2 c)^2, ..."""
    a, b, c, d = (x[k::4] for k in range(4))
    rows = [a + 10 * b, 5**0.5 * (c - d), (b - 2 * c) ** 2, 10**0.5 * (a - d) ** 2]
    return np.concatenate(rows)


def freudenstein_roth(x: Values, m: int) -> Values:
    """MGH 2, and FREURONE as a chain of it: cubic curves in each pair of neighbours."""
    a, b = x[:-1], x[1:]
    return np.concatenate(
        [a + ((5 - b) * b - 2) * b - 13, a + ((b + 1) * b - 14) * b - 29]
    )  # fmt: skip


def watson(x: Values, m: int) -> Values:
    """MGH 20: of a polynomial p with coefficients x: p' - p^2 - 1 at i/29, and two conditions."""
    t = counted(29) / 29
    powers = t ** np.arange(len(x))
    slopes = np.arange(1.0, len(x)) * t ** np.arange(len(x) - 1)
    equation = slopes @ x[1:] - (powers @ x) ** 2 - 1
    return np.concatenate([equation, x[:1], x[1:2] - x[:1] ** 2 - 1])


def box_3d(x: Values, m: int) -> Values:
    """MGH 12: exp(-t x_1) - exp(-t x_2) - x_3 (exp(-t) - exp(-10 t)) at t = i/10."""
    t = counted(m) / 10
    return np.exp(-t * x[0]) - np.exp(-t * x[1]) - x[2] * (np.exp(-t) - np.exp(-10 * t))


def brown_dennis(x: Values, m: int) -> Values:
    """MGH 16: (x_1 + t x_2 - exp t)^2 + (x_3 + x_4 sin t - cos t)^2 at t = i/5."""
    t = counted(m) / 5
    return (x[0] + t * x[1] - np.exp(t)) ** 2 + (x[2] + x[3] * np.sin(t) - np.cos(t)) ** 2


def chebyquad(x: Values, m: int) -> Values:
    """MGH 35: means of Chebyshev's polynomials of degrees 1 to m, shifted to [0, 1], over x_j.

    They are less the integrals: 0 for an odd degree i, -1 / (i^2 - 1) for an even one.
    """
    before, now = np.ones_like(x), 2 * x - 1
    rows = []
    for degree in range(1, m + 1):
        integral = 0.0 if degree % 2 else -1 / (degree**2 - 1)
        rows.append(now.mean(axis=0) - integral)
        before, now = now, 2 * (2 * x - 1) * now - before
    return np.stack(rows)


def brown_almost_linear(x: Values, m: int) -> Values:
    """MGH 27, BROWNALE: x_i + sum x_j - (n + 1), and in the last row the product less 1."""
    return np.concatenate(
        [x[:-1] + x.sum(axis=0) - (len(x) + 1), x.prod(axis=0, keepdims=True) - 1]
    )


def bdqrtic(x: Values, m: int) -> Values:
    """3 - 4 x_i, and x_i^2 + 2 x_i+1^2 + 3 x_i+2^2 + 4 x_i+3^2 + 5 x_n^2."""
    squares, k = x**2, len(x) - 4
    weighted = sum((j + 1) * squares[j : j + k] for j in range(4))
    return np.concatenate([3 - 4 * x[:k], weighted + 5 * squares[-1]])


def cube(x: Values, m: int) -> Values:
    """x_1 - 1, 10 (x_i - x_i-1^3)."""
    return np.concatenate([x[:1] - 1, 10 * (x[1:] - x[:-1] ** 3)])


def mancino(x: Values, m: int) -> Values:
    """1400 x_i + (i - 50)^3 + sum v (sin^5 log v + cos^5 log v), v = (x_i^2 + i/j)^.5."""
    i = counted(len(x))
    v = np.sqrt(x[:, None] ** 2 + (i / i.T)[:, :, None])
    waves = v * (np.sin(np.log(v)) ** 5 + np.cos(np.log(v)) ** 5)
    return 1400 * x + (i - 50) ** 3 + waves.sum(axis=1)


def mancino_start(n: int) -> Values:
    """The published start: the residuals at 0, multiplied by -8.710996e-4."""
    zero = np.zeros((n, 1))
    return np.asarray(-8.710996e-4 * mancino(zero, n)[:, 0])


def heart_8(x: Values, m: int) -> Values:
    """Two dipoles of the heart: weights a, b and c, d, places t, u and v, w; moments up to 3."""
    a, b, c, d, t, u, v, w = x
    second_t, second_u = t**2 - v**2, u**2 - w**2
    third_t, third_u = t * (t**2 - 3 * v**2), u * (u**2 - 3 * w**2)
    third_v, third_w = v * (v**2 - 3 * t**2), w * (w**2 - 3 * u**2)
    return np.stack(
        [
            a + b + 0.69,
            c + d + 0.044,
            t * a + u * b - v * c - w * d + 1.57,
            v * a + w * b + t * c + u * d + 1.31,
            a * second_t - 2 * c * t * v + b * second_u - 2 * d * u * w + 2.65,
            c * second_t + 2 * a * t * v + d * second_u + 2 * b * u * w - 2,
            a * third_t + c * third_v + b * third_u + d * third_w + 12.6,
            c * third_t - a * third_v + d * third_u - b * third_w - 9.48,
        ]
    )


def _freudenstein_start(n: int) -> Values:
    return np.concatenate([[0.5, -2.0], np.zeros(n - 2)])


SYSTEMS = {
    "linear_full_rank": System(linear_full_rank, all_at(1.0), lambda n: 5 * n),
    "linear_rank_1": System(linear_rank_1, all_at(1.0), lambda n: 5 * n),
    "linear_rank_1_zeros": System(linear_rank_1_zeros, all_at(1.0), lambda n: 5 * n),
    "rosenbrock": System(rosenbrock, lambda n: (-1.2, 1.0), same),
    "helical_valley": System(helical_valley, lambda n: (-1.0, 0.0, 0.0), same),
    "powell_singular": System(powell_singular, lambda n: np.tile([3.0, -1, 0, 1], n // 4), same),
    "freudenstein_roth": System(freudenstein_roth, _freudenstein_start, lambda n: 2 * n - 2),
    "watson": System(watson, all_at(0.5), lambda n: 31),
    "box_3d": System(box_3d, lambda n: (0.0, 10.0, 20.0), lambda n: 10),
    "brown_dennis": System(brown_dennis, lambda n: (25.0, 5.0, -5.0, -1.0), lambda n: 20),
    "chebyquad": System(chebyquad, lambda n: counted(n)[:, 0] / (n + 1), same),
    "brown_almost_linear": System(brown_almost_linear, all_at(0.5), same),
    "bdqrtic": System(bdqrtic, all_at(1.0), lambda n: 2 * n - 8),
    "cube": System(cube, all_at(0.5), same),
    "mancino": System(mancino, mancino_start, same),
    "heart_8": System(heart_8, lambda n: (-0.3, -0.39, 0.3, -0.344, -1.2, 2.69, 1.59, -1.5), same),
}
