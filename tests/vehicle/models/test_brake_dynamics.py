"""Delay, lag and play of brake pressure, against closed forms and a general ODE solver."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from miho.quantities import Array
from miho.testing import check_model
from miho.vehicle.models import BrakeResponse, play


def uneven_record() -> tuple[Array, Array]:
    """Uneven samples, targets that rise, fall, repeat, and change faster than the lag settles."""
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.004, 0.02, 120)) + 1e3
    target = np.repeat(rng.uniform(0, 5e6, 12), 10)
    target[60:80] = target[60]
    return t, target


def test_one_step_in_closed_form() -> None:
    t = np.linspace(0.0, 1.99, 200)
    target = np.where(t > 0.495, 4e6, 1e6)
    delay, rise = 0.033, 0.1
    p = BrakeResponse().predict(np.array([[delay, rise, 0.02]]), t, target)[0]
    since = np.maximum(t - 0.5 - delay, 0)
    np.testing.assert_allclose(p, 4e6 - 3e6 * np.exp(-since / rise), rtol=1e-12)


def test_against_an_ode_solver() -> None:
    """The solver integrates each constant piece on its own, to a relative 1e-9."""
    t, target = uneven_record()
    delay, rise, fall = 0.0137, 0.05, 0.02
    p = BrakeResponse().predict(np.array([[delay, rise, fall]]), t, target)[0]
    state, at, expected = target[0], t[0], []
    changes = list(zip(t + delay, target, strict=True))
    level = target[0]
    for now in t:
        while changes and changes[0][0] <= now:
            then, next_level = changes.pop(0)
            state, at, level = integrated(state, at, then, level, rise, fall), then, next_level
        expected.append(integrated(state, at, now, level, rise, fall))
    np.testing.assert_allclose(p, expected, rtol=1e-7)


def integrated(p: float, start: float, end: float, level: float, rise: float, fall: float) -> float:
    if end <= start:
        return p

    def rate(_: float, y: Array) -> Array:
        return np.asarray((level - y) / np.where(level > y, rise, fall))

    return float(solve_ivp(rate, (start, end), [p], rtol=1e-9, atol=1e-3).y[0, -1])


def test_the_model_keeps_its_contract() -> None:
    """Delays fall between the samples, where the response has its derivatives."""
    t, target = uneven_record()
    thetas = np.array([[0.0137, 0.05, 0.02], [0.1, 0.02, 0.2], [0.0004, 0.3, 0.3]])
    check_model(BrakeResponse(), thetas, t, target)


def test_rows_between_changes_only_sample_the_response() -> None:
    t, target = uneven_record()
    theta = np.array([[0.0137, 0.05, 0.02]])
    whole = BrakeResponse().predict(theta, t, target)[0]
    fine = np.sort(np.concatenate([t, t[:-1] + 0.3 * np.diff(t)]))
    held = target[np.searchsorted(t, fine, side="right") - 1]
    again = BrakeResponse().predict(theta, fine, held)[0]
    np.testing.assert_allclose(again[np.isin(fine, t)], whole, rtol=1e-12)


def test_rows_out_of_order_are_refused() -> None:
    with pytest.raises(ValueError, match="t does not increase"):
        BrakeResponse().predict(np.array([[0.0, 0.1, 0.1]]), np.array([0.0, 0.2, 0.1]), np.ones(3))


def test_play_is_a_loop_of_its_width() -> None:
    ramp = np.concatenate([np.arange(0, 11), np.arange(9, -1, -1), np.arange(1, 11)]).astype(float)
    output = play(ramp, 4.0)
    assert output[:11].tolist() == [0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8]
    assert output[11:21].tolist() == [8, 8, 8, 8, 7, 6, 5, 4, 3, 2]
    assert output[21:25].tolist() == [2, 2, 2, 2]
    assert np.array_equal(play(ramp, 0.0), ramp)


def test_play_forgets_loops_inside_and_the_rate() -> None:
    """Its state depends on the turning points alone, and a small loop inside leaves no trace."""
    rng = np.random.default_rng(0)
    values = rng.uniform(0, 10, 50)
    halves = (values[:-1] + values[1:]) / 2
    slower = np.append(np.column_stack([values[:-1], halves]).ravel(), values[-1])
    assert np.array_equal(play(slower, 3.0)[::2], play(values, 3.0))
    assert play(np.array([0, 8, 4, 6, 4, 2.0]), 3.0)[-1] == play(np.array([0, 8, 2.0]), 3.0)[-1]


def test_play_refuses_a_negative_width() -> None:
    with pytest.raises(ValueError, match=r"width is -1\.0"):
        play(np.zeros(2), -1.0)
