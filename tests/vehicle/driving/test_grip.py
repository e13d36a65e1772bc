"""Peaks of tires over their load."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from miho.vehicle.driving.embedded import embedded_tires
from miho.vehicle.driving.grip import Grip
from miho.vehicle.driving.known_car import inclinations, static_loads
from miho.vehicle.models import Axle
from tests.vehicle.driving.cars import car

THETA = np.array([12.0, 1.6, 5000.0, 0.01, 80.0])


def test_full_tires_have_the_peaks_that_the_formula_gives_between_the_fitted_loads() -> None:
    """Within 2 %: the peak's fall with the load is a line but for the vertical shift."""
    vehicle, grip = car().vehicle, car().grip
    alpha = np.linspace(-0.3, 0.3, 4001)
    for i, (tire, gamma) in enumerate(zip(embedded_tires(), inclinations(vehicle), strict=True)):
        for part in (0.5, 1.2, 1.8):
            Fz = part * static_loads(vehicle)[i]
            Fy = tire.forces(Fz, 0.0, alpha, gamma).Fy
            growth = part * (1 + grip.lateral_sensitivity[i] * (part - 1))
            assert growth * grip.left[i] == pytest.approx(Fy.max(), rel=0.02)
            assert growth * grip.right[i] == pytest.approx(-Fy.min(), rel=0.02)


def test_identified_curves_have_their_peaks_d_and_sy_by_direction() -> None:
    """C = 1.6 reaches its peak D within the slip angles, so left is D + Sy, right D - Sy."""
    axle = Axle(THETA, THETA)
    grip = Grip.of_axles(axle, axle, [2600.0, 3900.0, 3000.0, 4500.0], sensitivity=-0.1)
    assert grip.left == pytest.approx(5080.0, rel=1e-5)
    assert grip.right == pytest.approx(4920.0, rel=1e-5)
    assert grip.drive == pytest.approx(4920.0, rel=1e-5)
    assert grip.lateral_sensitivity == pytest.approx(-0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"left": np.zeros(4)}, "left of the grip is .* expected numbers above 0 N"),
        ({"drive": np.ones(3)}, "drive of the grip is .* expected 4 finite numbers"),
        ({"lateral_sensitivity": np.full(4, 0.1)}, "expected numbers above -1 and at most 0"),
    ],
)
def test_bad_grip_is_refused(change: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(car().grip, **change)
