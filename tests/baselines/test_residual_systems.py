"""Published systems of residuals: sums of squares as printed, and exact derivatives."""

import math

import numpy as np
import pytest
import scipy.optimize

from baselines.problems import ResidualSystem, zero_residuals
from baselines.problems.residual_systems import SYSTEMS
from miho.models.model import central_differences

STARTS = {
    # the table of medium-sized problems of Cartis and Roberts (2019)
    "argtrig_100": 32.99641, "artif_100": 36.59115, "arwhdne_100": 495, "bdvalues_100": 1.943417e7,
    "bratu2d_64": 0.1560738, "bratu2dt_64": 0.4521311, "bratu3d_27": 4.888529,
    "brown_almost_linear_100": 2.524757e5, "broydn3d_100": 111, "broydnbd_100": 2404,
    "cbratu2d_50": 0.4822531, "chandheq_100": 6.923365, "chemrcta_100": 3.0935,
    "chemrctb_100": 1.446513, "chnrsbne_50": 7635.84, "eigena_110": 285, "eigenb_110": 19,
    "freudenstein_roth_100": 9.95565e4, "integreq_100": 0.5730503, "luksan11_100": 626.0640,
    "luksan12_98": 3.2160e4, "luksan13_98": 6.4352e4, "luksan14_98": 2.6880e4,
    "luksan17_100": 1.687370e6, "luksan21_100": 99.98751, "msqrta_100": 212.7162,
    "msqrtb_100": 205.0753, "penlt1ne_100": 1.144806e11, "spmsqrt_100": 74.33542,
    "vardimne_100": 1.310584e14, "yatp1ne_120": 2.073643e6, "yatp2ne_120": 1.831687e5,
}  # fmt: skip
"""Sums of squares at the start, by system and number of variables."""
OPTIMA = {
    # the same table, of problems with residuals
    "arwhdne_100": 27.66203, "bratu2dt_64": 1.853474e-5, "chemrctb_100": 1.404424e-3,
    "freudenstein_roth_100": 1.196458e4, "luksan13_98": 2.518886e4, "luksan14_98": 1.239235e2,
    "luksan17_100": 0.4931613,
    # More, Garbow and Hillstrom (1981), where a descent from the start ends
    "freudenstein_roth_2": 48.9842, "brown_dennis_4": 85822.2, "chebyquad_8": 3.51687e-3,
    "watson_6": 2.28767e-3, "watson_9": 1.39976e-6, "penlt1ne_4": 2.24997e-5,
    "penlt1ne_10": 7.08765e-5, "penlt2ne_4": 9.37629e-6, "penlt2ne_10": 2.93660e-4,
    "linear_full_rank_9": 36, "linear_rank_1_7": 35 * 34 / (2 * 71),
    "linear_rank_1_zeros_7": (35**2 + 3 * 35 - 6) / (2 * (2 * 35 - 3)),
}  # fmt: skip
"""Sums of squares at the optimum."""
ZEROS = {
    "rosenbrock": (1, 1), "helical_valley": (1, 0, 0), "powell_singular": (0,) * 8,
    "freudenstein_roth": (5, 4), "box_3d": (1, 10, 1), "brown_almost_linear": (1,) * 6,
    "cube": (1,) * 5, "chnrsbne": (1,) * 6, "luksan11": (1,) * 5, "broydnbd": (0,) * 7,
    "argtrig": (0,) * 5, "artif": (0,) * 5, "vardimne": (1,) * 5,
    "chebyshev_rosenbrock": (1,) * 6, "eigena": (1, 2, 1, 0, 0, 1), "chemrctb": (5 / 14,) * 10,
}  # fmt: skip
"""Variables where every residual is 0, by arithmetic."""
SMALL = {
    "rosenbrock": 2, "helical_valley": 3, "freudenstein_roth": 2, "box_3d": 3, "brown_dennis": 4,
    "luksan12": 8, "luksan13": 8, "luksan14": 8, "msqrta": 9, "msqrtb": 9, "bratu2d": 9,
    "bratu2dt": 9, "eigena": 6, "eigenb": 6, "spmsqrt": 10,
}  # fmt: skip
"""Lengths of systems that do not exist for eight variables."""


def system(name: str) -> ResidualSystem:
    """Of a name that ends in the number of variables."""
    stem, _, length = name.rpartition("_")
    return ResidualSystem(stem, int(length))


