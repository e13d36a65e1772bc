"""What is counted of a drive, on drives that are written by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from experiments.driving.outcome import excess, speed_bands
from miho.vehicle.driving.simulation import LOGGED, Drive

N = 400


def drive(**columns: np.ndarray) -> Drive:
    """Four seconds at 100 Hz; what is not given is zero."""
    time = np.linspace(5.0, 5.0 + 0.01 * (N - 1), N)
    logged = dict.fromkeys(LOGGED, np.zeros(N)) | {"time": time} | columns
    return Drive(logged, {}, "")


def test_an_excess_is_said_in_words() -> None:
    use = np.full(N, 0.9)
    assert excess(drive(), use) is None
    use[100:120] = 1.05
    use[300:310] = 1.123
    beyond = excess(drive(distance=np.linspace(0.0, 100.0, N)), use)
    assert beyond is not None
    assert beyond.duration == pytest.approx(0.30)
    assert str(beyond) == "for 0.30 s, first after 25 m and 1.0 s, by up to 12 %"


def test_a_use_at_the_limit_is_no_excess() -> None:
    assert excess(drive(), np.ones(N)) is None


def test_errors_are_counted_in_the_bands_of_the_paper() -> None:
    """A quarter of the drive each at 30, 41, 45 and 60 m/s, with its own error."""
    vx = np.repeat([30.0, 41.0, 45.0, 60.0], N // 4)
    error = np.repeat([0.1, -0.2, 0.4, -0.8], N // 4)
    throttle = np.repeat([0.2, 0.3, 0.5, 0.7], N // 4)
    rows = speed_bands(drive(vx=vx, v_des=vx - error, u_throttle=throttle))
    bands = {row.pop("band"): row for row in rows}
    assert list(bands) == ["all", "up to 144 km/h", "above 144 km/h", "151 to 187 km/h"]
    middle = bands["151 to 187 km/h"]
    assert middle["time [s]"] == pytest.approx(1.0)
    assert middle["RMS error [m/s]"] == middle["mean error [m/s]"] == pytest.approx(0.4)
    assert middle["time above 40 % throttle [%]"] == 100
    above = bands["above 144 km/h"]
    rms = math.sqrt((0.2**2 + 0.4**2 + 0.8**2) / 3)
    assert above["RMS error [m/s]"] == pytest.approx(rms, rel=1e-3), "four digits"
    assert above["mean error [m/s]"] == pytest.approx(-0.2)
    assert above["largest error [m/s]"] == pytest.approx(0.8)
    assert above["mean throttle [%]"] == pytest.approx(50.0)
    assert above["time above 40 % throttle [%]"] == pytest.approx(66.67)
    assert bands["up to 144 km/h"]["time [s]"] == pytest.approx(1.0)


def test_a_band_that_was_not_driven_in_has_no_row() -> None:
    rows = speed_bands(drive(vx=np.full(N, 30.0), v_des=np.full(N, 30.0)))
    assert [row["band"] for row in rows] == ["all", "up to 144 km/h"]
