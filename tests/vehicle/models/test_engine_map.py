"""The engine map: interpolation, blending, monotonicity and its inverse."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from miho.vehicle.models import EngineMap, TorqueCubic, TorqueCurve

OPENINGS = np.array([0.0, 0.3, 0.5, 0.8, 1.0])
SPEEDS = np.linspace(100, 700, 25)
OMEGA_MAX = 700.0


def surface(omega: np.ndarray, throttle: np.ndarray | float) -> np.ndarray:
    """A smooth engine: braking grows with the speed, torque saturates in the throttle."""
    w = omega / OMEGA_MAX
    return 400 * np.sin(2.5 * w) * (1 - np.exp(-4 * np.asarray(throttle))) - 20 - 120 * w


def dyno(noise: float = 0.0, seed: int = 0) -> EngineMap:
    throttle, omega = (grid.ravel() for grid in np.meshgrid(OPENINGS, SPEEDS, indexing="ij"))
    torque = surface(omega, throttle)
    torque = torque + noise * np.random.default_rng(seed).standard_normal(torque.shape)
    return EngineMap.from_points(throttle, omega, torque)


def curve(throttle: float, valid: tuple[float, float] = (200.0, 600.0)) -> TorqueCurve:
    omega = np.linspace(*valid, 200)
    J = TorqueCubic(OMEGA_MAX).jacobian(np.zeros(4), omega)
    theta = np.linalg.lstsq(J, surface(omega, throttle))[0]
    return TorqueCurve(tuple(theta.tolist()), OMEGA_MAX, throttle, valid)


CURVES = [curve(throttle) for throttle in (0.05, 0.15, 0.2)]


def test_points_are_averaged_and_met() -> None:
    dyno_map = dyno()
    assert np.abs(dyno_map.correction).max() == 0
    np.testing.assert_allclose(dyno_map.table, surface(SPEEDS, OPENINGS[:, None]), rtol=1e-15)
    throttle, omega = (grid.ravel() for grid in np.meshgrid(OPENINGS, SPEEDS, indexing="ij"))
    torque = surface(omega, throttle)
    twice = EngineMap.from_points(
        np.tile(throttle, 2), np.tile(omega, 2), np.concatenate([torque - 3, torque + 3])
    )
    np.testing.assert_allclose(twice.table, dyno_map.table, rtol=1e-14, atol=1e-12)
    with pytest.raises(ValueError, match="no point at throttle 0 and 100 rad/s"):
        EngineMap.from_points(throttle[1:], omega[1:], torque[1:])


def test_it_is_bilinear() -> None:
    """SciPy's grid interpolation is the reference; 1e-10 is rounding of some 400 Nm."""
    engine = dyno(noise=2.0).integrate(CURVES)
    reference = RegularGridInterpolator((engine.openings, engine.speeds), engine.table)
    rng = np.random.default_rng(1)
    throttle, omega = rng.uniform(0, 1, 3000), rng.uniform(100, 700, 3000)
    expected = reference(np.stack([throttle, omega], axis=1))
    np.testing.assert_allclose(engine.torque(omega, throttle), expected, rtol=0, atol=1e-10)
    assert np.array_equal(engine.torque(SPEEDS, engine.openings[:, None]), engine.table)


def test_speeds_outside_are_held_and_openings_outside_refused() -> None:
    engine = dyno()
    assert np.array_equal(engine.torque([0.0, 900.0], 0.4), engine.torque([100.0, 700.0], 0.4))
    with pytest.raises(ValueError, match="expected 0 to 1"):
        engine.torque(300.0, [0.0, 1.1])
    with pytest.raises(ValueError, match="not finite"):
        engine.torque(np.nan, 0.5)


def test_learned_curves_rule_where_they_are_valid() -> None:
    """Exactly their torque at low throttle, at the table's speeds; elsewhere the dyno's."""
    engine, alone = dyno().integrate(CURVES), dyno()
    inside = (SPEEDS >= 200) & (SPEEDS <= 600)
    for learned_curve in CURVES:
        expected = learned_curve.torque(SPEEDS[inside])
        np.testing.assert_allclose(
            engine.torque(SPEEDS[inside], learned_curve.throttle), expected, atol=1e-9
        )
    row = engine.openings == 0.15
    assert (engine.learned[row][:, inside] == 1).all()
    above = OPENINGS >= 0.3
    np.testing.assert_array_equal(engine.table[engine.openings >= 0.3], alone.table[above])
    assert not engine.learned[engine.openings >= 0.3].any()


