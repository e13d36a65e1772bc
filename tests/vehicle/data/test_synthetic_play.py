"""The embedded brake test with play: what is true is found, and settings are checked."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from miho.vehicle.data import brake_play_test
from miho.vehicle.data.synthetic_brake import EMBEDDED_BRAKE, PLAY, TURNS
from miho.vehicle.models import BrakePlay

TRUE = np.array([*(getattr(EMBEDDED_BRAKE, name) for name in ("u0", "u1", "P_max", "n")), PLAY])


def test_the_sweeps_turn_where_they_should() -> None:
    u = brake_play_test(samples=2000)["u"]
    turned = u[1:-1][np.diff(np.sign(np.diff(u))) != 0]
    assert turned == pytest.approx(TURNS[1:-1], abs=0.005)
    assert np.abs(np.diff(u)).max() == pytest.approx(np.abs(np.diff(TURNS)).sum() / 1999)


@pytest.mark.parametrize("seed", range(5))
def test_parameters_are_recovered(seed: int) -> None:
    """Within four standard errors of linear theory, none above 5 %.

    u1 lies among the commands, up to 1: beyond them it cannot be told from P_max, and a rounding
    decides whether a search without bounds ends there.
    """
    data = brake_play_test(seed)

    def residuals(x: np.ndarray) -> np.ndarray:
        return np.asarray(BrakePlay().predict((x * TRUE)[None], data["u"])[0] - data["p"])

    def jacobian(x: np.ndarray) -> np.ndarray:
        return np.asarray(BrakePlay().jacobian(x * TRUE, data["u"]) * TRUE)

    start = np.array([0.8, 1.05, 0.9, 1.1, 1.5])
    bounds = np.zeros(5), np.array([0.2, 1.0, 2e7, 4.0, 0.3]) / TRUE
    identified = least_squares(residuals, start, jac=jacobian, bounds=bounds).x
    J = jacobian(identified)
    errors = 5.0e4 * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    assert (np.abs(identified - 1) < 4 * errors).all()
    assert errors.max() < 0.05


def test_a_seed_is_a_stream_of_noise() -> None:
    first, again, other_seed = brake_play_test(1), brake_play_test(1), brake_play_test(2)
    assert np.array_equal(first["p"], again["p"])
    noise = first["p"] - brake_play_test(1, noise=0.0)["p"]
    assert np.std(noise) == pytest.approx(5e4, rel=0.1)
    assert (
        abs(np.corrcoef(noise, other_seed["p"] - brake_play_test(2, noise=0.0)["p"])[0, 1]) < 0.15
    )


@pytest.mark.parametrize("bad", [{"seed": -1}, {"samples": 3}, {"noise": -1.0}, {"noise": np.nan}])
def test_bad_settings_are_named(bad: dict[str, float]) -> None:
    ((name, value),) = bad.items()
    with pytest.raises(ValueError, match=f"{name} is {value}; expected"):
        brake_play_test(**bad)  # type: ignore[arg-type]
