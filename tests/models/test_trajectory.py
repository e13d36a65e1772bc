"""Motions given by their right-hand side, against closed forms, published values and SciPy."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import miho
from miho.identification import make_report
from miho.models import Trajectory, load_trajectory
from miho.models.joint import rows_of_parts
from miho.testing import check_model

Array = NDArray[np.float64]

T = np.linspace(0.0, 4.0, 201)


def oscillator(x: Any, v: Any, *, k: Any, c: Any, m: float = 2.0) -> tuple[Any, Any]:
    return v, -(k * x + c * v) / m


def oscillation(t: Array, theta: Any) -> Any:
    """The damped oscillation from (x_0, 0) with the mass 2, at any parameters, complex ones too."""
    k, c, x0 = theta
    decay = c / 4
    omega = np.sqrt(k / 2 - decay**2)
    return x0 * np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))


def motor(i: Any, w: Any, u: Any, *, R: Any, L: Any, K: Any, J: Any, b: Any) -> tuple[Any, Any]:
    """A DC motor: L i' = u - R i - K w, J w' = K i - b w."""
    return (u - R * i - K * w) / L, (K * i - b * w) / J


def spin_up(t: Array, theta: Any, u: float = 12.0) -> Any:
    """The motor's speed after a step of the voltage, from the two eigenvalues of its matrix."""
    R, L, K, J, b = theta
    half, product = -(R / L + b / J) / 2, (R * b + K * K) / (L * J)
    root = np.sqrt(half**2 - product)
    fast, slow = half - root, half + root
    final = K * u / (R * b + K * K)
    return final * (1 + (slow * np.exp(fast * t) - fast * np.exp(slow * t)) / (fast - slow))


def by_complex_steps(f: Callable[[Array, Any], Any], t: Array, theta: Array) -> Array:
    """Derivatives of a closed form without subtraction (Squire and Trapp 1998)."""
    moved = theta + 1e-30j * np.eye(theta.size)
    return np.column_stack([np.imag(f(t, row)) / 1e-30 for row in moved])


OSCILLATOR = Trajectory(oscillator, {"x": "identified", "v": 0.0}, ["x"], substeps=10)
MOTOR = Trajectory(motor, {"i": 0.0, "w": 0.0}, ["w"], substeps=60)
MOTOR_TRUE = np.array([2.0, 0.5, 0.1, 0.02, 0.01])


@pytest.mark.slow
def test_a_rate_that_is_switched_is_its_closed_form() -> None:
    """RK4 at 20 ms leaves h^4 times a few 1e-2 of a decay at 1 to 3 per second."""

    def cooled(x: Any, fan: Any, *, still: Any, blown: Any) -> Any:
        return -np.where(fan > 0.5, blown, still) * x

    def cooling(t: Array, theta: Any) -> Any:
        still, blown = theta
        return np.exp(-(still * np.minimum(t, 2.0) + blown * np.maximum(t - 2.0, 0.0)))

    model = Trajectory(cooled, {"x": 1.0}, ["x"], interpolation="hold")
    theta, fan = np.array([0.7, 2.9]), (np.arange(T.size) >= 100).astype(float)
    np.testing.assert_allclose(
        model.predict(theta[None], T, fan)[0], cooling(T, theta), rtol=0, atol=1e-8
    )
    exact = by_complex_steps(cooling, T, theta)
    np.testing.assert_allclose(model.jacobian(theta, T, fan), exact, rtol=0, atol=1e-7)


@pytest.mark.parametrize("traced", [True, False])
def test_a_damped_oscillator_is_its_closed_form(traced: bool) -> None:
    """RK4 at 5 ms is within 1e-9 of it, h^4 times some 100 rad/s."""
    model = OSCILLATOR if traced else untraced(OSCILLATOR)
    theta = np.array([40.0, 1.5, 0.3])
    assert list(model.parameters) == ["k", "c", "x_0"]
    np.testing.assert_allclose(model.predict(theta[None], T)[0], oscillation(T, theta), atol=1e-9)
    exact = by_complex_steps(oscillation, T, theta)
    off = np.abs(model.jacobian(theta, T) - exact).max(axis=0) / np.abs(exact).max(axis=0)
    assert off.max() < 1e-6