def test_the_map_is_nearer_to_the_engine_with_the_curves() -> None:
    """The dyno's line from 0 to 30 % misses by some 20 Nm, where the learned curves know better."""
    omega, throttle = np.meshgrid(np.linspace(200, 600, 41), np.linspace(0, 0.3, 31))
    true = surface(omega, throttle)
    alone, integrated = (
        float(np.sqrt(np.mean((engine.torque(omega, throttle) - true) ** 2)))
        for engine in (dyno(), dyno().integrate(CURVES))
    )
    assert alone > 15
    assert integrated < 4


def test_blending_is_smooth_and_extrapolates_nothing() -> None:
    """Outside its interval a curve's difference fades out over the reach, without a jump."""
    fine = np.linspace(100, 700, 601)
    throttle, omega = (grid.ravel() for grid in np.meshgrid(OPENINGS, fine, indexing="ij"))
    alone = EngineMap.from_points(throttle, omega, surface(omega, throttle))
    engine = alone.integrate([curve(0.15)], reach=80.0)
    row = int(np.searchsorted(engine.openings, 0.15))
    difference = engine.table[row] - alone.torque(fine, 0.15)
    np.testing.assert_array_equal(difference[(fine <= 120) | (fine >= 680)], 0)
    low, high = (float(curve(0.15).torque(np.array(v))) for v in (200.0, 600.0))
    assert difference[fine == 160] == pytest.approx((low - alone.torque(200.0, 0.15)) / 2)
    assert difference[fine == 640] == pytest.approx((high - alone.torque(600.0, 0.15)) / 2)
    assert np.abs(np.diff(difference)).max() < 0.03 * np.abs(difference).max()
    assert np.abs(np.diff(engine.learned[row])).max() < 0.02


def test_a_curve_where_the_dyno_is_good_shares_the_row() -> None:
    """At 30 %, half of the way from 20 to 40 %, both count the same."""
    engine = dyno().integrate([curve(0.2), curve(0.3), curve(0.5)])
    inside = (SPEEDS >= 200) & (SPEEDS <= 600)
    expected = (curve(0.3).torque(SPEEDS[inside]) + surface(SPEEDS[inside], 0.3)) / 2
    np.testing.assert_allclose(engine.torque(SPEEDS[inside], 0.3), expected, atol=1e-9)
    assert engine.learned.max(axis=1).tolist() == pytest.approx([0, 1, 0.5, 0, 0, 0], abs=1e-12)


def test_weak_dyno_rows_between_curves_give_way_to_them() -> None:
    """A dyno row at 15 % that is 30 Nm off: the map is as if it had not been measured.

    Closed form where both curves are valid. Beyond, 80 rad/s of reach are over after 80 rad/s.
    """
    openings = np.array([0.0, 0.15, 0.3, 0.5, 0.8, 1.0])
    throttle, omega = (grid.ravel() for grid in np.meshgrid(openings, SPEEDS, indexing="ij"))
    off = np.where(throttle == 0.15, 30.0, 0.0)
    alone = EngineMap.from_points(throttle, omega, surface(omega, throttle) + off)
    curves = [curve(0.2), curve(0.05)]
    engine = alone.integrate(curves, reach=80.0)
    inside = (SPEEDS >= 200) & (SPEEDS <= 600)
    high, low = (learned_curve.torque(SPEEDS[inside]) for learned_curve in curves)
    row = int(np.searchsorted(engine.openings, 0.15))
    np.testing.assert_allclose(engine.table[row][inside], (low + 2 * high) / 3, atol=1e-9)
    np.testing.assert_allclose(engine.learned[row][inside], 1, rtol=1e-12)
    without = dyno().integrate(curves, reach=80.0)
    np.testing.assert_allclose(
        engine.torque(SPEEDS[inside], 0.15), without.torque(SPEEDS[inside], 0.15), atol=1e-9
    )
    far = (SPEEDS < 120) | (SPEEDS > 680)
    assert not engine.learned[row][far].any()


