"""Robust losses: scipy's definitions, consistent derivatives, and outliers that do not decide."""

import numpy as np
import pytest
import scipy.optimize

from miho.identification import Cauchy, Huber, Loss, Square
from miho.identification.refit import refit
from miho.identification.robust_loss import slope
from miho.optim.problem import mean_square
from tests.identification.published import line

LOSSES = [Square(), Huber(0.7), Cauchy(0.7)]
r = np.array([-50.0, -0.7, -0.3, 0.0, 1e-9, 0.2, 0.69999, 0.70001, 3.0])


@pytest.mark.parametrize(("loss", "name"), [(Huber(0.7), "huber"), (Cauchy(0.7), "cauchy")])
def test_the_losses_are_scipys(loss: Loss, name: str) -> None:
    """scipy's cost is half the sum of rho(z) scale^2."""
    for value in r:
        fit = scipy.optimize.least_squares(
            lambda _, value=value: np.array([value]), [0.0], loss=name, f_scale=0.7, max_nfev=1
        )
        assert loss.transform(np.array([value]))[0] ** 2 == pytest.approx(2 * fit.cost, rel=1e-12)


@pytest.mark.parametrize("loss", LOSSES)
def test_derivatives_by_differences(loss: Loss) -> None:
    h = 1e-6
    smooth = r[np.abs(np.abs(r) - 0.7) > 1e-4]
    high, low = loss.transform(smooth + h), loss.transform(smooth - h)
    np.testing.assert_allclose(slope(loss, smooth), (high - low) / (2 * h), atol=1e-6)
    psi, stiffness = loss.influence(smooth)
    np.testing.assert_allclose(psi, (high**2 - low**2) / (4 * h), atol=1e-7, rtol=1e-6)
    ends = loss.influence(smooth + h)[0] - loss.influence(smooth - h)[0]
    np.testing.assert_allclose(stiffness, ends / (2 * h), atol=1e-6)


@pytest.mark.parametrize("loss", LOSSES[1:])
def test_outliers_do_not_decide(loss: Loss) -> None:
    x = np.linspace(0, 1, 50)
    y = 1 + 2 * x
    y[45:] += 40
    robust, square = line(y, x, loss), line(y, x)
    start = np.array([1.0, 2.0])
    assert np.abs(refit(robust, start).theta - start).max() < 1
    assert np.abs(refit(square, start).theta - start).max() > 10
    assert robust.name == f"line-published-{type(loss).__name__.lower()}"
    assert robust.linear == ()
    assert square.linear == ("a", "b")


def test_the_loss_is_the_mean_square_of_the_residuals() -> None:
    x = np.linspace(0, 1, 50)
    fit = line(3 * x**3, x, Cauchy(0.2))
    theta = np.array([0.2, 1.0])
    residuals = fit.residuals(theta)
    assert fit.loss(theta[None])[0] == pytest.approx(np.mean(residuals**2), rel=1e-12)
    h = 1e-6
    numeric = [
        (fit.residuals(theta + step) - fit.residuals(theta - step)) / (2 * h)
        for step in h * np.eye(2)
    ]
    np.testing.assert_allclose(fit.jacobian(theta), np.transpose(numeric), atol=1e-7)


def test_the_order_in_memory_does_not_change_a_mean_square() -> None:
    residuals = np.random.default_rng(0).standard_normal((50, 6))
    alone = [float(mean_square(row)) for row in residuals]
    assert mean_square(residuals).tolist() == alone
    assert mean_square(np.asfortranarray(residuals)).tolist() == alone


def test_a_scale_must_be_positive() -> None:
    with pytest.raises(ValueError, match=r"scale is -1.*positive number"):
        Huber(-1)