def untraced(model: Trajectory) -> Trajectory:
    """The same with a right-hand side that branches on its values: NumPy, one row at a time."""
    inner = model.rhs

    def branching(x: Any, v: Any, *, k: Any, c: Any) -> Any:
        return inner(x, v, k=k, c=c) if x > -1e9 else (0.0, 0.0)

    other = replace(model, rhs=branching)
    assert not other.equations.traced
    return other


def test_a_branching_right_hand_side_has_derivatives_at_any_scale() -> None:
    """Concentrations in mol/l, of picomoles: (V, K) of an enzyme, and its product from 0."""

    def traced(c: Any, p: Any, *, V: Any, K: Any) -> Any:
        rate = V * c / (K + c + p)
        return -rate, rate

    def branching(c: Any, p: Any, *, V: Any, K: Any) -> Any:
        return traced(c, p, V=V, K=K) if c < 1e300 else (0.0, 0.0)

    theta, t = np.array([0.4e-12, 0.5e-12]), np.linspace(0.0, 4.0, 21)
    start = {"c": 2e-12, "p": 0.0}
    exact, by_differences = (
        Trajectory(rhs, start, ["p"]).jacobian(theta, t) for rhs in (traced, branching)
    )
    np.testing.assert_allclose(by_differences, exact, rtol=1e-6, atol=1e-9 * np.abs(exact).max())


def test_a_vanishing_state_has_slopes_in_rates_that_hardly_see_it() -> None:
    def traced(a: Any, b: Any, *, k: Any) -> Any:
        return -k * a, 1.0 + k * a - b

    def branching(a: Any, b: Any, *, k: Any) -> Any:
        return traced(a, b, k=k) if a < 1e300 else (0.0, 0.0)

    theta, t = np.array([2.0, 1e-17]), np.linspace(0.0, 4.0, 21)
    start = {"a": "identified", "b": 1.0}
    exact, by_differences = (
        Trajectory(rhs, start, ["b"]).jacobian(theta, t) for rhs in (traced, branching)
    )
    np.testing.assert_allclose(by_differences, exact, rtol=1e-4, atol=1e-6)


@pytest.mark.slow
def test_a_motor_that_is_driven_is_its_closed_form() -> None:
    """RK4 at a third of a millisecond."""
    u = np.full(T.size, 12.0)
    speed = MOTOR.predict(MOTOR_TRUE[None], T, u)[0]
    np.testing.assert_allclose(speed, np.real(spin_up(T, MOTOR_TRUE)), atol=1e-9 * 100)
    exact = by_complex_steps(spin_up, T, MOTOR_TRUE)
    off = np.abs(MOTOR.jacobian(MOTOR_TRUE, T, u) - exact).max(axis=0) / np.abs(exact).max(axis=0)
    assert off.max() < 1e-6


def lotka_volterra(h: Any, l: Any, *, a: Any, b: Any, c: Any, d: Any) -> list[Any]:  # noqa: E741
    return [a * h - b * h * l, d * h * l - c * l]


@pytest.mark.slow
def test_predator_and_prey_keep_their_invariant() -> None:
    """d h - c ln h + b l - a ln l is constant along every orbit."""
    t, theta = np.linspace(0, 20, 401), np.array([0.55, 0.028, 0.84, 0.026])
    start = {"h": 33.956, "l": 5.933}
    h, lynx = (
        Trajectory(lotka_volterra, start, [name], substeps=4).predict(theta[None], t)[0]
        for name in start
    )
    a, b, c, d = theta
    invariant = d * h - c * np.log(h) + b * lynx - a * np.log(lynx)
    np.testing.assert_allclose(invariant, invariant[0], rtol=1e-8)
    assert np.ptp(h) > 50, "hares: it goes around"


def reference(rates: Callable[..., Any], t: Array, start: list[float], theta: Array) -> Array:
    """The states (S, N) by SciPy's method of order 8 at 1e-13."""
    solution = solve_ivp(
        lambda _, z: rates(*z, *theta), (t[0], t[-1]), start, "DOP853", t, rtol=1e-13, atol=1e-16
    )
    return np.asarray(solution.y)


