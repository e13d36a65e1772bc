"""Signs: what contradicts ISO-W, and what says nothing of it."""

import numpy as np
import pytest

from miho.data.conventions import sign_problem

ROWS = 60
UNITS = {"alpha": "rad", "kappa": "-", "Fx": "N"}
TIRE = {"alpha": "rad", "Fy": "N"}
RISING = np.linspace(-1, 1, ROWS)
DRAG = -300 - 100 * RISING
"""A force that falls as the slip ratio of the same rows rises."""


@pytest.mark.parametrize(
    ("alpha", "kappa", "refused"),
    [
        (0.01 * RISING, 0.012 + 0.004 * RISING, False),  # an offset of the rolling radius
        (0.3 + 0 * RISING, 0.1 * RISING, False),  # at a large slip angle
        (0.01 * RISING, 0.01 * RISING + 0.001, True),  # both signs
        (0.01 * RISING, 0.1 + 0.02 * RISING, True),  # a large range
    ],
)
def test_driving_force_is_judged_by_slip_that_is_driven(
    alpha: np.ndarray, kappa: np.ndarray, refused: bool
) -> None:
    columns = {"alpha": alpha, "kappa": kappa, "Fx": DRAG}
    assert (sign_problem(columns, UNITS) is not None) == refused


@pytest.mark.parametrize("rows", [3, 5, 8, 9, 10, 20, 100])
def test_noise_has_no_wrong_sign(rows: int) -> None:
    """The largest of 2000 rank correlations of 10 rows exceeds 0.5 by far."""
    rng = np.random.default_rng(0)
    for alpha, force in rng.normal(0, [[[0.1], [1000]]], (2000, 2, rows)):
        assert sign_problem({"alpha": alpha, "Fy": force}, TIRE) is None


@pytest.mark.parametrize("rows", [8, 9, 10, 20, 100])
def test_a_rising_force_is_refused(rows: int) -> None:
    alpha = np.linspace(-0.1, 0.1, rows)
    problem = sign_problem({"alpha": alpha, "Fy": 4e4 * alpha}, TIRE)
    assert problem is not None
    assert problem.negated == ("alpha", "Fy")
    assert sign_problem({"alpha": alpha, "Fy": -4e4 * alpha}, TIRE) is None