def residuals(model: ResidualSystem, x: np.ndarray) -> np.ndarray:
    return model.predict(x[None], np.arange(1.0, model.size + 1))[0]


@pytest.mark.parametrize("name", STARTS)
def test_the_start_has_the_published_sum_of_squares(name: str) -> None:
    """To the seven digits that are printed: half a unit of the last is 5e-7 at most."""
    model = system(name)
    squares = float((residuals(model, model.start) ** 2).sum())
    assert squares == pytest.approx(STARTS[name], rel=6e-7)


@pytest.mark.parametrize("name", OPTIMA)
def test_a_descent_from_the_start_ends_at_the_published_optimum(name: str) -> None:
    """To the six digits that are printed; where variables are not determined, the sum is."""
    model = system(name)
    rows = np.arange(1.0, model.size + 1)
    x = model.start
    for _ in range(2):
        x = scipy.optimize.least_squares(
            lambda x: residuals(model, x), x, lambda x: model.jacobian(x, rows),
            x_scale="jac", ftol=1e-15, xtol=1e-15, gtol=1e-15, max_nfev=5000,
        ).x  # fmt: skip
    assert float((residuals(model, x) ** 2).sum()) == pytest.approx(OPTIMA[name], rel=6e-6)


@pytest.mark.parametrize("name", ZEROS)
def test_the_known_solution_leaves_rounding(name: str) -> None:
    """A few operations on numbers of the size of the coefficients, of 100 at most."""
    x = np.array(ZEROS[name], dtype=float)
    assert np.abs(residuals(ResidualSystem(name, x.size), x)).max() < 1e-12


@pytest.mark.parametrize("name", SYSTEMS)
def test_derivatives_are_exact_and_rows_are_independent_of_the_others(name: str) -> None:
    """Central differences are right to 1e-10 of the largest of smooth functions, or 1e-8 where a
    residual is a difference of numbers that are much larger (`central_differences`)."""
    model = ResidualSystem(name, SMALL.get(name, 8))
    rng = np.random.default_rng(0)
    x = model.start + 0.1 * rng.standard_normal(model.length)
    rows = np.arange(1.0, model.size + 1)
    J = model.jacobian(x, rows)
    assert J.shape == (model.size, model.length)
    differences = central_differences(model.predict, x, rows)
    np.testing.assert_allclose(J, differences, rtol=0, atol=1e-6 * np.abs(J).max())

    part = rows[::-2]
    both = model.predict(np.array([model.start, x]), part)
    np.testing.assert_allclose(both[1], residuals(model, x)[::-2], rtol=1e-12)
    np.testing.assert_allclose(model.jacobian(x, part), J[::-2], rtol=1e-12)


def test_a_system_without_a_value_is_not_finite_and_raises_nothing() -> None:
    far = np.full((1, 3), -1e300)
    assert not np.isfinite(ResidualSystem("box_3d", 3).predict(far, np.arange(1.0, 11))).any()


def test_what_a_system_is_fitted_to() -> None:
    data = zero_residuals(3)
    assert data["row"].tolist() == [1, 2, 3]
    assert data["y"].tolist() == [0, 0, 0]
    model = ResidualSystem("rosenbrock", 2)
    assert (model.name, list(model.parameters)) == ("rosenbrock_2", ["x1", "x2"])
    assert math.isclose(residuals(model, model.start)[0], 10 * (1 - 1.44))


def test_wrong_names_and_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match=r"system is 'rosen'; expected one of .*rosenbrock"):
        ResidualSystem("rosen", 2)
    with pytest.raises(ValueError, match="length is 0; expected a whole number of at least 1"):
        ResidualSystem("rosenbrock", 0)
    with pytest.raises(ValueError, match=r"length is 3; rosenbrock has lengths such as 2$"):
        ResidualSystem("rosenbrock", 3)
    with pytest.raises(
        ValueError, match="length is 12; bratu2d has lengths such as 1, 4, 9, 16, 25"
    ):
        ResidualSystem("bratu2d", 12)
    with pytest.raises(ValueError, match="row is 3; rosenbrock_2 has the rows 1 to 2"):
        ResidualSystem("rosenbrock", 2).predict(np.ones((1, 2)), np.array([3.0]))
    with pytest.raises(ValueError, match="rows is 0; expected a whole number of at least 1"):
        zero_residuals(0)
