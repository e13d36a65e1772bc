"""Factors and small problems with bounds against LAPACK's and SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from miho.compiled import gauss_newton
from miho.compiled.gauss_newton import fold, solve_in_box
from miho.compiled.triangular import square_sum
from miho.core import machine

Array = NDArray[np.float64]


BACKWARD = 1e-13
"""Householder's factors are exact for data that differ by some m d times 1e-16 (Higham, Accuracy
and Stability of Numerical Algorithms, section 19.3), which is 1e-14 to 1e-13 for what is here."""


@pytest.fixture(autouse=True, params=["machine", "NumPy"])
def _form(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each test runs with the functions of the machine, and with those without it."""
    if request.param == "NumPy":
        monkeypatch.setattr(gauss_newton, "machine", lambda: None)
    elif machine() is None:
        pytest.skip("the machine was not built")


def factor(rows: Array, ends: list[int]) -> Array:
    """The factor (n, n) of rows (m, n), folded in chunks that end there."""
    n = rows.shape[1]
    T, start = np.zeros((n, n)), 0
    for end in ends:
        scratch = np.full((n, 8 * -(-(end - start) // 8)), np.nan)
        scratch[:, : end - start] = rows[start:end].T
        fold(T, scratch, end - start, n)
        start = end
    return T


@pytest.mark.parametrize("ends", [[200], [1, 2, 3, 200], [64, 128, 192, 200], [3, 190, 200]])
@pytest.mark.parametrize("size", [1.0, 1e150, 1e-150])
def test_the_factor_is_lapacks_however_the_rows_come(ends: list[int], size: float) -> None:
    """Up to the signs of its rows; of numbers whose squares are numbers."""
    rows = size * np.random.default_rng(1).standard_normal((200, 5))
    T, R = factor(rows, ends), np.linalg.qr(rows)[1]
    np.testing.assert_allclose(
        T * np.sign(np.diag(T))[:, None],
        R * np.sign(np.diag(R))[:, None],
        rtol=0,
        atol=BACKWARD * np.abs(R).max(),
    )
    assert (np.tril(T, -1) == 0).all()


def test_the_last_column_is_turned_with_the_others() -> None:
    """R'R = A'A and R'q = A'r, and what is left in the corner is the norm of what A cannot tell."""
    rng = np.random.default_rng(2)
    A, r = rng.standard_normal((300, 4)) * [1, 1e-6, 1e6, 1], rng.standard_normal(300)
    T = factor(np.column_stack([A, r]), [100, 300])
    R, q = T[:4, :4], T[:4, 4]
    norms = np.linalg.norm(A, axis=0)
    np.testing.assert_allclose(R.T @ R / np.outer(norms, norms), A.T @ A / np.outer(norms, norms),
                               rtol=0, atol=BACKWARD)  # fmt: skip
    np.testing.assert_allclose(R.T @ q / norms, A.T @ r / norms, rtol=0, atol=BACKWARD * 300)
    orthogonal = r - A / norms @ np.linalg.lstsq(A / norms, r)[0]
    assert abs(T[4, 4]) == pytest.approx(np.linalg.norm(orthogonal), rel=1e-12)


@pytest.mark.parametrize("zero", [0, 1, 2])
def test_a_column_of_zeros_has_none_but_zeros(zero: int) -> None:
    rows = np.random.default_rng(3).standard_normal((50, 4))
    rows[:, zero] = 0.0
    T = factor(rows, [20, 50])
    assert (T[:, zero] == 0).all()
    np.testing.assert_allclose(T.T @ T, rows.T @ rows, rtol=0, atol=BACKWARD * 50)


@pytest.mark.parametrize("size", [1e-154, 1e-158, 1e-163])
def test_a_column_whose_square_is_no_normal_number_is_finite(size: float) -> None:
    """1 / 1e-316 overflows; the factor is that of a column of zeros, or nearly."""
    rows = np.random.default_rng(6).standard_normal((50, 4))
    rows[:, 1] *= size
    T = factor(rows, [20, 50])
    assert (np.abs(T[:, 1]) <= 100 * size).all()
    rest = [0, 2, 3]
    R = np.linalg.qr(rows[:, rest])[1]
    np.testing.assert_allclose(T[:, 3] @ T[:, 3], R[:, 2] @ R[:, 2], rtol=1e-12)


def test_squares_are_summed() -> None:
    """500 positive numbers in any order: as many roundings at most, of 1.1e-16 of their sum."""
    r = np.random.default_rng(4).standard_normal(700)
    assert square_sum(r, 500) == pytest.approx(r[:500] @ r[:500], rel=1e-13)
    assert square_sum(r, 0) == 0.0


def boxed(rng: np.random.Generator, kind: str) -> tuple[Array, Array, Array, Array, Array]:
    """A random problem: A (m, n), r (m,), scale, low and high (n,)."""
    n, m = int(rng.integers(1, 8)), int(rng.integers(1, 12))
    A = rng.standard_normal((m, n))
    if kind == "dependent" and n > 3:
        A[:, 2] = 0.3 * A[:, 0] - 0.7 * A[:, 1]
    elif kind == "dependent":
        A[:, n // 2] = 0.3 * A[:, 0]
    elif kind == "zero":
        A[:, rng.integers(n)] = 0.0
    elif kind == "unlike":
        A *= 10.0 ** rng.integers(-3, 4, n)
    sides = rng.choice([0.0, 0.1, 1.0, 10.0], (2, n)) * rng.random((2, n))
    scale = rng.choice([0.0, 0.1, 1.0]) * rng.random(n)
    return A, rng.standard_normal(m), scale, -sides[0], sides[1] + 1e-3


@pytest.mark.parametrize("kind", ["any", "dependent", "zero", "unlike"])
def test_the_solution_in_a_box_is_scipys(kind: str) -> None:
    """The sum of squares is SciPy's (bvls), and the slopes are those of a minimum.

    Both to 1e-10 of what they are made of. Rounding leaves 1e-15, but where it decides whether
    a parameter depends on others, a pivot of 1e-14 may be left out, which is worth as much.
    """
    rng = np.random.default_rng(5)
    for _ in range(400):
        A, r, scale, low, high = boxed(rng, kind)
        n = len(low)
        T = factor(np.column_stack([A, r]), [len(r)])
        s = np.full(n, np.nan)
        solve_in_box(T, T[:, n].copy(), scale, low, high, s)
        assert ((low <= s) & (s <= high)).all()

        M, right = np.vstack([A, np.diag(scale)]), np.append(-r, np.zeros(n))
        scipys = lsq_linear(M, right, (low, high), method="bvls", tol=1e-15).x
        square, scipys_square = (((M @ x - right) ** 2).sum() for x in (s, scipys))
        assert square - scipys_square <= 1e-10 * (r @ r)

        slopes = M.T @ (M @ s - right)
        slopes[(s == low) & (slopes > 0)] = 0.0
        slopes[(s == high) & (slopes < 0)] = 0.0
        assert (np.abs(slopes) <= 1e-10 * np.linalg.norm(M, axis=0) * np.linalg.norm(r)).all()


def test_what_the_rows_do_not_tell_stays_where_it_is() -> None:
    """A parameter without influence, and the second of two that have the same, do not move."""
    rng = np.random.default_rng(6)
    a, b, r = rng.standard_normal((3, 40))
    rows = np.column_stack([a, np.zeros(40), 0.3 * a, b, r])
    T, s = factor(rows, [40]), np.empty(4)
    solve_in_box(T, T[:, 4].copy(), np.zeros(4), np.full(4, -9.0), np.full(4, 9.0), s)
    assert s[1] == s[2] == 0.0
    np.testing.assert_allclose(s[[0, 3]], np.linalg.lstsq(rows[:, [0, 3]], -r)[0], rtol=1e-12)
