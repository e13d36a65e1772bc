"""Trajectories of the machine against NumPy's and SciPy's, and what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from miho.core import machine
from miho.models import Trajectory, taped_equations
from miho.models.integration import Sensitivities, Values, along, runge_kutta
from miho.models.layout import Course
from miho.models.taped_equations import TapedEquations
from miho.vehicle.models import single_track_drive, single_track_response

Array = NDArray[np.float64]
pytestmark = pytest.mark.skipif(machine() is None, reason="the machine was not built")

CAR = {"mass": 800.0, "lf": 1.7, "lr": 1.271, "Izz": 850.0}
AXLE = [18.0, 1.5, 5500.0, 0.1, 0.001, 20.0]
ROWS = np.linspace(0.0, 6.0, 301)
STEERING = 0.05 * np.sin(2 * ROWS)
SPEED = 30 + 5 * np.cos(ROWS)


def pendulum(x: Any, v: Any, t: Any, force: Any, *, k: Any, c: Any, m: float = 2.0) -> Any:
    """Every kind of slope: by states, by parameters, constant, and none."""
    return v, (np.where(force > 0, force, 0.5 * force) - k * np.sin(x) - c * v + np.cos(t)) / m


def power(x: Any, v: Any, *, k: Any, c: Any) -> Any:
    return k * x * v + c


PENDULUM = Trajectory(
    pendulum, {"x": "identified", "v": 0.5}, ["x", power, "v"], scales=(0.1, 2.0, 1.0)
)


def three(t: Array, force: Array) -> tuple[Array, ...]:
    """Columns of three outputs at each time, the first of which is missing at some."""
    output = np.tile([2.0, 0.0, 1.0], t.size)
    kept = (output > 0) | (np.arange(output.size) % 4 > 0)
    return np.repeat(t, 3)[kept], np.repeat(force, 3)[kept], output[kept]


CASES: dict[str, tuple[Trajectory, Array, tuple[Array, ...]]] = {
    "single track": (
        single_track_response(CAR),  # type: ignore[dict-item]
        np.array([18.0, 1.5, 5500.0, 18.0, 1.5, 8000.0, 850.0]),
        (ROWS, SPEED, STEERING),
    ),
    "twelve parameters, held inputs": (
        single_track_drive(CAR),  # type: ignore[dict-item]
        np.array(AXLE + AXLE),
        (np.repeat(ROWS, 3), np.repeat(0.1 * STEERING, 3), np.repeat(STEERING, 3),
         np.tile(np.arange(3.0), ROWS.size)),
    ),
    "three outputs": (PENDULUM, np.array([4.0, 0.3, 0.2]), three(ROWS, STEERING)),
    "segments": (
        replace(PENDULUM, states={"x": "identified", "v": "identified"}, segments=4),
        np.array([4.0, 0.3, *np.linspace(-1, 1, 8)]),
        three(ROWS, STEERING),
    ),
    "one step ahead": (
        replace(PENDULUM, states={"x": "measured", "v": "measured"}, restart=1),
        np.array([4.0, 0.3]),
        (*(column := three(ROWS, STEERING))[:2], np.sin(column[0]), np.cos(column[0]), column[2]),
    ),
    "many steps from row to row": (
        replace(PENDULUM, substeps=150, outputs=["x"], scales=()),
        np.array([4.0, 0.3, 0.2]),
        (ROWS[::30], STEERING[::30]),
    ),
    "one row": (
        replace(PENDULUM, outputs=["x"], scales=()), np.array([4.0, 0.3, 0.2]), (ROWS[:1],) * 2,
    ),
    "nothing depends on anything": (
        Trajectory(lambda x, *, k: 0.5, {"x": 1.0}, ["x"], name="constant"),
        np.array([4.0]),
        (ROWS,),
    ),
}  # fmt: skip
"""Model, parameters and input columns."""


def taped(model: Trajectory) -> TapedEquations:
    solution = model.equations.taped
    assert solution is not None
    return solution


def close(values: Array, expected: Array, share: float) -> bool:
    """To a share of the largest number of each column."""
    scale = np.maximum(np.abs(expected).max(axis=0), 1e-300)
    return bool((np.abs(values - expected) <= share * scale).all())


@pytest.mark.parametrize("name", CASES)
def test_states_and_sensitivities_are_those_of_the_same_steps_in_numpy(name: str) -> None:
    """Elementary functions differ by an ulp, which the motion repeats hundreds of times."""
    model, theta, columns = CASES[name]
    course = model._course(columns)
    motion = Values(model.equations, theta[:, None])
    values = along(course, motion, runge_kutta(course, motion))[:, 0]
    varied = Sensitivities(model.equations, theta, np.abs(theta))
    slopes = along(course, varied, runge_kutta(course, varied))
    assert isinstance(model._taped, TapedEquations)
    assert close(model.predict(theta[None], *columns)[0], values, 1e-12)
    assert close(model.jacobian(theta, *columns), slopes, 1e-11)


@pytest.mark.parametrize("name", ["single track", "three outputs", "one step ahead"])
def test_without_the_machine_numpy_gives_the_same(name: str) -> None:
    model, theta, columns = CASES[name]
    other = replace(model)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(taped_equations, "machine", lambda: None)
        assert other.equations.taped is None
    thetas = theta * np.random.default_rng(1).uniform(0.9, 1.1, (5, theta.size))
    expected = other.predict(thetas, *columns)
    assert close(model.predict(thetas, *columns).T, expected.T, 1e-12)
    assert close(model.jacobian(theta, *columns), other.jacobian(theta, *columns), 1e-11)


def test_states_and_sensitivities_are_scipys() -> None:
    """RK4 at 1 ms leaves h^4 = 1e-12 times some 100 (rad/s)^4; SciPy is asked for 1e-12.

    Sensitivities are compared with differences of SciPy's solution of fourth order, with steps of a
    hundredth: they leave the fifth derivative times 1e-8 / 30.
    """
    t, theta = ROWS[::3], np.array([4.0, 0.3, 0.2])
    force = np.ones(t.size)
    model = replace(PENDULUM, outputs=["x"], scales=(), substeps=60)

    def by_scipy(theta: Array) -> Array:
        k, c, x0 = theta
        rates = lambda t, z: pendulum(*z, t, 1.0, k=k, c=c)  # noqa: E731
        solution = solve_ivp(rates, (0, t[-1]), [x0, 0.5], "DOP853", t, rtol=1e-12, atol=1e-14)
        return np.asarray(solution.y[0])

    np.testing.assert_allclose(model.predict(theta[None], t, force)[0], by_scipy(theta), atol=1e-9)
    columns = []
    for k in range(3):
        h = 0.01 * theta * (np.arange(3) == k)
        near, far = (by_scipy(theta + s * h) - by_scipy(theta - s * h) for s in (1, 2))
        columns.append((8 * near - far) / (12 * h[k]))
    assert close(model.jacobian(theta, t, force), np.column_stack(columns), 1e-6)


@pytest.mark.parametrize("name", CASES)
def test_all_levels_give_the_same_bits(name: str) -> None:
    model, theta, columns = CASES[name]
    course, found = model._course(columns), set()
    thetas = theta * np.random.default_rng(2).uniform(0.9, 1.1, (9, theta.size))
    for level in range(len(machine().levels())):
        solution = replace(taped(model), level=level)
        values = np.empty((9, course.output.size))
        slopes = np.empty((course.output.size, theta.size))
        solution.solve(thetas, course, values)
        solution.derive(theta, course, slopes)
        found.add(values.tobytes() + slopes.tobytes())
    assert len(found) == 1


def test_a_batch_of_any_size_gives_each_row_as_alone() -> None:
    """One, some and all lanes, and a further block; NaN, and what diverges, stay in their lane."""
    model, theta, columns = CASES["three outputs"]
    thetas = theta * np.random.default_rng(3).uniform(0.5, 1.5, (130, 3))
    thetas[7, 0], thetas[9, 1], thetas[70, 2] = np.nan, -1e6, np.inf
    alone = np.vstack([model.predict(row[None], *columns) for row in thetas])
    for n in (2, 63, 64, 65, 130):
        np.testing.assert_array_equal(model.predict(thetas[:n], *columns), alone[:n])
    lost = np.isnan(alone).any(axis=1)
    assert np.flatnonzero(lost).tolist() == [7, 9, 70]
    assert model.predict(thetas[:0], *columns).shape == (0, columns[0].size)


def test_sensitivities_of_what_diverges_are_nan() -> None:
    model = Trajectory(lambda x, *, k: k * x * x, {"x": 1.0}, ["x"], name="pole")
    slopes = model.jacobian(np.array([1.0]), ROWS)
    assert np.isfinite(slopes[:30]).all()
    assert np.isnan(slopes[-1]).all()


def test_what_the_machine_cannot_hold_goes_to_numpy() -> None:
    """A right-hand side of some 75,000 operations."""

    def long(x: Any, *, k: Any) -> Any:
        for step in range(25_000):
            x = np.sin(x + k) + step
        return x

    assert Trajectory(long, {"x": 1.0}, ["x"]).equations.taped is None


def changed(course: Course, **fields: Any) -> Course:
    return course._replace(**fields)


def entry(name: str, at: Any, value: float) -> Callable[[Course], Course]:
    """A course with another number in one of its arrays."""

    def change(course: Course) -> Course:
        array = getattr(course, name).copy()
        array[at] = value
        return course._replace(**{name: array})

    return change


BAD: dict[str, Callable[[Course], Any]] = {
    "fewer times": lambda c: changed(c, t=c.t[:-1].copy()),
    "no times": lambda c: changed(
        c, t=c.t[:0].copy(), u=c.u[:0].copy(), first=c.first[:1], reset=c.reset[:0]
    ),
    "times of another type": lambda c: changed(c, t=c.t.astype(np.float32)),
    "times that are not in one piece": lambda c: changed(c, t=np.repeat(c.t, 2)[::2]),
    "fewer inputs": lambda c: changed(c, u=c.u[:-1].copy()),
    "more inputs": lambda c: changed(c, u=np.hstack([c.u, c.u])),
    "fewer rows": lambda c: changed(c, rows=c.rows[:-1].copy()),
    "fewer firsts": lambda c: changed(c, first=c.first[:-1].copy()),
    "fewer resets": lambda c: changed(c, reset=c.reset[:-1].copy()),
    "starts of fewer states": lambda c: changed(c, values=c.values[:, :1].copy()),
    "fewer starts": lambda c: changed(c, parameters=c.parameters[:0].copy()),
    "no start": entry("reset", 0, -1),
    "a start that is not there": entry("reset", 5, 1),
    "a negative start": entry("reset", 5, -2),
    "a parameter that is not there": entry("parameters", (0, 0), 3),
    "a negative parameter": entry("parameters", (0, 0), -2),
    "an output that is not there": entry("output", 0, 3),
    "a negative output": entry("output", 0, -1),
    "a row that is not there": entry("rows", 0, 10**6),
    "a negative row": entry("rows", 0, -1),
    "a first row beyond": entry("first", 3, 10**6),
    "a negative first row": entry("first", 3, -1),
    "no substeps": lambda c: changed(c, substeps=0),
    "negative substeps": lambda c: changed(c, substeps=-1),
    "substeps that are no number": lambda c: changed(c, substeps="two"),
    "too few fields": lambda c: tuple(c)[:-1],
    "no course": lambda c: None,
}


@pytest.mark.parametrize("fault", BAD)
def test_bad_courses_are_refused(fault: str) -> None:
    model, theta, columns = CASES["three outputs"]
    course = BAD[fault](model._course(columns))
    R = columns[0].size
    with pytest.raises((ValueError, TypeError, BufferError)):
        taped(model).solve(theta[None], course, np.empty((1, R)))
    with pytest.raises((ValueError, TypeError, BufferError)):
        taped(model).derive(theta, course, np.empty((R, 3)))


def test_bad_arrays_and_tapes_are_refused() -> None:
    model, theta, columns = CASES["three outputs"]
    course, solution, other = model._course(columns), taped(model), taped(CASES["single track"][0])
    R = columns[0].size
    refused = pytest.raises((ValueError, TypeError, BufferError))
    frozen = np.empty((1, R))
    frozen.flags.writeable = False
    for thetas, values in [
        (theta[None, :2].copy(), np.empty((1, R))), (theta, np.empty((1, R))),
        (np.vstack([theta] * 2), np.empty((1, R))), (theta[None], np.empty((1, R - 1))),
        (theta[None], frozen), (theta[None].astype(np.float32), np.empty((1, R))),
    ]:  # fmt: skip
        with refused:
            solution.solve(thetas, course, values)
    for at, slopes in [
        (theta[:2].copy(), np.empty((R, 3))), (theta, np.empty((R, 2))),
        (theta, np.empty((R - 1, 3))), (theta, np.empty((3, R)).T),
    ]:  # fmt: skip
        with refused:
            solution.derive(at, course, slopes)
    rate_slopes, output_slopes = solution.rate_slopes, solution.output_slopes
    moved = rate_slopes.at.copy()
    moved[-1, 1] = 5
    for fields in [
        {"rates": other.rates}, {"outputs": other.outputs}, {"rate_slopes": other.rate_slopes},
        {"output_slopes": other.output_slopes}, {"rate_slopes": output_slopes},
        {"rate_slopes": rate_slopes._replace(at=rate_slopes.at[::-1].copy())},
        {"rate_slopes": rate_slopes._replace(at=rate_slopes.at - 1)},
        {"rate_slopes": rate_slopes._replace(at=rate_slopes.at[:-1].copy())},
        {"rate_slopes": rate_slopes._replace(at=moved)},
    ]:  # fmt: skip
        with refused:
            replace(solution, **fields).derive(theta, course, np.empty((R, 3)))
    for function in (machine().solve_trajectories, machine().derive_trajectory):
        with pytest.raises(TypeError, match="arguments"):
            function()
    with pytest.raises(ValueError, match="tapes"):
        machine().solve_trajectories(None, 3, theta[None], course, np.empty((1, R)))