def by_differences(f: Callable[[Array], Array], theta: Array) -> Array:
    """Derivatives (..., d) by differences of sixth order with steps of a thousandth."""
    columns = []
    for k in range(theta.size):
        h = 1e-3 * theta[k] * (np.arange(theta.size) == k)
        ahead = [f(theta + s * h) - f(theta - s * h) for s in (1, 2, 3)]
        columns.append((45 * ahead[0] - 9 * ahead[1] + ahead[2]) / (60 * h[k]))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("solver", [pytest.param("RK4", marks=pytest.mark.slow), "Radau", "LSODA"])
def test_sensitivities_are_those_of_an_independent_integration(solver: str) -> None:
    t, theta = np.linspace(0, 8, 81), np.array([0.55, 0.028, 0.84, 0.026])
    model = Trajectory(lotka_volterra, {"h": 34.0, "l": 6.0}, ["l"], solver=solver, substeps=20)

    def lynx(theta: Array) -> Array:
        a, b, c, d = theta
        rates = lambda h, l, *_: lotka_volterra(h, l, a=a, b=b, c=c, d=d)  # noqa: E731, E741
        return reference(rates, t, [34.0, 6.0], theta)[1]

    np.testing.assert_allclose(model.predict(theta[None], t)[0], lynx(theta), rtol=1e-6)
    exact = by_differences(lynx, theta)
    off = np.abs(model.jacobian(theta, t) - exact).max(axis=0) / np.abs(exact).max(axis=0)
    assert off.max() < 1e-6


def robertson(y1: Any, y2: Any, y3: Any, *, k1: Any, k2: Any, k3: Any) -> tuple[Any, Any, Any]:
    slow, fast, back = k1 * y1, k2 * y2 * y2, k3 * y2 * y3
    return back - slow, slow - back - fast, fast


def scaled(y1: Any, y2: Any, y3: Any) -> Any:
    return 1e4 * y2


ROBERTSON = Trajectory(
    robertson, {"y1": 1.0, "y2": 0.0, "y3": 0.0}, ["y1", scaled, "y3"], solver="Radau"
)


ROBERTSON_TRUE = np.array([0.04, 3e7, 1e4])


@pytest.mark.parametrize("solver", ["Radau", "BDF", "LSODA"])
def test_robertsons_reaction_has_its_published_values(solver: str) -> None:
    """t = 40: the reference solution of ROBER in the test set for IVP solvers (Mazzia and
    Magherini 2008); t = 4 and 400: the documentation of LSODE (Hindmarsh 1983), whose own relative
    error is 1e-4."""
    t = np.array([0.0, 4.0, 40.0, 400.0])
    rows, index = np.repeat(t, 3), np.tile(np.arange(3.0), t.size)
    model = replace(ROBERTSON, solver=solver)
    y = model.predict(ROBERTSON_TRUE[None], rows, index)[0].reshape(-1, 3)
    np.testing.assert_allclose(y[1], [0.9055142, 0.2240418, 0.09446344], rtol=1e-4)
    np.testing.assert_allclose(y[2], [0.7158270687, 0.09185534765, 0.2841637457], rtol=1e-6)
    np.testing.assert_allclose(y[3], [0.4504846, 0.03222434, 0.5495122], rtol=2e-4)


def test_sensitivities_of_robertsons_reaction() -> None:
    """Up to t = 0.4 an explicit method can still follow it."""
    t = np.array([0.0, 0.1, 0.4])

    def slow(theta: Array) -> Array:
        rates = lambda y1, y2, y3, *k: robertson(  # noqa: E731
            y1, y2, y3, k1=k[0], k2=k[1], k3=k[2]
        )
        return reference(rates, t, [1.0, 0.0, 0.0], theta)[0]

    exact = by_differences(slow, ROBERTSON_TRUE)
    own = ROBERTSON.jacobian(ROBERTSON_TRUE, t, np.zeros(3))
    assert (np.abs(own - exact).max(axis=0) < 1e-6 * np.abs(exact).max(axis=0)).all()


# One motion, begun in all ways.

DRIVEN = Trajectory(
    lambda x, force, *, k: force - k * x, {"x": "measured"}, ["x"], name="lag", substeps=2
)
"""x' = force - k x."""
ROWS = np.linspace(0.0, 3.0, 31)
FORCE = np.sin(5 * ROWS)
NOISY = np.cos(3 * ROWS)
"""What was measured of x, which is no solution."""


