"""The road of the plant against the track it is made of."""

import numpy as np
import pytest

from miho.vehicle.driving.ovals import lvms
from miho.vehicle.driving.road import PLANE, place_at, road_of, shape_at


def test_a_road_is_where_its_track_is() -> None:
    track = lvms()
    road = road_of(track)
    rng = np.random.default_rng(0)
    for s, e in zip(rng.uniform(-500, 8000, 200), rng.uniform(-5, 5, 200), strict=True):
        x, y, heading = place_at(road, s, e)
        point = track.at(s)
        expected = track.position(s, e)
        np.testing.assert_allclose([x, y], [float(expected[0]), float(expected[1])], atol=1e-9)
        assert heading == pytest.approx(float(point.heading), abs=1e-12)
        _, bank = shape_at(road, s)
        assert bank == pytest.approx(float(point.bank), abs=1e-12)


def test_its_curvature_is_the_slope_of_its_heading() -> None:
    track = lvms()
    road = road_of(track)
    total = sum(shape_at(road, s + road.step / 2)[0] for s in track.s) * road.step
    assert total == pytest.approx(2 * np.pi, rel=1e-12)
    assert np.abs(road.curvature - track.curvature).max() < 1e-3


def test_a_plane_has_no_end() -> None:
    assert place_at(PLANE, 1234.5, -6.0) == pytest.approx((1234.5, -6.0, 0.0))
    assert place_at(PLANE, -77.0, 2.0) == pytest.approx((-77.0, 2.0, 0.0))
    assert shape_at(PLANE, 50.0) == (0.0, 0.0)
