"""One step of a differential equation: closed form, the trajectory itself, and a tracker."""

from __future__ import annotations

import pickle
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from miho import CurveFit, Dataset, Parameter, Space, Tracker
from miho import fit as fit_of
from miho.data import stacked
from miho.models import Trajectory
from miho.models.identified import parameters_text, read_parameters
from miho.online import one_step

STEP = 0.02
NOISE = {"vy": 0.003, "yaw_rate": 0.002}
SPEED, LOAD = 20.0, 9.81 / 2


def decay(x: Any, force: Any, *, a: Any) -> Any:
    return force - a * x


def bicycle(vy: Any, yaw_rate: Any, steering: Any, *, B: Any, D: Any) -> Any:
    """The two rates of a car whose axles are 1.3 m from its centre and have equal tires."""
    front = LOAD * D * np.sin(1.5 * np.arctan(B * (steering - (vy + 1.3 * yaw_rate) / SPEED)))
    rear = LOAD * D * np.sin(1.5 * np.arctan(B * (1.3 * yaw_rate - vy) / SPEED))
    return front + rear - SPEED * yaw_rate, (front - rear) / 1.3


def decay_problem(interpolation: str = "linear") -> CurveFit:
    t = np.arange(0, 1, 0.05)
    data = {"t": t, "force": np.sin(5 * t), "x": 1 + np.cos(t)}
    model = Trajectory(decay, {"x": "measured"}, ["x"], (), interpolation, restart=1)
    space = Space((Parameter("a", "-", 0, 5),))
    units = {"t": "s", "force": "-", "x": "-"}
    return CurveFit(model, Dataset("decay", data, units, "x"), space, sigma=0.1)


@pytest.mark.parametrize("interpolation", ["linear", "hold"])
def test_a_step_is_that_of_the_trajectory(interpolation: str) -> None:
    problem = decay_problem(interpolation)
    [after] = one_step(problem)
    theta = np.array([[1.5]])
    inputs = [after.dataset[name] for name in after.model.inputs]
    whole = [problem.dataset[name] for name in problem.model.inputs]
    expected = problem.model.predict(theta, *whole)[:, 1:]
    np.testing.assert_allclose(after.model.predict(theta, *inputs), expected, rtol=1e-12)
    assert after.sigma == 0.1


def test_a_step_without_force_is_exponential() -> None:
    [after] = one_step(decay_problem())
    step, x, nothing = np.array([0.05]), np.array([2.0]), np.zeros(1)
    values = {"step": step, "force": nothing, "force_next": nothing, "x": x}
    found = after.model.predict(np.array([[1.5]]), *(values[n] for n in after.model.inputs))
    # The next term of the series of exp is (0.075)^5 / 120 = 2e-8.
    np.testing.assert_allclose(found, 2 * np.exp(-0.075), rtol=3e-8)


def rates(motion: Any, steering: float, D: float) -> Any:
    return np.array(bicycle(motion[0], motion[1], steering, B=12.0, D=D))


@lru_cache
def driven(seconds: float, fall: float) -> tuple[Any, Any, Any]:
    """Time, motion and steering of `drive` without noise."""
    t = STEP * np.arange(round(seconds / STEP))
    steering = 0.12 * np.sin(2 * np.pi * 0.4 * t) + 0.03 * np.sin(2 * np.pi * 1.1 * t)
    motion, now = np.empty((t.size, 2)), np.zeros(2)
    for k, angle in enumerate(steering):
        motion[k] = now
        ahead = steering[min(k + 1, t.size - 1)]
        D = 0.65 if t[k] >= fall else 1.0
        for share in (np.arange(10) + 0.5) / 10:
            delta, h = angle + share * (ahead - angle), STEP / 10
            middle = now + h / 2 * rates(now, delta, D)
            now = now + h * rates(middle, delta, D)
    return t, motion, steering


def drive(seconds: float, fall: float = np.inf, seed: int = 1) -> dict[str, Any]:
    """Steering near the peak at 50 Hz with ten steps a row; D falls by 35 % at the time `fall`."""
    t, motion, steering = driven(seconds, fall)
    noise = np.random.default_rng(seed).standard_normal(motion.shape)
    motion = motion + np.array([*NOISE.values()]) * noise
    return {"t": t, "vy": motion[:, 0], "yaw_rate": motion[:, 1], "steering": steering}