def lag(model: Trajectory, *columns: Array, k: float = 1.7) -> Array:
    return np.asarray(model.predict(np.array([[k]]), ROWS, FORCE, *columns)[0])


@pytest.mark.slow
def test_one_step_starts_at_the_measured_state_of_the_row_before() -> None:
    free = replace(DRIVEN, restart=None)
    steps = lag(replace(DRIVEN, restart=1), NOISY)
    assert steps[0] == NOISY[0]
    for j in (1, 7, 30):
        pair = [column[j - 1 : j + 1] for column in (ROWS, FORCE, NOISY)]
        assert steps[j] == pytest.approx(free.predict(np.array([[1.7]]), *pair)[0, 1], rel=1e-12)


def test_segments_of_rows_start_at_measured_states_and_predict_the_next_start() -> None:
    tens, free = lag(replace(DRIVEN, restart=10), NOISY), lag(DRIVEN, NOISY)
    np.testing.assert_array_equal(tens[:11], free[:11])
    later = [column[10:21] for column in (ROWS, FORCE, NOISY)]
    alone = DRIVEN.predict(np.array([[1.7]]), *later)[0]
    np.testing.assert_allclose(tens[11:21], alone[1:], rtol=1e-12)


@pytest.mark.slow
def test_segments_start_at_states_of_their_own() -> None:
    model = replace(DRIVEN, states={"x": "identified"}, segments=3)
    assert list(model.parameters) == ["k", "x_0", "x_1", "x_2"]
    theta = np.array([1.7, 0.5, -1.0, 2.0])
    y = model.predict(theta[None], ROWS, FORCE)[0]
    for m, start in enumerate((0, 10, 20)):
        assert y[start] == theta[1 + m]
    J = model.jacobian(theta, ROWS, FORCE)
    assert (J[10:20, [1, 3]] == 0).all()
    # x_p of the start decays as exp(-k t): the classical method at 50 ms is within 1e-7 of it.
    np.testing.assert_allclose(J[10:20, 2], np.exp(-1.7 * ROWS[:10]), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("start", [{"restart": 4}, {"segments": 3, "states": {"x": "identified"}}])
def test_all_solvers_go_the_same_way(start: dict[str, Any]) -> None:
    """Compiled, in NumPy with a right-hand side that branches, and SciPy's at 1e-8."""
    model = replace(DRIVEN, substeps=10, **start)
    branching = replace(model, rhs=lambda x, force, *, k: force - k * x if k < 9 else force)
    others = branching, replace(model, solver="Radau"), replace(model, solver="LSODA")
    columns = (ROWS, FORCE, NOISY)[: len(model.inputs)]
    theta = np.array([1.7, 0.5, -1.0, 2.0])[: len(model.parameters)]
    values, slopes = model.predict(theta[None], *columns), model.jacobian(theta, *columns)
    for other in others:
        assert other._taped is None
        np.testing.assert_allclose(other.predict(theta[None], *columns), values, atol=1e-6)
        np.testing.assert_allclose(other.jacobian(theta, *columns), slopes, atol=1e-6)


def test_inputs_are_straight_between_rows_or_held() -> None:
    """x' = force from 0: the trapezoidal sum, or the sum of the earlier rows; k = 0."""
    dt = np.diff(ROWS)
    straight = np.append(0, np.cumsum(dt * (FORCE[1:] + FORCE[:-1]) / 2))
    held = np.append(0, np.cumsum(dt * FORCE[:-1]))
    start = np.zeros(ROWS.size)
    for solver, tolerance in (("RK4", 1e-12), ("Radau", 1e-6)):
        for interpolation, expected in (("linear", straight), ("hold", held)):
            model = replace(DRIVEN, solver=solver, interpolation=interpolation)
            np.testing.assert_allclose(lag(model, start, k=0.0), expected, atol=tolerance)


@pytest.mark.slow
def test_several_outputs_stand_below_each_other_at_times_of_their_own() -> None:
    """The first at every row, the second at every third, a unit's worth each."""
    model = Trajectory(oscillator, {"x": 0.4, "v": 0.0}, ["x", "v"], scales=(0.1, 2.0), substeps=10)
    assert (list(model.inputs), model.output) == (["t", "output"], "-")
    t = np.concatenate([T, T[::3]])
    index = np.concatenate([np.zeros(T.size), np.ones(T[::3].size)])
    theta = np.array([40.0, 1.5])
    y = model.predict(theta[None], t, index)[0]
    full = np.append(theta, 0.4)
    np.testing.assert_allclose(0.1 * y[: T.size], oscillation(T, full), atol=1e-9)
    speed = np.imag(oscillation(T[::3] + 1e-30j, full)) / 1e-30
    np.testing.assert_allclose(2.0 * y[T.size :], speed, atol=1e-8)
    shuffled = np.argsort(t, kind="stable")
    np.testing.assert_array_equal(model.predict(theta[None], t[shuffled], index[shuffled])[0],
                                  y[shuffled])  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["RK4", "Radau"])
