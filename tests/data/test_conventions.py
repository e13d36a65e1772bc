"""Signs: what contradicts ISO-W, and what says nothing of it."""

import numpy as np
import pytest

from miho.data.conventions import sign_problem

ROWS = 60
UNITS = {"alpha": "rad", "kappa": "-", "Fx": "N"}
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