def car_problem() -> CurveFit:
    model = Trajectory(bicycle, {"vy": 0.0, "yaw_rate": 0.0}, [*NOISE], [*NOISE.values()])
    units = {"t": "s", "vy": "-", "yaw_rate": "-", "steering": "-"}
    data = stacked(Dataset("drive", drive(4.0), units, "vy"), NOISE)
    space = Space((Parameter("B", "-", 2, 30), Parameter("D", "-", 0.2, 3)))
    return CurveFit(model, data, space)


def car_tracker() -> Tracker:
    return Tracker(car_problem(), {"B": (12.3, 0.6), "D": (0.98, 0.03)}, {"D": 0.35})


def test_a_tracker_of_a_trajectory_follows_a_fall_of_grip() -> None:
    tracker, rows = car_tracker(), drive(16.0, fall=8.0)
    states = [
        tracker.update({name: float(column[k]) for name, column in rows.items()})
        for k in range(rows["t"].size)
    ]
    before, after = (
        np.array([s.values["D"] for s in states[a:b]]) for a, b in ((200, 399), (500, 800))
    )
    np.testing.assert_allclose(before, 1.0, rtol=0.1)
    np.testing.assert_allclose(after, 0.65, rtol=0.1)
    [alarm] = [state.alarm for state in states if state.alarm]
    assert 8.0 <= alarm.time < 9.0


def test_rows_at_once_one_by_one_and_after_a_gap() -> None:
    rows = drive(2.0)
    at_once, single = car_tracker(), car_tracker()
    final = at_once.update(rows)
    for k in range(100):
        single.update({name: column[k] for name, column in rows.items()})
        if k == 50:
            single = pickle.loads(pickle.dumps(single))
    np.testing.assert_array_equal(single.state.theta, final.theta)
    assert final.rows == 99
    later = {name: column[:3] + (10 if name == "t" else 0) for name, column in rows.items()}
    assert at_once.update(later).rows == 101  # the step of the gap is left out
    assert at_once.update(rows).rows == 101 + 99
    assert at_once.dataset("yaw_rate_next").output == "yaw_rate_next"


def test_times_in_milliseconds() -> None:
    rows, problem = drive(2.0), car_problem()
    later = {**rows, "t": 1e3 * rows["t"]}
    with pytest.raises(ValueError, match="t increases by 20 from row to row, and in the data by 0"):
        car_tracker().update(later)
    tracker = car_tracker()
    tracker.update({name: column[:2] for name, column in later.items()})
    tracker.update({name: column[2] for name, column in later.items()})
    with pytest.raises(ValueError, match="give times in the unit of the data"):
        tracker.update({name: column[3] for name, column in later.items()})

    def slower(vy: Any, yaw_rate: Any, steering: Any, *, B: Any, D: Any) -> Any:
        return tuple(1e-3 * rate for rate in bicycle(vy, yaw_rate, steering, B=B, D=D))

    model = Trajectory(
        slower, {"vy": 0.0, "yaw_rate": 0.0}, [*NOISE], [*NOISE.values()], units={"t": "ms"}
    )
    columns = {**problem.dataset.columns, "t": 1e3 * problem.dataset["t"]}
    data = Dataset("drive", columns, {**problem.dataset.units, "t": "ms"}, problem.dataset.output)
    known = {"B": (12.3, 0.6), "D": (0.98, 0.03)}
    state = Tracker(CurveFit(model, data, problem.space), known, {"D": 0.35}).update(later)
    expected = car_tracker().update(rows)
    np.testing.assert_allclose(state.theta, expected.theta, rtol=1e-9)
    np.testing.assert_allclose(state.deviations, expected.deviations, rtol=1e-6)
    assert state.time == pytest.approx(expected.time)


def test_the_present_parameters_are_of_the_trajectory(tmp_path: Path) -> None:
    tracker, file = car_tracker(), tmp_path / "parameters.json"
    tracker.update(drive(2.0))
    file.write_text(parameters_text(tracker.parameters(), {}))
    present = read_parameters(file, car_problem().model)
    assert {name: value.value for name, value in present.parameters.items()} == tracker.state.values