def test_what_fails_or_diverges_is_nan_without_a_word(
    solver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """x' = k x^2 from 1 is infinite at t = 1 / k: a stiff solver ends there for want of a step, or
    before for want of calls."""
    for rhs, calls in (
        (lambda x, *, k: k * x * x, 100_000),
        (lambda x, *, k: k * x * x if x < 1e300 else 1 / 0, 2000),
    ):
        monkeypatch.setattr("miho.models.integration.MOST_CALLS", calls)
        model = Trajectory(rhs, {"x": 1.0}, ["x"], solver=solver, name="explosion")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            slow, fast = model.predict(np.array([[0.1], [2.0]]), T)
            slopes = model.jacobian(np.array([2.0]), T)
        np.testing.assert_allclose(slow, 1 / (1 - 0.1 * T), rtol=1e-6)
        assert np.isnan(fast[100:]).all()
        assert not np.isfinite(slopes[100:]).any()


def test_batches_derivatives_and_pickles() -> None:
    thetas = np.array([40.0, 1.5, 0.3]) * np.random.default_rng(0).uniform(0.8, 1.2, (37, 3))
    check_model(OSCILLATOR, thetas[:18], T)
    copy = pickle.loads(pickle.dumps(OSCILLATOR))
    np.testing.assert_array_equal(copy.predict(thetas, T), OSCILLATOR.predict(thetas, T))


def test_a_step_that_is_too_long_is_told_with_what_to_set() -> None:
    """A change of sigma over sqrt(N) in all rows is one standard error of their mean."""
    theta, coarse = np.array([400.0, 1.5, 0.3]), replace(OSCILLATOR, substeps=1)
    (remark,) = coarse.remarks(theta, 1e-6, T)
    needed = int(remark.split("substeps to ")[1].split(",")[0])
    assert replace(coarse, substeps=needed).remarks(theta, 1e-6, T) == []
    assert replace(coarse, substeps=needed // 2).remarks(theta, 1e-6, T) != []
    assert coarse.remarks(theta, 1e-16, T) == []  # data of the model itself


def test_the_report_tells_of_a_step_that_is_too_long() -> None:
    """Nine steps a period: the optimum moves to make up for it."""
    t = np.linspace(0, 4, 41)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(t.size)
    x = oscillation(t, np.array([100.0, 1.5, 0.3])) + noise
    data = miho.Dataset("swing", {"t": t, "x": x}, {"t": "-", "x": "-"}, "x")
    ranges = {"k": (90, 110), "c": (1, 2), "x_0": (0.2, 0.4)}
    space = miho.Space(tuple(miho.Parameter(name, "-", *ends) for name, ends in ranges.items()))
    for substeps, told in ((1, True), (10, False)):
        model = replace(OSCILLATOR, substeps=substeps, units={"t": "-"})
        problem = miho.CurveFit(model, data, space)
        record = miho.minimize(miho.MIHOGN(), problem, seed=0)
        notes = make_report(problem, record.theta, descents=record.descents).notes
        assert any("half the time step" in note for note in notes) == told


def test_fits_and_parts_tell_of_a_step_that_is_too_long() -> None:
    """Nine steps a period, with a sigma of each row; a second part has shorter steps."""
    t = np.linspace(0, 4, 41)
    sigma = np.full(t.size, 1e-3)
    x = oscillation(t, np.array([100.0, 1.5, 0.3]))
    x += sigma * np.random.default_rng(0).standard_normal(t.size)
    ranges = {"k": (90, 110), "c": (1, 2), "x_0": (0.2, 0.4)}
    coarse = replace(OSCILLATOR, substeps=1, units={"t": "-"})
    told = "half the time step moves the optimum by up to"
    fit = miho.fit(coarse, t, x, ranges, sigma=sigma)
    assert [caveat for caveat in fit.caveats if told in caveat] == coarse.remarks(
        fit.theta, 1e-3, t
    )
    few = miho.fit(coarse, t, x, ranges, budget=miho.Budget(evaluations=3))
    assert any("in doubt" in note for note in few.report().notes)
    assert any(told in note for note in few.report().notes)
    parts = {"coarse": (coarse, t, x, sigma), "fine": (replace(coarse, substeps=10), t, x, sigma)}
    joint = miho.fit_joint(parts, ranges)
    (caveat,) = (caveat for caveat in joint.caveats if told in caveat)
    assert caveat.startswith("coarse: half the time step")
    assert caveat in joint.report(profiles=False).notes
    assert caveat in joint.part("coarse").caveats
    assert caveat not in joint.part("fine").caveats


def test_an_exact_part_of_a_joint_fit_has_no_remark_on_its_step() -> None:
    """Its residuals are rounding, and so is the sigma that they give."""
    t = np.linspace(0, 4, 41)
    coarse = replace(OSCILLATOR, substeps=1, units={"t": "-"})
    exact = coarse.predict(np.array([[100.0, 1.5, 0.3]]), t)[0]
    noisy = exact + 1e-3 * np.random.default_rng(0).standard_normal(t.size)
    ranges = {"k": (90, 110), "c": (1, 2), "x_0": (0.2, 0.4)}
    fit = miho.fit_joint({"exact": (coarse, t, exact), "noisy": (coarse, t, noisy)}, ranges)
    assert fit.values["k"] == pytest.approx(100, rel=1e-9)
    assert not [caveat for caveat in fit.caveats if caveat.startswith("exact: ")]


def test_a_part_of_a_joint_fit_may_diverge_far_from_the_optimum() -> None:
    """An explicit step of 0.1 s diverges for |k| > 28/s."""
    decay = Trajectory(lambda x, *, k: -k * x, {"x": 1.0}, ["x"])
    t = np.linspace(0, 20, 201)
    x = np.exp(-2 * t) + 1e-3 * np.random.default_rng(0).standard_normal(t.size)
    fit = miho.fit_joint({"a": (decay, t, x), "b": (decay, t[:100], x[:100])}, {"k": (0.1, 10)})
    np.testing.assert_allclose(fit.part("b").predict(t[:3]).value, np.exp(-2 * t[:3]), atol=0.01)
    with pytest.raises(
        ValueError, match="in any trial of the space; change the bounds or the start, take"
    ):
        miho.fit(decay, t, x, {"k": (300, 400)})


def test_a_prediction_takes_steps_as_short_as_the_data_and_starts_where_they_start() -> None:
    t = np.linspace(1, 6, 51)
    decay = Trajectory(lambda x, *, k: -k * x, {"x": 1.0}, ["x"])
    fit = miho.fit(decay, t, np.exp(-2 * (t - 1)), {"k": (0.1, 10)})
    for times in ([1, 6, 11], [5, 7], [4]):
        value = fit.predict(times).value
        np.testing.assert_allclose(value, np.exp(-2 * (np.array(times) - 1)), rtol=1e-4)
    with pytest.raises(ValueError, match="t is 0, before the start of the motion at 1"):
        fit.predict([0, 2])
    with pytest.raises(ValueError, match=r"1e\+09 steps of the longest in the data; expected at m"):
        fit.predict([1e8])


@pytest.mark.parametrize("interpolation", ["linear", "hold"])
def test_a_prediction_has_the_inputs_between_its_rows(interpolation: str) -> None:
    t = np.linspace(0, 6, 61)
    model = Trajectory(lambda x, u, *, k: u - k * x, {"x": 1.0}, ["x"], interpolation=interpolation)
    u = np.interp(t, t[::20], [0, 3, 1, 2])
    if interpolation == "hold":
        u = np.repeat([0, 3, 1, 2.0], 20)[:61]
    fit = miho.fit(model, (t, u), model.predict(np.array([[2.0]]), t, u)[0], {"k": (0.1, 10)})
    every, some = fit.predict((t, u)).value, fit.predict((t[::20], u[::20])).value
    np.testing.assert_allclose(some, every[::20], rtol=1e-9)
    measured = replace(model, states={"x": "measured"})
    fit = miho.fit(measured, {"t": t, "u": u, "x": every}, "x", {"k": (0.1, 10)})
    some = fit.predict({"t": t[::20], "u": u[::20], "x": every[::20]}).value
    np.testing.assert_allclose(some, every[::20], rtol=1e-9)
    several = replace(model, outputs=["x", lambda x, u: u - x])
    t, u, output = np.tile(t, 2), np.tile(u, 2), np.repeat([0, 1], t.size)
    columns = {"t": t, "u": u, "output": output}
    y = several.predict(np.array([[2.0]]), *columns.values())[0]
    fit = miho.fit(several, columns, y, {"k": (0.1, 10)})
    few = np.flatnonzero(np.isin(np.arange(t.size) % 61, np.arange(0, 61, 20)))
    for rows in (few, few[[4, 0, 5, 1, 6]]):
        some = fit.predict({name: column[rows] for name, column in columns.items()}).value
        np.testing.assert_allclose(some, y[rows], rtol=1e-9, atol=1e-9)


def test_several_outputs_take_steps_as_short_as_the_data_and_start_where_they_start() -> None:
    t, w = np.linspace(1, 7, 61), 2.0
    pendulum = Trajectory(
        lambda x, v, *, k: (v, -k * x), {"x": 1.0, "v": 0.0}, ["x", "v"], substeps=4
    )
    y = np.append(np.cos(w * (t - 1)), -w * np.sin(w * (t - 1)))
    columns = {"t": np.tile(t, 2), "output": np.repeat([0, 1], t.size)}
    fit = miho.fit(pendulum, columns, y, {"k": (0.1, 10)})
    some = fit.predict({"t": [4, 8, 1, 4], "output": [0, 0, 1, 1]}).value
    exact = [np.cos(3 * w), np.cos(7 * w), 0, -w * np.sin(3 * w)]
    np.testing.assert_allclose(some, exact, atol=1e-4)
    with pytest.raises(ValueError, match="t does not increase from row to row; sort the rows"):
        fit.predict({"t": [8, 4, 1, 4], "output": [0, 0, 1, 1]})
    with pytest.raises(ValueError, match="t is 0, before the start of the motion at 1"):
        fit.predict({"t": [0, 4], "output": [1, 0]})


def test_a_simulation_with_inputs_is_drawn_over_time() -> None:
    model = Trajectory(lambda x, u, *, k: k * (u - x), {"x": 0.0}, ["x"])
    t = np.linspace(0, 5, 51)
    u = np.sign(np.sin(t))
    x = model.predict(np.array([[2.0]]), t, u)[0]
    x += 0.01 * np.random.default_rng(0).standard_normal(t.size)
    fit = miho.fit(model, {"t": t, "u": u, "x": x}, "x", {"k": (0.1, 10)})
    (ax,) = fit.plot().axes
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("t [s]", "x [-]")
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), t)
    np.testing.assert_allclose(ax.lines[0].get_ydata(), fit.predict((t, u)).value)


