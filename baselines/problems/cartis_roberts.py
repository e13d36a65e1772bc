"""Algebraic systems of CUTEst in the benchmark of Cartis and Roberts, for any length.

The benchmark is the table of C. Cartis and L. Roberts, A derivative-free Gauss-Newton method, Math.
Prog. Comp. 11 (2019) 631-674. Formulas and names are from CUTEst, and reproduce the sums of squares
of the table at the start, for its lengths. Four formulas follow Moré, Garbow and Hillstrom (1981,
MGH) or Nesterov instead, and give other sums: `penlt2ne`, `morebvne`, Powell's singular function,
with other weights than POWELLSE, and `chebyshev_rosenbrock`. L is L. Lukšan, Hybrid methods in
large sparse nonlinear least squares, J. Optim. Theory Appl. 89 (1996) 575-595.
"""

from __future__ import annotations

import numpy as np

from baselines.problems.records import System, Values, all_at, counted, same

TOINT = np.array([
    1.25, 1.40, 2.40, 1.40, 1.75, 1.20, 2.25, 1.20, 1.00, 1.10, 1.50, 1.60, 1.25, 1.25, 1.20, 1.20,
    1.40, 0.50, 0.50, 1.25, 1.80, 0.75, 1.25, 1.40, 1.60, 2.00, 1.00, 1.60, 1.25, 2.75, 1.25, 1.25,
    1.25, 3.00, 1.50, 2.00, 1.25, 1.40, 1.80, 1.50, 2.20, 1.40, 1.50, 1.25, 2.00, 1.50, 1.25, 1.40,
    0.60, 1.50,
])  # fmt: skip
"""The weights of Toint's chained Rosenbrock function."""
LUKSAN_17 = np.array([[30.6], [72.2], [124.4], [187.4]])


def argtrig(x: Values, m: int) -> Values:
    """sum cos x_j + i (cos x_i + sin x_i) - (n + i)."""
    i = counted(len(x))
    return np.cos(x).sum(axis=0) + i * (np.cos(x) + np.sin(x)) - (len(x) + i)


def artif(x: Values, m: int) -> Values:
    """arctan sin(i x_i) - (x_i-1 + x_i + x_i+1) / 20, with 0 beyond the ends; i modulo 100."""
    padded = np.pad(x, ((1, 1), (0, 0)))
    waves = np.arctan(np.sin(counted(len(x)) % 100 * x))
    return waves - (padded[:-2] + x + padded[2:]) / 20


def arwhdne(x: Values, m: int) -> Values:
    """3 - 4 x_i, and x_i^2 + x_n^2, for i < n."""
    return np.concatenate([3 - 4 * x[:-1], x[:-1] ** 2 + x[-1] ** 2])


def broydn3d(x: Values, m: int) -> Values:
    """Broyden, tridiagonal (MGH 30): (3 - 2 x_i) x_i - x_i-1 - 2 x_i+1 + 1."""
    padded = np.pad(x, ((1, 1), (0, 0)))
    return (3 - 2 * x) * x - padded[:-2] - 2 * padded[2:] + 1


def broydnbd(x: Values, m: int) -> Values:
    """Broyden, banded: x_i (2 + 5 x_i^2) - sum x_j (1 + x_j), j from i - 5 to i + 1 without i.

    MGH 31 adds 1, CUTEst does not.
    """
    distance = counted(len(x)) - counted(len(x)).T
    near = (distance <= 5) & (distance >= -1) & (distance != 0)
    return x * (2 + 5 * x**2) - near @ (x * (1 + x))


def chnrsbne(x: Values, m: int) -> Values:
    """Toint's chained Rosenbrock: 4 a_i (x_i-1 - x_i^2), x_i - 1."""
    a = TOINT[1 : len(x), None]
    return np.concatenate([4 * a * (x[:-1] - x[1:] ** 2), x[1:] - 1])


def eigen(diagonal: Values, beside: float, x: Values) -> Values:
    """Q^T D Q - A and Q^T Q - I, upper triangles, of a tridiagonal A; x are D, then Q by rows."""
    N = len(diagonal)
    D, Q = x[:N], x[N:].reshape(N, N, -1)
    A = np.diag(diagonal) + beside * (np.eye(N, k=1) + np.eye(N, k=-1))
    products = np.einsum("aik,ajk->aijk", Q, Q)
    spectral = (D[:, None, None] * products).sum(axis=0) - A[:, :, None]
    unit = products.sum(axis=0) - np.eye(N)[:, :, None]
    rows, columns = np.triu_indices(N)
    return np.concatenate([spectral[rows, columns], unit[rows, columns]])


def eigena(x: Values, m: int) -> Values:
    """Eigenvalues and vectors of the diagonal matrix of 1 to N, where n = N + N^2."""
    return eigen(np.arange(1.0, _order(len(x)) + 1), 0.0, x)


def eigenb(x: Values, m: int) -> Values:
    """Eigenvalues and vectors of the matrix with 2 on the diagonal and -1 next to it."""
    return eigen(np.full(_order(len(x)), 2.0), -1.0, x)