def test_an_alarm_is_not_repeated_by_a_row_without_a_step() -> None:
    tracker, rows = car_tracker(), drive(16.0, fall=8.0)
    first = next(
        k
        for k in range(rows["t"].size)
        if tracker.update({name: column[k] for name, column in rows.items()}).alarm
    )
    late = {name: column[first] for name, column in rows.items()}
    state = tracker.update({**late, "t": late["t"] + 10.0})
    assert state.alarm is None
    assert state.rows == first
    assert tracker.change is not None


def nearly_equal(rows: list[dict[str, Any]], others: list[dict[str, Any]]) -> None:
    """Rows and others differ in the last digits, so that states differ as little."""
    first, second = car_tracker(), car_tracker()
    for row, other in zip(rows, others, strict=True):
        first.update(row)
        second.update(other)
    a, b = first._population, second._population
    np.testing.assert_allclose(a.theta, b.theta, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(a.P, b.P, rtol=1e-9, atol=1e-12)


def test_a_motion_begins_again_after_a_gap_although_values_are_equal() -> None:
    """A quantised sensor often shows one value before a gap and after it."""
    columns = drive(2.0)
    rows = [{name: float(column[k]) for name, column in columns.items()} for k in range(100)]
    later = [{**row, "t": row["t"] + 10.0} for row in rows[50:]]
    later[0] |= {name: rows[49][name] for name in NOISE}
    one_differs = [{**later[0], "vy": later[0]["vy"] * (1 + 1e-12)}, *later[1:]]
    both_differ = [{**one_differs[0], "yaw_rate": later[0]["yaw_rate"] * (1 + 1e-12)}, *later[1:]]
    nearly_equal(rows[:50] + later, rows[:50] + both_differ)
    nearly_equal(rows[:50] + one_differs, rows[:50] + both_differ)


def pushed(force: Any, *, a: Any) -> Any:
    return a * force


def test_states_and_parameters_are_estimated_together() -> None:
    """Without errors of the step it is least squares on all rows, by the first state and by `a`."""
    rng = np.random.default_rng(3)
    t, force = STEP * np.arange(200), rng.uniform(-1, 2, 200)
    whole = np.append(0.0, np.cumsum(STEP * force[:-1]))
    x = 1 + 1.5 * whole + 0.1 * rng.standard_normal(200)
    model = Trajectory(pushed, {"x": "measured"}, ["x"], (), "hold", restart=1)
    units = {"t": "s", "force": "-", "x": "-"}
    columns: dict[str, Any] = {"t": t, "force": force, "x": x}
    data = Dataset("push", columns, units, "x")
    problem = CurveFit(model, data, Space((Parameter("a", "-", -9, 9),)), sigma=0.1)
    still: dict[str, Any] = {"drifts": (0.0, 0.0, 0.0), "outliers": 1e-12, "step_error": 0.0}
    state = Tracker(problem, {"a": (1.0, 2.0)}, {}, **still).update(data)
    information = np.diag([0.0, 1 / 2.0**2])
    J = np.column_stack([np.ones(200), whole])
    information += J.T @ J / 0.1**2
    expected = np.linalg.solve(information, [0.0, 1 / 2.0**2] + J.T @ x / 0.1**2)
    # The first state is known a millionth too well, as its mean is not known yet.
    np.testing.assert_allclose(state.theta, expected[1:], rtol=1e-5)
    np.testing.assert_allclose(state.covariance, np.linalg.inv(information)[1:, 1:], rtol=1e-5)


def test_an_interval_of_a_motion_needs_no_scale() -> None:
    """The noise of a state is in two rows, so intervals for independent rows are far too wide."""
    away, problem = [], car_problem()
    for seed in range(20):
        tracker = Tracker(problem, {"B": (12.3, 0.6), "D": (0.98, 0.03)}, {"D": 0.35})
        state = tracker.update(drive(12.0, seed=seed))
        away.append((state.values["D"] - 1.0) / state.deviations[1])
    assert 0.7 < np.sqrt(np.mean(np.square(away))) < 1.3


def test_fixed_parameters_and_scales_stay() -> None:
    problem = car_problem()
    space = Space((Parameter("B", "-", fixed=12.0), Parameter("D", "-", 0.2, 3)))
    fixed = CurveFit(problem.model, problem.dataset, space)
    for free, part, sigma in zip(one_step(problem), one_step(fixed), NOISE.values(), strict=True):
        inputs = [part.dataset[name] for name in part.model.inputs]
        expected = free.model.predict(np.array([[12.0, 0.8]]), *inputs)
        found = part.model.predict(np.array([[0.8]]), *inputs)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)
        assert part.sigma == free.sigma == sigma