FILE = """
def lag(x: "m", u: "V", *, k: "1/s", gain: "m/V" = 2.0):
    return k * (gain * u - x)

def doubled(x: "m") -> "m":
    return 2 * x

def time_constant(*, k: "1/s") -> "s":
    return 1 / k
"""


@pytest.mark.slow
def test_functions_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "lag.py"
    path.write_text(FILE)
    model = load_trajectory(str(path), "lag", {"x": 0.0}, ["doubled"], quantities=["time_constant"])
    assert (dict(model.inputs), dict(model.parameters), model.output, model.source) == (
        {"t": "s", "u": "V"}, {"k": "1/s"}, "m", path,
    )  # fmt: skip
    unit, values = model.derived["time constant"]
    assert (unit, values(np.array([[4.0], [0.5]])).tolist()) == ("s", [0.25, 2.0])
    y = model.predict(np.array([[2.0]]), ROWS, np.ones(ROWS.size))[0]
    np.testing.assert_allclose(y, 4 * (1 - np.exp(-2 * ROWS)), atol=1e-4)
    for wrong in ({"rhs": "none"}, {"outputs": ["none"]}, {"quantities": ["none"]}):
        settings = {"rhs": "lag", "states": {"x": 0.0}, "outputs": ["x"]} | wrong
        with pytest.raises(ValueError, match=f"lag.py: has no function 'none'; .* {min(wrong)}"):
            load_trajectory(str(path), **settings)  # type: ignore[arg-type]


