"""Steps, updates and differences against SciPy and closed forms; the simplex against SciPy's."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, minimize, rosen

from miho.optim.quasi_newton import bfgs, convex, curve_along, mixed, newton_steps, parabolas
from miho.optim.simplex import Simplex

Array = NDArray[np.float64]


def matrices(n: int, d: int, rng: np.random.Generator) -> Array:
    A = rng.standard_normal((n, d + 2, d))
    return np.asarray(A.transpose(0, 2, 1) @ A)


def test_steps_are_the_minima_of_their_models_in_the_box() -> None:
    """Against SciPy's bounded linear least squares; a gain is what the model says."""
    rng = np.random.default_rng(1)
    n, d = 60, 5
    B, g = matrices(n, d, rng), rng.standard_normal((n, d))
    low, high = -rng.uniform(0, 0.5, (n, d)), rng.uniform(0, 0.5, (n, d))
    steps, gains = newton_steps(B, g, low, high)
    for k in range(n):
        R = np.linalg.cholesky(B[k]).T
        expected = lsq_linear(R, -np.linalg.solve(R.T, g[k]), (low[k], high[k]), method="bvls").x
        np.testing.assert_allclose(steps[k], expected, atol=1e-8)
        assert gains[k] == pytest.approx(-g[k] @ steps[k] - steps[k] @ B[k] @ steps[k] / 2)


def test_a_singular_model_gives_a_step() -> None:
    B = np.array([[[1.0, 0.0], [0.0, 0.0]]])
    steps, _ = newton_steps(B, np.array([[1.0, 0.0]]), -np.ones((1, 2)), np.ones((1, 2)))
    assert np.isfinite(steps).all()
    assert steps[0, 0] == pytest.approx(-1.0)


def test_updates_meet_the_secant_condition_and_stay_convex() -> None:
    rng = np.random.default_rng(2)
    B, s = matrices(20, 4, rng), rng.standard_normal((20, 4))
    y = np.einsum("nij,nj->ni", matrices(20, 4, rng), s)
    updated = bfgs(B, s, y)
    curved = np.einsum("ni,ni->n", s, y) > 0.1 * np.einsum("ni,nij,nj->n", s, B, s)
    assert curved.any()
    np.testing.assert_allclose(np.einsum("nij,nj->ni", updated, s)[curved], y[curved], rtol=1e-9)
    assert (np.linalg.eigvalsh(bfgs(B, s, -y)) > 0).all(), "damped where the loss curves down"
    curvature = rng.uniform(0.1, 10, 20)
    along = curve_along(B, s, curvature)
    np.testing.assert_allclose(np.einsum("ni,nij,nj->n", s, along, s), curvature, rtol=1e-9)


def test_differences_are_exact_on_quadratics() -> None:
    rng = np.random.default_rng(3)
    n, d = 8, 3
    H = matrices(n, d, rng)
    H[0] = -H[0]
    g = rng.standard_normal((n, d))

    def loss(s: Array) -> Array:
        return np.asarray(
            1 + np.einsum("ni,nki->nk", g, s) + np.einsum("nki,nij,nkj->nk", s, H, s) / 2
        )

    a, b = np.full((n, d), 0.1), np.full((n, d), -0.1)
    a[1], b[1] = -0.1, -0.05
    eye = np.eye(d)
    ahead, behind = loss(a[:, :, None] * eye), loss(b[:, :, None] * eye)
    losses = np.ones(n)
    slope, curvature = parabolas(losses, a, ahead, b, behind)
    np.testing.assert_allclose(slope, g, atol=1e-12)
    i, j = np.triu_indices(d, 1)
    forward = a[:, :, None] * eye
    hessians = mixed(losses, a, ahead, loss(forward[:, i] + forward[:, j]), curvature)
    np.testing.assert_allclose(hessians, H, atol=1e-10)
    bent = convex(hessians, g)
    np.testing.assert_allclose(bent[1:], H[1:], rtol=1e-8)
    assert (np.linalg.eigvalsh(bent[0]) > 0).all()
    assert (np.linalg.eigvalsh(convex(0 * hessians, g)) > 0).all()


def test_a_difference_that_is_missing_is_a_line() -> None:
    a, b = np.array([[0.1, 0.1, 0.1]]), np.array([[-0.1, -0.1, -0.1]])
    inf = np.inf
    ahead, behind = np.array([[1.2, inf, inf]]), np.array([[inf, 1.3, inf]])
    slope, curvature = parabolas(np.ones(1), a, ahead, b, behind)
    np.testing.assert_allclose(slope, [[2.0, -3.0, 0.0]])
    np.testing.assert_array_equal(curvature, [[0.0, 0.0, 0.0]])


@pytest.mark.parametrize("d", [2, 3, 5])
def test_the_simplex_moves_as_scipys_adaptive_one(d: int) -> None:
    """The same corners after the same evaluations; SciPy has Gao and Han's coefficients as well."""
    start = np.full(d, 0.4)

    def of(x: Array) -> float:
        return float(rosen(4 * x - 1))

    simplex = Simplex.around(start, of(start), 0.02)
    first = simplex.corners.copy()
    while simplex.evaluations < 60 * d:
        simplex.tell(np.array([of(x) for x in simplex.batch]))
    scipy = minimize(
        of,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": first,
            "adaptive": True,
            "maxfev": simplex.evaluations + 1,
            "xatol": 0,
            "fatol": 0,
        },
    )
    assert simplex.best[1] == pytest.approx(scipy.fun, rel=1e-9)
    np.testing.assert_allclose(simplex.best[0], scipy.x, rtol=1e-9)