def _order(n: int) -> int:
    """Return N for n = N + N^2."""
    return int(n**0.5)


def _eigen_start(n: int) -> Values:
    N = _order(n)
    return np.concatenate([np.ones(N), np.eye(N).ravel()])


def luksan11(x: Values, m: int) -> Values:
    """L 11, chained serpentine: 20 x_i / (1 + x_i^2) - 10 x_i+1, x_i - 1."""
    a = x[:-1]
    return np.concatenate([20 * a / (1 + a**2) - 10 * x[1:], a - 1])


def luksan12(x: Values, m: int) -> Values:
    """L 12, chained HS47: six residuals of every five variables, a block starts every third."""
    a, b, c, d, e = _chained(x, 5, 3)
    return np.concatenate(
        [10 * (a**2 - b), c - 1, (d - 1) ** 2, (e - 1) ** 3, d * a**2 + np.sin(d - e) - 10,
         b + c * d - 20]
    )  # fmt: skip


def luksan13(x: Values, m: int) -> Values:
    """L 13, chained HS48: seven residuals of every five variables, a block starts every third."""
    a, b, c, d, e = _chained(x, 5, 3)
    return np.concatenate(
        [10 * (a**2 - b), 10 * (b**2 - c), (c - d) ** 2, (d - e) ** 2, a + b**2 + c - 30,
         b - c**2 + d - 10, a * e - 10]
    )  # fmt: skip


def luksan14(x: Values, m: int) -> Values:
    """L 14, chained HS53: seven residuals of every five variables, a block starts every third."""
    a, b, c, d, e = _chained(x, 5, 3)
    return np.concatenate(
        [10 * (a**2 - b), b + c - 2, d - 1, e - 1, a + 3 * b, c + d - 2 * e, 10 * (b**2 - e)]
    )  # fmt: skip


def luksan17(x: Values, m: int) -> Values:
    """L 17, sparse trigonometric: sum l^2 q cos x_q - l q^2 sin x_q - y_l, l = 1 to 4.

    The four x_q are of a block, which starts every second variable.
    """
    block = np.stack(_chained(x, 4, 2))
    numbers = counted(4)
    cosines = np.tensordot((numbers**2) @ numbers.T, np.cos(block), 1)
    sines = np.tensordot(numbers @ (numbers.T**2), np.sin(block), 1)
    return np.concatenate(list(cosines - sines - LUKSAN_17[:, :, None]))


def _chained(x: Values, width: int, step: int) -> list[Values]:
    """Return the first, second, ... variables of all blocks of `width` with distance `step`."""
    starts = np.arange(0, len(x) - width + 1, step)
    return [x[starts + k] for k in range(width)]


def _matrix(p: int, band: bool = False) -> Values:
    """Return B with entries sin k^2, numbered by rows, or only its three central diagonals."""
    places = np.abs(counted(p) - counted(p).T) <= (1 if band else p)
    B = np.zeros((p, p))
    B[places] = np.sin(np.arange(1.0, np.count_nonzero(places) + 1) ** 2)
    return B


def _square_root(x: Values, B: Values) -> Values:
    """X^2 - B^2, as rows."""
    p = len(B)
    X = x.reshape(p, p, -1)
    return (np.einsum("ijk,jlk->ilk", X, X) - (B @ B)[:, :, None]).reshape(p * p, -1)


def _msqrtb_matrix(p: int) -> Values:
    B = _matrix(p)
    B[2, 0] = 0.0
    return B


def msqrta(x: Values, m: int) -> Values:
    """Square root of a matrix of p^2 = n elements: X^2 - B^2, B of sines."""
    return _square_root(x, _matrix(round(len(x) ** 0.5)))


def msqrtb(x: Values, m: int) -> Values:
    """Square root of a matrix as in `msqrta`, with 0 in the third row of B."""
    return _square_root(x, _msqrtb_matrix(round(len(x) ** 0.5)))