def pull(x: Any, *, k: "N/m") -> "N":  # type: ignore[name-defined]  # noqa: F821, UP037
    return k * x


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"states": {"x": "guessed", "v": 0.0}}, "states.x is 'guessed'; expected a number, meas"),
        ({"states": {"x": 0.0}}, "expected one derivative for each of the states x, got 2"),
        ({"states": ["x", "v"]}, "states is \\['x', 'v'\\]; give values by name"),
        ({"rhs": lambda x, v, *, k: None}, "one derivative for each of the states x, v, got 0"),
        ({"outputs": ["y"]}, "outputs has 'y', which is not a state; expected one of x, v"),
        ({"outputs": []}, "expected at least one output and one state"),
        ({"outputs": ["x", pull]}, "outputs have the units -, N; give scales"),
        ({"restart": 1}, "restart is 1, which needs measured states; declare x, v as meas"),
        ({"segments": 2}, "segments is 2, which needs identified states; declare v"),
        ({"solver": "Euler"}, "solver is 'Euler'; expected one of RK4, Radau, BDF, LSODA"),
        ({"substeps": 0}, "substeps is 0; expected a whole number"),
        ({"quantities": [lambda *, q: q]}, "has the argument q; expected parameters of the model"),
        (
            {"units": {"k": "N"}, "outputs": [pull]},
            "argument k has the units 'N' and 'N/m'; give it one",
        ),
    ],
)
def test_bad_settings_are_named(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(OSCILLATOR, **settings)


def test_bad_columns_are_named() -> None:
    theta = np.array([[40.0, 1.5, 0.3]])
    with pytest.raises(ValueError, match="t does not increase from row to row"):
        OSCILLATOR.predict(theta, T[::-1])
    both = Trajectory(DRIVEN.rhs, {"x": 0.0}, ["x", "x"], name="lag")
    two, index = np.repeat(ROWS, 2), np.tile([0.0, 1.0], ROWS.size)
    with pytest.raises(ValueError, match="force has two values at t = 0; give all outputs"):
        both.predict(theta[:, :1], two, np.arange(two.size), index)
    with pytest.raises(ValueError, match="column output: expected whole numbers from 0 to 1"):
        both.predict(theta[:, :1], two, np.repeat(FORCE, 2), 2 * index)


def power(v: Any, *, c: Any) -> Any:
    """What the damper takes."""
    return c * v * v


def test_rows_of_several_outputs_are_known_by_their_names() -> None:
    model = replace(OSCILLATOR, outputs=["x", power], scales=[1.0, 1.0])
    inputs = [np.zeros(4) for _ in model.inputs]
    inputs[list(model.inputs).index("output")] = np.array([0.0, 1.0, 1.0, 0.0])
    rows = rows_of_parts(model, inputs)
    assert {name: of.tolist() for name, of in rows.items()} == {
        "x": [True, False, False, True],
        "power": [False, True, True, False],
    }
    assert not rows_of_parts(OSCILLATOR, [np.zeros(4)])


@pytest.mark.parametrize("constraints", [(), "k < room"])
def test_bounds_of_a_constant_say_how_it_becomes_a_parameter(constraints: Any) -> None:
    def cooling(T, *, k, room=20.0):
        return -k * (T - room)

    model = Trajectory(cooling, {"T": 80.0}, ["T"])
    t = np.linspace(0, 5, 20)
    data = {"t": t, "T": 20 + 60 * np.exp(-0.5 * t)}
    bounds = {"k": (0, 2), "room": (0, 40)}
    with pytest.raises(ValueError, match=r"room.* constant .* becomes a parameter without its def"):
        miho.fit(model, data, "T", bounds, constraints=constraints)