def test_dyno_rows_above_the_fade_and_below_the_curves_stay() -> None:
    """The dyno is better at 30 % than the line from 5 to 50 %; below 5 % nothing was learned."""
    engine = dyno().integrate([curve(0.05), curve(0.5)])
    assert engine.openings.tolist() == [0.0, 0.05, 0.3, 0.5, 0.8, 1.0]
    assert engine.learned.max(axis=1).tolist() == [0, 1, 0, 0, 0, 0]
    assert np.array_equal(engine.table[engine.openings == 0.3], dyno().table[OPENINGS == 0.3])


def test_it_is_monotone_everywhere_and_says_what_that_took() -> None:
    """Noise of 40 Nm breaks the order of the rows; the mean of a column stays as it was."""
    raw = dyno(noise=40.0)
    engine = raw.integrate(CURVES)
    assert 10 < np.abs(raw.correction).max() < 200
    np.testing.assert_allclose(raw.correction.sum(axis=0), 0, atol=1e-9)
    measured, in_dyno_row = raw.table - raw.correction, np.isin(engine.openings, OPENINGS)
    np.testing.assert_allclose((engine.table - engine.correction)[in_dyno_row], measured, atol=1e-9)
    omega, throttle = np.linspace(50, 750, 301), np.linspace(0, 1, 501)[:, None]
    assert np.diff(engine.torque(omega, throttle), axis=0).min() > -1e-10
    with pytest.raises(ValueError, match="falls by up to 1 Nm"):
        falling = engine.table.copy()
        falling[2, 3] = falling[1, 3] - 1
        EngineMap(engine.openings, engine.speeds, falling, engine.learned, engine.correction)


def test_the_inverse_gives_the_torque_wherever_it_can_be_given() -> None:
    """Closed form, so to rounding; the brief need of a controller is 1 Nm."""
    engine = dyno(noise=40.0).integrate(CURVES)
    rng = np.random.default_rng(2)
    omega = rng.uniform(50, 750, (100, 200))
    low, high = engine.limits(omega)
    torque = low + (high - low) * rng.uniform(0, 1, omega.shape)
    opening, residual = engine.throttle(omega, torque)
    assert residual.max() < 1e-9
    assert ((opening >= 0) & (opening <= 1)).all()


def test_the_inverse_picks_the_smallest_opening() -> None:
    table = np.array([[-50.0, -80.0], [100.0, 90.0], [100.0, 90.0], [100.0, 120.0]])
    nothing = np.zeros_like(table)
    flat = EngineMap(
        np.array([0, 0.4, 0.8, 1.0]), np.array([100.0, 200.0]), table, nothing, nothing
    )
    opening, residual = flat.throttle([100.0, 200.0, 200.0, 100.0], [100.0, 90.0, 105.0, 25.0])
    assert opening.tolist() == pytest.approx([0.4, 0.4, 0.9, 0.2], rel=1e-14)
    assert residual.max() < 1e-12
    just_less = flat.throttle(100.0, 100.0 - 1e-9).opening
    assert 0.4 - 1e-9 < just_less <= 0.4


def test_the_inverse_saturates_and_reports_what_is_missing() -> None:
    engine = dyno()
    low, high = engine.limits(400.0)
    opening, residual = engine.throttle(400.0, [float(low) - 30, float(high) + 12])
    assert opening.tolist() == [0, 1]
    assert residual.tolist() == pytest.approx([30, 12], rel=1e-12)
    with pytest.raises(ValueError, match="not finite"):
        engine.throttle(400.0, np.nan)


def test_settings_and_tables_that_make_no_map_are_refused() -> None:
    engine = dyno()
    parts = (engine.openings, engine.speeds, engine.table, engine.learned, engine.correction)
    for index, wrong, message in (
        (0, engine.openings * 100, "openings 0.0 to 100.0"),
        (1, engine.speeds[::-1], "expected rising numbers"),
        (2, engine.table[:, :-1], "table of the engine map has shape"),
        (3, engine.learned * np.nan, "learned of the engine map: expected finite"),
    ):
        changed = [*parts[:index], wrong, *parts[index + 1 :]]
        with pytest.raises(ValueError, match=message):
            EngineMap(*changed)
    with pytest.raises(ValueError, match="expected one curve each"):
        engine.integrate([curve(0.15), curve(0.15)])
    with pytest.raises(ValueError, match="the lower opening first"):
        engine.integrate(CURVES, fade=(0.4, 0.2))
