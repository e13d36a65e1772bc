"""Tracks from files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from miho.data import CSVError
from miho.vehicle.driving.lines import track_from_csv

RADIUS = 120.0


def circle(
    folder: Path, *, noise: float = 0.0, turn: float = math.tau, repeat: bool = False
) -> str:
    n = 150
    phase = np.arange(n + repeat) * turn / n
    rng = np.random.default_rng(1)
    x, y = RADIUS * np.cos(phase), RADIUS * np.sin(phase)
    if noise:
        x, y = x + noise * rng.standard_normal(x.size), y + noise * rng.standard_normal(x.size)
    rows = np.stack([x, y, np.full_like(x, 5.0), np.full_like(x, 4.0), np.full_like(x, 0.1)], 1)
    path = folder / "ring.csv"
    header = "x_m,y_m,w_tr_right_m,w_tr_left_m,bank_rad"
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return str(path)


@pytest.mark.parametrize("repeat", [False, True])
def test_points_of_a_circle_give_the_circle(tmp_path: Path, repeat: bool) -> None:
    """150 chords of 5 m; a cubic spline follows the arc to 1e-5 of its radius."""
    track = track_from_csv(circle(tmp_path, repeat=repeat), bank="bank_rad", noise=0.0)
    assert track.name == "ring"
    assert track.length == pytest.approx(math.tau * RADIUS, rel=1e-5)
    assert track.curvature == pytest.approx(1 / RADIUS, rel=2e-3)
    assert (track.width_left, track.width_right) == (pytest.approx(4.0), pytest.approx(5.0))
    assert track.bank == pytest.approx(0.1)


def test_noise_of_the_survey_is_no_curvature(tmp_path: Path) -> None:
    """0.1 m at every 5 m would bend the line by up to some 0.02 1/m."""
    path = circle(tmp_path, noise=0.1)
    rough, smooth = (track_from_csv(path, noise=noise) for noise in (0.0, 0.1))
    assert np.abs(rough.curvature - 1 / RADIUS).max() > 0.01
    assert np.abs(smooth.curvature - 1 / RADIUS).max() < 0.002


def test_an_open_line_and_a_bad_file_are_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected a closed line of distinct points") as caught:
        track_from_csv(circle(tmp_path, turn=3.0))
    assert "\n" not in str(caught.value)
    with pytest.raises(CSVError, match="no column 'lean' in the header"):
        track_from_csv(circle(tmp_path), bank="lean")