def test_a_constrained_motion_is_tracked_in_its_own_parameters() -> None:
    def damped(x: Any, force: Any, *, a: Any, b: Any) -> Any:
        return force - a * x + b

    t = 0.05 * np.arange(100)
    model, theta = Trajectory(damped, {"x": 0.0}, ["x"]), np.array([[1.5, 0.5]])
    columns = {"t": t, "force": np.sin(2 * t)}
    x = model.predict(theta, *columns.values())[0]
    x += 0.01 * np.random.default_rng(0).standard_normal(100)
    bounds: Any = {"a": (0.1, 5), "b": (0.1, 5)}
    fit = fit_of(model, columns, x, bounds, sigma=0.01, constraints=["b < a"])
    state = Tracker(fit).update({**columns, "x": x})
    assert state.names == ("a", "b")
    assert (np.abs(state.theta - theta[0]) < 3 * state.deviations).all()


def test_problems_without_a_step_are_refused() -> None:
    problem = decay_problem()

    def pushed(x: Any, t: Any, *, a: Any) -> Any:
        return a * t - x

    def hidden(x: Any, v: Any, force: Any, *, a: Any) -> Any:
        return v, force - a * x

    def rough(x: Any, *, a: Any) -> Any:
        return -a if x > 0 else a

    for model, message in (
        (Trajectory(pushed, {"x": 0.0}, ["x"], units={"t": "s"}), "depends on 't'"),
        (Trajectory(hidden, {"x": 0.0, "v": 0.0}, ["x"]), "the state 'v' .* is not measured"),
        (Trajectory(rough, {"x": 0.0}, ["x"]), "rough-decay is not a formula"),
    ):
        with pytest.raises(ValueError, match=message):
            Tracker(CurveFit(model, problem.dataset, problem.space, sigma=0.1))
    with pytest.raises(ValueError, match="no column 'force'; expected t, x, force"):
        Tracker(problem).update({"time": 0.0, "x": 1.0})


@pytest.mark.parametrize("by_machine", [True, False])
def test_after_an_outlier_a_state_is_half_way(by_machine: bool) -> None:
    """Either the measured value or the predicted one is wrong: the two are one deviation away."""
    tracker: Any = Tracker(decay_problem(), {"a": (1.5, 0.01)}, {})
    if not by_machine:
        tracker._population._machine = None
    rng = np.random.default_rng(0)
    x = 2 * np.exp(-1.5 * 0.05 * np.arange(42))
    seen = x + 0.1 * rng.standard_normal(42)
    seen[40] += 4.0
    for i in range(41):
        tracker.update({"t": 0.05 * i, "force": 0.0, "x": seen[i]})
    [away], [deviation] = tracker._population.theta[0, 1:] - x[40], tracker._population.P[0, 1, 1:]
    assert away == pytest.approx(2.0, abs=0.2)
    assert np.sqrt(deviation) * 0.1 == pytest.approx(away, rel=0.1)
    tracker.update({"t": 0.05 * 41, "force": 0.0, "x": seen[41]})
    assert tracker._population.theta[0, 1] == pytest.approx(seen[41], abs=0.06)


@pytest.mark.parametrize("value", [20.0, 1e3, 1e12])
@pytest.mark.parametrize("lost", [False, True], ids=["in a motion", "after a missing value"])
@pytest.mark.parametrize("by_machine", [True, False])
def test_one_wrong_value_of_a_state_changes_nothing(
    value: float, lost: bool, by_machine: bool
) -> None:
    """Neither in a motion, nor where the motion begins again because a value is missing."""
    tracker: Any = Tracker(decay_problem(), {"a": (1.5, 0.3)}, {"a": 0.3})
    if not by_machine:
        tracker._population._machine = None
    rng, x = np.random.default_rng(0), 2.0
    for i in range(200):
        force, seen = 6 * np.sin(0.05 * i), x + 0.1 * rng.standard_normal()
        seen = value if i == 51 else float("nan") if lost and i == 50 else seen
        state = tracker.update({"t": 0.05 * i, "force": force, "x": seen})
        assert state.alarm is None
        x += 0.05 * (force - 1.5 * x)
    assert state.theta[0] == pytest.approx(1.5, abs=3 * state.deviations[0])
    assert state.deviations[0] < 0.05
