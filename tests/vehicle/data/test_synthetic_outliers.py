"""The embedded tire test with outliers: its noise is as told, and settings are checked."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import kstest, t

from miho.vehicle.data import tire_outlier_test
from miho.vehicle.data.synthetic_outliers import TRUTH
from miho.vehicle.models import Pacejka

TRUE = np.array([list(TRUTH.values())])


def test_noise_and_dropped_rows_are_as_told() -> None:
    """The Kolmogorov-Smirnov distance to Student's t, at the 0.1 % level."""
    data = tire_outlier_test(n=20_000)
    measured = data["Fy"] != 0
    assert 1 - measured.mean() == pytest.approx(0.05, abs=0.006), "four standard deviations"
    noise = (data["Fy"] - Pacejka().predict(TRUE, data["alpha"])[0])[measured] / 150.0
    assert kstest(noise, t(2.5).cdf).pvalue > 1e-3
    assert kstest(noise / noise.std(), "norm").pvalue < 1e-9


def test_a_robust_loss_finds_the_truth_and_least_squares_does_not() -> None:
    data, scale = tire_outlier_test(n=4000), TRUE[0]

    def residuals(x: np.ndarray) -> np.ndarray:
        return np.asarray(Pacejka().predict((x * scale)[None], data["alpha"])[0] - data["Fy"])

    start = np.array([0.9, 1.02, 0.95, 1.0, 1.0])
    square = least_squares(residuals, start, x_scale="jac").x
    robust = least_squares(residuals, start, loss="cauchy", f_scale=360.0).x
    assert abs(robust[2] - 1) < 0.01, "peak force"
    assert abs(square[2] - 1) > 2 * abs(robust[2] - 1)


def test_a_seed_is_a_stream() -> None:
    first, again, other_seed = (
        tire_outlier_test(seed=1),
        tire_outlier_test(seed=1),
        tire_outlier_test(),
    )
    assert np.array_equal(first["Fy"], again["Fy"])
    assert not np.array_equal(first["alpha"], other_seed["alpha"])


@pytest.mark.parametrize(
    "bad",
    [{"seed": -1}, {"n": 0}, {"scale": np.inf}, {"freedom": 0.0}, {"dropped": 1.0}],
)
def test_bad_settings_are_named(bad: dict[str, float]) -> None:
    ((name, value),) = bad.items()
    with pytest.raises(ValueError, match=f"{name} is {value}; expected"):
        tire_outlier_test(**bad)  # type: ignore[arg-type]