def spmsqrt(x: Values, m: int) -> Values:
    """Square root of a matrix of p rows and three diagonals, n = 3 p - 2: five of X^2 - B^2."""
    B = _matrix((len(x) + 2) // 3, band=True)
    X = np.zeros((B.size, x.shape[1]), x.dtype)
    X[np.flatnonzero(B)] = x
    near = np.abs(counted(len(B)) - counted(len(B)).T) <= 2
    return _square_root(X, B)[near.ravel()]


def chebyshev_rosenbrock(x: Values, m: int) -> Values:
    """Nesterov's oscillating path: (x_1 - 1) / 2, x_i - 2 x_i-1^2 + 1, which OSCIPANE weighs."""
    return np.concatenate([(x[:1] - 1) / 2, x[1:] - 2 * x[:-1] ** 2 + 1])


def penlt1ne(x: Values, m: int) -> Values:
    """MGH 23: 1e-5^.5 (x_i - 1), sum x_j^2 - 1/4."""
    return np.concatenate([1e-5**0.5 * (x - 1), (x**2).sum(axis=0, keepdims=True) - 0.25])


def penlt2ne(x: Values, m: int) -> Values:
    """MGH 24: x_1 - 0.2, two rows of exponentials times 1e-5^.5, and a weighted sum of squares."""
    n = len(x)
    i, e = counted(n)[1:], np.exp(x / 10)
    weights = n - np.arange(n)[:, None]
    return np.concatenate(
        [x[:1] - 0.2, 1e-5**0.5 * (e[1:] + e[:-1] - np.exp(i / 10) - np.exp((i - 1) / 10)),
         1e-5**0.5 * (e[1:] - np.exp(-0.1)), (weights * x**2).sum(axis=0, keepdims=True) - 1]
    )  # fmt: skip


def vardimne(x: Values, m: int) -> Values:
    """MGH 25: x_i - 1, s, s^2, where s = sum j (x_j - 1)."""
    total = (counted(len(x)) * (x - 1)).sum(axis=0, keepdims=True)
    return np.concatenate([x - 1, total, total**2])


def yatp1ne(x: Values, m: int) -> Values:
    """Toint's doubly stochastic matrix: x^3 - 10 x^2 - (y_i + z_j) (x cos x - sin x) of X (N, N).

    Rows and columns of sin x / x sum to 1. Both y_i and z_j, as CUTEst has it since 2019.
    """
    X, y, z = _bordered(x)
    inner = X**3 - 10 * X**2 - (y + z) * (X * np.cos(X) - np.sin(X))
    return _sums_to_one(inner, np.sin(X) / X)


def yatp2ne(x: Values, m: int) -> Values:
    """Variant with x - (y_i + z_j) (1 + cos x) - 1, and sums of x + sin x."""
    X, y, z = _bordered(x)
    return _sums_to_one(X - (y + z) * (1 + np.cos(X)) - 1, X + np.sin(X))


def _bordered(x: Values) -> tuple[Values, Values, Values]:
    """X (N, N, k), y (N, 1, k), z (1, N, k) of n = N^2 + 2 N."""
    N = _side(len(x))
    return x[: N * N].reshape(N, N, -1), x[N * N : N * N + N, None], x[None, N * N + N :]


def _side(n: int) -> int:
    """Return N for n = N^2 + 2 N."""
    return int((n + 1) ** 0.5) - 1


def _sums_to_one(inner: Values, shares: Values) -> Values:
    flat = inner.reshape(-1, inner.shape[2])
    return np.concatenate([flat, shares.sum(axis=1) - 1, shares.sum(axis=0) - 1])


def _yatp_start(value: float, n: int) -> Values:
    N = _side(n)
    return np.concatenate([np.full(N * N, value), np.zeros(2 * N)])


SYSTEMS = {
    "argtrig": System(argtrig, lambda n: np.full(n, 1 / n), same),
    "artif": System(artif, all_at(1.0), same),
    "arwhdne": System(arwhdne, all_at(1.0), lambda n: 2 * n - 2),
    "broydn3d": System(broydn3d, all_at(-1.0), same),
    "broydnbd": System(broydnbd, all_at(1.0), same),
    "chnrsbne": System(chnrsbne, all_at(-1.0), lambda n: 2 * n - 2),
    "eigena": System(eigena, _eigen_start, same),
    "eigenb": System(eigenb, _eigen_start, same),
    "luksan11": System(luksan11, all_at(-0.8), lambda n: 2 * n - 2),
    "luksan12": System(luksan12, all_at(-1.0), lambda n: 2 * n - 4),
    "luksan13": System(luksan13, all_at(-1.0), lambda n: 7 * (n - 2) // 3),
    "luksan14": System(luksan14, all_at(-1.0), lambda n: 7 * (n - 2) // 3),
    "luksan17": System(
        luksan17, lambda n: np.resize([-0.8, 1.2, -1.2, 0.8], n), lambda n: 2 * n - 4
    ),
    "msqrta": System(msqrta, lambda n: 0.2 * _matrix(round(n**0.5)).ravel(), same),
    "msqrtb": System(msqrtb, lambda n: 0.2 * _msqrtb_matrix(round(n**0.5)).ravel(), same),
    "spmsqrt": System(
        spmsqrt, lambda n: 0.2 * np.sin(np.arange(1.0, n + 1) ** 2), lambda n: (5 * n - 8) // 3
    ),
    "chebyshev_rosenbrock": System(
        chebyshev_rosenbrock, lambda n: np.append(-1.0, np.ones(n - 1)), same
    ),
    "penlt1ne": System(penlt1ne, lambda n: np.arange(1.0, n + 1), lambda n: n + 1),
    "penlt2ne": System(penlt2ne, all_at(0.5), lambda n: 2 * n),
    "vardimne": System(vardimne, lambda n: 1 - np.arange(1.0, n + 1) / n, lambda n: n + 2),
    "yatp1ne": System(yatp1ne, lambda n: _yatp_start(6.0, n), same),
    "yatp2ne": System(yatp2ne, lambda n: _yatp_start(10.0, n), same),
}
