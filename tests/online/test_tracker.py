"""The tracker: closed forms, changes, faults, resumption, memory and errors."""

from __future__ import annotations

import inspect
import pickle
import tracemalloc
from typing import Any

import numpy as np
import pytest

import miho
from miho import CurveFit, Dataset, Parameter, Space, Tracker
from miho.models.identified import parameters_text
from miho.online import Alarm, OnlineMethod, TrackerSettings, TrackerState
from miho.online.population import Population
from miho.online.state import Change, alarm_of

SIGMA = 0.03
ROWS = 900
FALL = 600
NO_OUTLIERS = 1e-12
PRIOR = {"B": (12.2, 0.5), "D": (1.02, 0.03)}


def _force(slip: Any, *, B: Any, D: Any) -> Any:
    return D * np.sin(1.5 * np.arctan(B * slip))


force: Any = _force


def line(x: Any, *, a: Any, b: Any) -> Any:
    return a * x + b


def problem_of(function: Any = force, **columns: Any) -> CurveFit:
    """The problem of a function of one input; bounds are -50 and 50."""
    columns = columns or {"slip": np.linspace(-0.16, 0.16, 40), "y": np.zeros(40)}
    names = inspect.getfullargspec(function).kwonlyargs
    space = Space(tuple(Parameter(name, "", -50.0, 50.0) for name in names))
    data = Dataset("stream", columns, dict.fromkeys(columns, ""), "y")
    return CurveFit(function, data, space, sigma=SIGMA)


def tire(seed: int = 0, fall: float = 0.35) -> dict[str, Any]:
    """Corners at 50 Hz near the peak; D falls within 0.2 s."""
    rng = np.random.default_rng(seed)
    k = np.arange(ROWS)
    slip = 0.12 * np.sin(2 * np.pi * k / 200) + 0.01 * np.sin(k / 7)
    slip[FALL - 50 : FALL + 100] = 0.12 + 0.02 * np.sin(k[FALL - 50 : FALL + 100] / 7)
    D = 1 - fall * np.clip((k - FALL) / 10, 0, 1)
    y = force(slip, B=12.0, D=D) + SIGMA * rng.standard_normal(ROWS)
    slip = slip + 0.0005 * rng.standard_normal(ROWS)
    return {"slip": slip, "y": y, "time": 0.02 * k}


def tracker(**settings: Any) -> Tracker:
    return Tracker(problem_of(), PRIOR, {"D": 0.35}, {"slip": 0.0005}, **settings)


def followed(
    run: Tracker, columns: dict[str, Any], rows: slice = slice(None)
) -> list[TrackerState]:
    each = [column[rows].tolist() for column in columns.values()]
    return [run.update(dict(zip(columns, row, strict=True))) for row in zip(*each, strict=True)]


def test_without_drift_and_changes_it_is_least_squares() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, 60)
    y = 2 * x - 1 + SIGMA * rng.standard_normal(60)
    still: dict[str, Any] = {"drifts": (0.0, 0.0, 0.0), "outliers": NO_OUTLIERS}
    run = Tracker(problem_of(line, x=x, y=y), {"a": (1.5, 0.8), "b": (0.0, 2.0)}, {}, **still)
    state = run.update({"x": x, "y": y})
    prior = np.diag([1 / 0.8**2, 1 / 2.0**2])
    J = np.column_stack([x, np.ones(60)])
    information = prior + J.T @ J / SIGMA**2
    expected = np.linalg.solve(information, prior @ [1.5, 0.0] + J.T @ y / SIGMA**2)
    # The condition number of the information is some 10, and 60 rows are added: 1e-12 is rounding.
    np.testing.assert_allclose(state.theta, expected, rtol=1e-11)
    np.testing.assert_allclose(state.covariance, np.linalg.inv(information), rtol=1e-10)
    reach = 1.959963984540054 * np.sqrt(np.diag(np.linalg.inv(information)))
    np.testing.assert_allclose(np.diff(state.intervals())[:, 0] / 2, reach, rtol=1e-5)


@pytest.mark.parametrize("by_machine", [True, False])
def test_the_interval_has_the_variance_of_the_error_until_rows_are_idle(by_machine: bool) -> None:
    """Most rows teach less than the drift adds, which forgets and is no belief; idle rows grow."""
    rng = np.random.default_rng(1)
    x = np.append(np.tile([1.0, *9 * [0.3]], 30), 50 * [0.01])
    y = 2 * x + SIGMA * rng.standard_normal(350)
    slope: Any = lambda x, *, a: a * x  # noqa: E731
    long: dict[str, Any] = {"drifts": 3 * (0.05,), "outliers": NO_OUTLIERS}
    run = Tracker(problem_of(slope, x=x, y=y), {"a": (2.0, 0.5)}, {}, **long)
    if not by_machine:
        run._population._machine = None
    state = run.update({"x": x[:300], "y": y[:300]})
    error = variance = 0.5**2
    for k in range(300):
        variance += (k > 0) * (0.05 * 0.5) ** 2 * 0.02
        gain = variance * x[k] / (variance * x[k] ** 2 + SIGMA**2)
        error = (1 - gain * x[k]) ** 2 * error + gain**2 * SIGMA**2
        variance *= 1 - gain * x[k]
    assert error < 0.6 * variance
    assert state.intervals()[0, 1] - state.theta[0] == pytest.approx(1.96 * error**0.5, rel=1e-4)
    idle = run.update({"x": x[300:], "y": y[300:]})
    assert idle.deviations[0] > 1.2 * state.deviations[0]


def test_with_drift_it_is_the_kalman_filter() -> None:
    rng = np.random.default_rng(2)
    x = rng.uniform(0.5, 1, 80)
    y = 0.3 * x + SIGMA * rng.standard_normal(80)
    q = 0.03
    settings: dict[str, Any] = {"outliers": NO_OUTLIERS, "cap": 1e6, "period": 0.5}
    prior = dict.fromkeys("ab", (0.0, 1.0))
    run = Tracker(problem_of(line, x=x, y=y), prior, {}, drifts=(q, q, q), **settings)
    theta, P = np.zeros(2), np.eye(2)
    for k in range(80):
        state = run.update({"x": x[k], "y": y[k]})
        j = np.array([x[k], 1.0])
        P = P + (q**2 * 0.5 * np.eye(2) if k else 0)  # no time has passed before the first row
        gain = P @ j / (j @ P @ j + SIGMA**2)
        theta, P = theta + gain * (y[k] - j @ theta), P - np.outer(gain, j @ P)
        np.testing.assert_allclose(state.theta, theta, rtol=1e-9, atol=1e-10)
    # The drift is a way to forget: in the long run half of the filter's variance is belief.
    assert np.all(np.diag(state.covariance) <= np.diag(P) * (1 + 1e-9))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_fall_raises_one_alarm(seed: int) -> None:
    states = followed(tracker(), tire(seed))
    alarms = [state.alarm for state in states if state.alarm]
    assert [alarm.parameter for alarm in alarms] == ["D"]
    assert FALL * 0.02 < alarms[0].time < FALL * 0.02 + 0.3
    assert str(alarms[0]).startswith("D fell by ")
    D = np.array([state.values["D"] for state in states])
    assert np.abs(D[FALL - 100 : FALL] - 1).max() < 0.03
    # A fresh hypothesis may win for a row or two, by the largest of some hundred errors.
    assert np.quantile(np.abs(D[FALL + 30 :] / 0.65 - 1), 0.98) < 0.05
    low, high = states[-1].intervals()[1]
    assert low < 0.65 < high
    assert states[-1].identifiable.all()


def test_a_drift_that_begins_widens_the_interval_early() -> None:
    """Rows of slow falls whose value is outside, 124 of 1,500; 180 if only jumps are expected."""
    outside = {}
    for onset in (TrackerSettings.onset, 1e-12):
        outside[onset] = 0
        for seed in range(2):
            rng = np.random.default_rng(seed)
            time = 0.02 * np.arange(1500)
            a = 1 - 0.035 * np.clip(time - 20, 0, None)
            x = rng.uniform(0.5, 1.5, time.size)
            columns = {"time": time, "x": x, "y": a * x + SIGMA * rng.standard_normal(x.size)}
            problem = problem_of(lambda x, *, a: a * x, x=x, y=columns["y"])
            states = followed(Tracker(problem, {"a": (1, 0.05)}, onset=onset), columns)
            low, high = np.array([state.intervals()[0] for state in states[1000:]]).T
            outside[onset] += np.count_nonzero((low > a[1000:]) | (high < a[1000:]))
    assert outside[TrackerSettings.onset] < 0.8 * outside[1e-12]


def test_nothing_changes_without_a_change() -> None:
    states = followed(tracker(), tire(3, fall=0.0))
    assert not any(state.alarm for state in states)
    assert max(state.odds for state in states) < 3


def test_straights_do_not_move_the_grip() -> None:
    columns = tire(4, fall=0.0)
    run = tracker()
    before = followed(run, columns)[-1]
    rng = np.random.default_rng(4)
    slip = 0.002 * rng.standard_normal(1000)
    rows = {"slip": slip + 0.0005 * rng.standard_normal(1000), "y": force(slip, B=12.0, D=1.0)}
    after = run.update({**rows, "y": rows["y"] + SIGMA * rng.standard_normal(1000)})
    assert abs(after.values["D"] - before.values["D"]) < 0.3 * before.deviations[1]
    assert after.deviations[1] > before.deviations[1]
    assert not after.identifiable[1]


def spoil(columns: dict[str, Any], fault: str) -> None:
    rng = np.random.default_rng(5)
    some, y, time = rng.random(ROWS) < 0.05, columns["y"], columns["time"]
    if fault == "missing":
        y[some] = columns["slip"][rng.random(ROWS) < 0.05] = np.nan
    elif fault == "infinite":
        y[some] = np.inf
    elif fault == "outliers":
        y[some] += 20 * SIGMA * rng.choice([-1, 1], some.sum())
    elif fault == "dropout":
        y[300:550] = np.nan
    elif fault == "frozen output":
        y[300:550] = y[300]
    elif fault == "frozen input":
        columns["slip"][300:550] = columns["slip"][300]
    elif fault == "time jumps":
        time[300:] += 1000
    elif fault == "time goes back":
        time[300:] -= 1000
    elif fault == "time stands":
        time[300:400] = time[300]
    elif fault == "time infinite":
        time[300:310] = np.inf


@pytest.mark.parametrize(
    "fault",
    ["missing", "infinite", "outliers", "dropout", "frozen output", "frozen input", "time jumps",
     "time goes back", "time stands", "time infinite"],
)  # fmt: skip
def test_faults(fault: str) -> None:
    columns = tire(6, fall=0.0)
    spoil(columns, fault)
    states = followed(tracker(), columns)
    assert not any(state.alarm for state in states)
    error = np.abs([state.values["D"] - 1 for state in states[300:]])
    assert error.max() < 0.03
    assert error[-50:].max() < 0.015


@pytest.mark.parametrize("by_machine", [True, False])
@pytest.mark.parametrize("column", ["x", "y"])
@pytest.mark.parametrize("value", [1e154, 1e200, 1e308])
def test_a_value_whose_square_is_no_double_does_no_harm(
    value: float, column: str, by_machine: bool
) -> None:
    rng = np.random.default_rng(3)
    rows = {"x": rng.uniform(0.5, 1.5, 60)}
    rows["y"] = 2 * rows["x"] + 1 + SIGMA * rng.standard_normal(60)
    run = Tracker(problem_of(line, x=rows["x"], y=rows["y"]), {"a": (2.0, 0.1), "b": (1.0, 0.1)})
    old = run._population
    run._population = Population(old.layout, old.rules, old.formula, by_machine)
    run._population.memory[:] = old.memory
    rows[column][30] = value
    state = run.update(rows)
    assert np.all(np.abs(state.theta - [2.0, 1.0]) < 4 * state.deviations)
    assert np.all(state.deviations < 0.1)
    assert state.alarm is None


@pytest.mark.parametrize("by_machine", [True, False])
def test_one_absurd_input_with_noise_does_not_blind_the_tracker(by_machine: bool) -> None:
    """The running mean of the input is then far away from the next ones for many rows."""
    run, columns = tracker(), tire(7)
    old = run._population
    run._population = Population(old.layout, old.rules, old.formula, by_machine)
    run._population.memory[:] = old.memory
    columns["slip"][500] = 1e38
    states = followed(run, columns)
    assert not any(state.alarm for state in states[:FALL])
    assert any(state.alarm for state in states[FALL : FALL + 25])
    assert abs(states[-1].values["D"] - 0.65) < 0.03


@pytest.mark.parametrize("by_machine", [True, False])
@pytest.mark.parametrize("wrong", [5.0, 1000.0])
def test_one_wrong_input_is_no_change(wrong: float, by_machine: bool) -> None:
    """The model is linear in the input, so a change of `a` explains this row alone."""
    rng = np.random.default_rng(4)
    x = rng.uniform(0.5, 1.5, 300)
    rows = {"x": x, "y": 2 * x + 1 + SIGMA * rng.standard_normal(300)}
    run = Tracker(problem_of(line, **rows), {"a": (2.0, 0.1), "b": (1.0, 0.1)})
    old = run._population
    run._population = Population(old.layout, old.rules, old.formula, by_machine)
    run._population.memory[:] = old.memory
    rows["x"][200] *= wrong
    states = followed(run, rows)
    assert not any(state.alarm for state in states)
    assert all(abs(state.values["a"] - 2.0) < 0.2 for state in states[100:])
    assert abs(states[210].values["a"] - 2.0) < 0.03


@pytest.mark.parametrize("by_machine", [True, False])
@pytest.mark.parametrize("first", [200, 201, 202])
def test_three_wrong_inputs_in_succession_are_no_change(first: int, by_machine: bool) -> None:
    """A change of `a` explains each of them. A fresh hypothesis is born in every third row."""
    rng = np.random.default_rng(4)
    x = rng.uniform(0.5, 1.5, 240)
    rows = {"x": x, "y": 2 * x + SIGMA * rng.standard_normal(240)}
    run: Any = Tracker(problem_of(lambda x, *, a: a * x, **rows), {"a": (2.0, 0.1)})
    if not by_machine:
        run._population._machine = None
    rows["x"][first : first + 3] *= 3
    states = followed(run, rows)
    assert not any(state.alarm for state in states)
    assert all(abs(state.values["a"] - 2.0) < 0.1 for state in states[first + 5 :])


def test_several_rows_are_rows_one_by_one() -> None:
    columns, together = tire(), tracker()
    each = followed(tracker(), columns, slice(0, 700))
    state = together.update({name: column[:700] for name, column in columns.items()})
    assert state.theta.tobytes() == each[-1].theta.tobytes()
    assert state.covariance.tobytes() == each[-1].covariance.tobytes()
    assert str(state.alarm) == str(next(one.alarm for one in each if one.alarm))
    assert state.rows == 700


def test_a_masked_value_is_missing() -> None:
    columns, masked = tire(), tire()
    for name, first in (("slip", 50), ("y", 60)):
        hidden = np.arange(ROWS) // 5 == first // 5
        masked[name] = np.ma.array(columns[name] + 9.0 * hidden, mask=hidden)
        columns[name] = np.where(hidden, np.nan, columns[name])
    expected = tracker().update(columns)
    single, together = tracker(), tracker()
    for k in range(ROWS):
        single.update({name: column[k] for name, column in masked.items()})
    assert together.update(masked).theta.tobytes() == expected.theta.tobytes()
    assert single.state.theta.tobytes() == expected.theta.tobytes()


def test_a_dataset_is_rows_too() -> None:
    columns = tire()
    data = Dataset("log", columns, dict.fromkeys(columns, ""), "y")
    a, b = tracker(), tracker()
    assert a.update(data).theta.tobytes() == b.update(columns).theta.tobytes()


def test_a_pickled_tracker_continues_to_the_last_bit() -> None:
    run, columns = tracker(), tire()
    followed(run, columns, slice(0, FALL + 3))
    copied = pickle.loads(pickle.dumps(run))
    assert copied.state.values == run.state.values
    for state, same in zip(
        followed(run, columns, slice(FALL + 3, None)),
        followed(copied, columns, slice(FALL + 3, None)),
        strict=True,
    ):
        assert state.theta.tobytes() == same.theta.tobytes()
        assert state.intervals().tobytes() == same.intervals().tobytes()
        assert str(state.alarm) == str(same.alarm)
    assert run.dataset().digest == copied.dataset().digest


def test_memory_does_not_grow() -> None:
    run, columns = tracker(), tire()
    followed(run, columns)
    tracemalloc.start()
    try:
        followed(run, columns, slice(0, 200))
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(3):
            followed(run, columns)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 20_000  # 2,700 rows; a number kept per row would be 80 kB


def test_bounds_hold() -> None:
    problem = problem_of()
    space = Space((Parameter("B", "", 11.0, 13.0), Parameter("D", "", 0.9, 1.1)))
    run = Tracker(
        CurveFit(force, problem.dataset, space, sigma=SIGMA), PRIOR, {"D": 0.35}, {"slip": 0.0005}
    )
    for state in followed(run, tire()):
        ends = np.column_stack([state.theta, state.intervals()])
        assert np.all((ends >= [[11.0], [0.9]]) & (ends <= [[13.0], [1.1]]))
    assert run.state.values["D"] < 0.95


def test_a_function_that_branches_is_tracked_by_differences() -> None:
    def branching(slip: Any, *, B: float, D: float) -> Any:
        return force(slip, B=B, D=D) if D > 0 else -force(slip, B=B, D=-D)

    columns = tire()
    plain, traced = (
        Tracker(problem_of(branching), PRIOR, {"D": 0.35}),
        Tracker(problem_of(), PRIOR, {"D": 0.35}),
    )
    for state, same in zip(
        followed(plain, columns, slice(550, 650)),
        followed(traced, columns, slice(550, 650)),
        strict=True,
    ):
        np.testing.assert_allclose(
            state.theta, same.theta, rtol=1e-6
        )  # differences have ten digits
        assert (state.alarm is None) == (same.alarm is None)


def test_a_model_too_large_for_the_machine_is_tracked_in_numpy() -> None:
    """With 65 inputs, of which only the first is not 0."""
    names = [f"x{k}" for k in range(65)]
    total: Any = eval(f"lambda {', '.join(names)}, *, a: a * ({' + '.join(names)})")
    columns = {name: np.full(30, float(name == "x0")) for name in names}
    run = Tracker(problem_of(total, **columns, y=np.full(30, 2.0)), {"a": (2.2, 0.2)})
    run.update({**columns, "y": 2 + SIGMA * np.random.default_rng(0).standard_normal(30)})
    assert abs(run.state.values["a"] - 2) < 3 * SIGMA / np.sqrt(30)


def test_outputs_of_a_joint_fit_share_parameters() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(0.5, 1.5, 80)

    def v(x: Any, *, a: Any, c: Any) -> Any:
        return a * x**2 + c

    noise = 0.02 * rng.standard_normal((2, 80))
    parts = {
        "u": miho.Part(line, {"x": x}, 2 * x + 1 + noise[0], sigma=0.02),
        "v": miho.Part(v, {"x": x}, 2 * x**2 - 1 + noise[1], sigma=0.02),
    }
    report = miho.fit_joint(parts, {"a": (0, 5), "b": (-3, 3), "c": (-3, 3)}).report()
    run = Tracker(report, changes={"a": 0.35})
    # The tracker scales parameters: one rounding each way.
    np.testing.assert_allclose(run.state.theta, report.at.theta, rtol=4 * np.finfo(float).eps)
    np.testing.assert_allclose(run.state.deviations, report.at.standard_errors, rtol=1e-6)
    fallen = {"x": x, "u": 1.2 * x + 1 + noise[0], "v": 1.2 * x**2 - 1 + noise[1]}
    state = run.update(fallen)
    assert state.alarm is not None and state.alarm.parameter == "a"
    assert abs(state.values["a"] - 1.2) < 0.03
    assert run.dataset("v").output == "v"
    assert list(run.parameters("v").parameters) == ["a", "c"]


def test_informative_rows_describe_the_present() -> None:
    run = tracker(kept=100)
    followed(run, tire())
    data = run.dataset()
    assert len(data) == 100
    assert data["time"].min() > FALL * 0.02
    fit = miho.fit(force, {"slip": data["slip"]}, data["y"], {"B": (5, 20), "D": (0.2, 2)})
    assert abs(fit.values["D"] / 0.65 - 1) < 0.05


def test_the_present_model_is_a_parameters_file() -> None:
    run = tracker()
    followed(run, tire())
    present = run.parameters()
    assert present.parameters["D"].value == run.state.values["D"]
    assert present.parameters["D"].low < 0.65 < present.parameters["D"].high
    assert "tracked" in parameters_text(present, {})


def test_tied_and_fixed_parameters_follow() -> None:
    space = Space((Parameter("B", "", fixed=12.0), Parameter("D", "", 0.1, 3.0)))
    data = problem_of().dataset
    run = Tracker(CurveFit(force, data, space, sigma=SIGMA), {"D": (1.0, 0.03)})
    followed(run, tire())
    assert list(run.state.values) == ["D"]
    present = run.parameters().parameters
    assert present["B"].value == 12.0
    assert present["D"].value == run.state.values["D"]


def test_a_constrained_fit_is_tracked_in_its_own_parameters() -> None:
    x = np.random.default_rng(0).uniform(0.2, 2, 300)

    def decays(x: Any, a: Any, b: Any) -> Any:
        return a * np.exp(-0.5 * x) + b * np.exp(-2 * x)

    y = decays(x, 2.0, np.where(np.arange(300) < 200, 1.0, 0.3))
    y += 0.01 * np.random.default_rng(1).standard_normal(300)
    bounds = {"a": (0, 5), "b": (0.1, 5)}
    free = miho.fit(decays, x[:150], y[:150], bounds, sigma=0.01)
    fit = miho.fit(decays, x[:150], y[:150], bounds, sigma=0.01, constraints=["b < a"])
    expected, run = Tracker(free, changes={"b": 0.35}), Tracker(fit, changes={"b": 0.35})
    rows = [{"x": x[k], "y": y[k]} for k in range(300)]
    for row in rows[:200]:
        expected.update(row)
        run.update(row)
    assert list(run.state.values) == ["a", "b"]
    np.testing.assert_allclose(run.state.theta, expected.state.theta, rtol=1e-3)
    np.testing.assert_allclose(run.state.covariance, expected.state.covariance, rtol=0.1)
    np.testing.assert_allclose(run.state.intervals(), expected.state.intervals(), rtol=2e-3)
    assert run.parameters().parameters["b"].value == pytest.approx(run.state.values["b"])
    assert any(run.update(row).alarm for row in rows[200:])
    assert abs(run.state.values["b"] - 0.3) < 3 * run.state.deviations[1]
    change = run.change
    assert change is not None and str(change).startswith("b fell by 7")
    with pytest.raises(ValueError, match="prior: b has a constraint; expected a fit as the prior"):
        Tracker(fit, {"b": (1.0, 0.1)})


def test_settings_start_trackers() -> None:
    settings = TrackerSettings(hazard=2e-3)
    assert isinstance(settings, OnlineMethod)
    run = settings.start(problem_of(), PRIOR, {"D": 0.35}, period=0.01)
    assert run.settings == settings and run.period == 0.01


def test_alarms_are_sentences() -> None:
    second = Alarm(12.4, "rear D", 100.0, 71.0, 3.0)
    alarm = Alarm(12.4, "front D", 1000.0, 690.0, 40.0, (second,))
    assert str(alarm) == "front D fell by 31 ± 4 % and rear D fell by 29 ± 3 % at 12.4 s"
    assert str(Alarm(1.0, "Sy", 0.0, 0.2, 0.01)) == "Sy rose by 0.2 ± 0.01 at 1.0 s"


def test_the_size_of_a_change_settles() -> None:
    run = tracker()
    before = run.change
    assert before is None
    followed(run, tire())
    change = run.change
    assert change is not None
    assert change.parameter == "D"
    assert abs(change.after / change.before - 0.65) < 3 * change.standard_error < 0.1
    assert str(change).startswith("D fell by 3")


def test_an_alarm_without_a_significant_parameter_lists_suspects() -> None:
    values, errors = np.array([1.0, 2.0, 3.0]), np.full(3, 0.5)
    change = Change(values, values + 0.5, errors, errors)
    alarm = alarm_of(change, 10.13, ("B", "C", "D"), np.array([1.0, 1.0, 0.0]))
    assert alarm.parameter is None
    assert str(alarm) == "B or C changed at 10.1 s"
    assert str(alarm.with_names(str.lower)) == "b or c changed at 10.1 s"
    small = change._replace(before_errors=errors / 10, after_errors=errors / 10)
    assert str(alarm_of(small, 10.13, ("B", "C", "D"), np.array([0.0, 0.0, 1.0]))) == (
        "D rose by 17 ± 2 % at 10.1 s"
    )


def test_a_state_is_printed_in_one_line() -> None:
    text = repr(tracker().update({"slip": 0.1, "y": 1.0}))
    assert text.startswith("TrackerState(0.00 s: B = ") and text.endswith("; alarm: None)")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"prior": {"F": (1.0, 0.1)}}, "prior: no parameter 'F'; expected one of B, D"),
        ({"prior": {"D": 1.0}}, "prior: D is 1.0; expected a value and a standard deviation"),
        ({"prior": {"D": (1.0, 0.0)}}, "prior: D is .*; expected a value and a standard deviation"),
        ({"prior": 3}, "prior is a int; expected a report"),
        ({"changes": ["D"]}, r"changes is \['D'\]; expected a number for each name"),
        ({"input_noise": 0.1}, "input_noise is 0.1; expected a number for each name"),
        ({"changes": {"F": 0.3}}, "changes: no parameter 'F'"),
        ({"changes": {"D": -0.3}}, "changes.D is -0.3; expected a positive number"),
        ({"input_noise": {"alpha": 0.1}}, "input_noise: no input 'alpha'; expected one of slip"),
        (
            {"input_noise": {"slip": -0.1}},
            "input_noise.slip is -0.1; expected a number of at least",
        ),
        ({"hazards": 0.1}, "no setting 'hazards'; expected one of hazard"),
        ({"hazard": "rare"}, "hazard is 'rare'; expected a number between 0 and 1"),
        ({"hazard": 0.0}, "hazard is 0.0; expected a number between 0 and 1"),
        ({"drifts": (1.0, 2.0)}, "drifts is .*; expected three numbers"),
        ({"slots": 3}, "slots is 3; expected a whole number of at least 4"),
        ({"threshold": float("nan")}, "threshold is nan; expected a number, or inf for never"),
        ({"period": 0.0}, "period is 0.0; expected a positive number"),
    ],
)
def test_errors_are_sentences(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Tracker(problem_of(), **given)


def test_a_fit_gives_the_noise_whatever_the_prior() -> None:
    x = np.linspace(0, 1, 20)
    noisy = miho.fit(lambda x, *, a: a * x, x, 2 * x + 0.1 * (-1.0) ** np.arange(20), {"a": (0, 5)})
    tracked = Tracker(noisy, prior={"a": (2.1, 0.2)})
    assert tracked.system.sigma == pytest.approx(0.1, rel=0.1)
    assert tracked.state.values["a"] == pytest.approx(2.1)


def test_errors_of_problems_and_rows() -> None:
    problem = problem_of()
    with pytest.raises(ValueError, match="expected a CurveFit"):
        Tracker([])
    fit: Any = force
    with pytest.raises(ValueError, match="expected a CurveFit, one for each output, or a fit"):
        Tracker(fit)
    with pytest.raises(ValueError, match="the output 'y' occurs twice"):
        Tracker([problem, problem])
    with pytest.raises(ValueError, match="has no sigma; give sigma, or its fit as the prior"):
        Tracker(CurveFit(force, problem.dataset, problem.space))
    x = np.linspace(0, 1, 20)
    exact = miho.fit(
        lambda x, *, a, b: a * np.exp(-b * x), x, np.exp(-x), {"a": (0, 2), "b": (0, 2)}
    )
    with pytest.raises(ValueError, match=r"no errors, .*; give its .* as sigma of miho\.fit$"):
        Tracker(exact)
    line, box = lambda x, *, a: a * x, {"a": (0, 5)}
    noisy = miho.fit(line, x, 2 * x + 0.1 * (-1.0) ** np.arange(20), box)
    tracked = Tracker(miho.fit(line, x, 2 * x, box), prior=noisy)
    assert tracked.system.sigma == pytest.approx(0.1, rel=0.1)
    assert Tracker(miho.fit(force, problem.dataset.columns, "y", problem.space, sigma=0.1))
    parts = {name: (lambda x, *, a: a * x, x, 2 * x) for name in ("left", "right")}
    with pytest.raises(ValueError, match=r"the fit of left has no errors.*miho\.fit_joint$"):
        Tracker(miho.fit_joint(parts, {"a": (0, 5)}))
    tracked = Tracker(miho.fit_joint({n: (*p, 0.1) for n, p in parts.items()}, {"a": (0, 5)}))
    assert tracked.system.sigma.tolist() == [0.1, 0.1]
    small = miho.fit_joint({n: (*p, 3e-12) for n, p in parts.items()}, {"a": (0, 5)})
    assert Tracker(small).system.sigma.tolist() == [3e-12, 3e-12]
    with pytest.raises(ValueError, match=r"the fit of right has no errors"):
        Tracker(miho.fit_joint({**parts, "left": (*parts["left"], 0.1)}, {"a": (0, 5)}))
    narrow = Space((Parameter("B", "", 0.0, 20.0), Parameter("D", "", 0.0, 2.0)))
    other = Dataset("other", {"slip": np.ones(2), "z": np.arange(2.0)}, {"slip": "", "z": ""}, "z")
    with pytest.raises(ValueError, match="B has the bounds -50 to 50"):
        Tracker([problem, CurveFit(force, other, narrow, sigma=1.0)])
    run = tracker()
    with pytest.raises(ValueError, match="no column 'y'; expected slip, y, and NaN for a missing"):
        run.update({"slip": 0.1})
    with pytest.raises(ValueError, match=r"column 'y' has the shape \(2,\); expected \(3,\)"):
        run.update({"slip": [0.1, 0.2, 0.3], "y": [1.0, 2.0]})
    with pytest.raises(ValueError, match="column 'y' is 'one'; expected numbers"):
        run.update({"slip": 0.1, "y": "one"})
    with pytest.raises(ValueError, match="column 'time' is 1j; expected numbers"):
        run.update({"slip": 0.1, "y": 1.0, "time": 1j})
    rows: Any = [{"slip": 0.1, "y": 1.0}]
    with pytest.raises(ValueError, match="rows is a list; expected a Dataset, or columns by name"):
        run.update(rows)
    with pytest.raises(ValueError, match="level is 95; expected a number between 0 and 1"):
        run.parameters(level=95)
    with pytest.raises(ValueError, match="no row has informed 'y'"):
        run.dataset()
    with pytest.raises(ValueError, match="output is 'z'; expected one of y"):
        run.dataset("z")


def test_a_model_with_memory_is_refused() -> None:
    def cumulated(x: Any, *, a: Any) -> Any:
        return a * np.cumsum(x)

    x = np.linspace(0.5, 1, 20)
    with pytest.raises(ValueError, match="needs all rows in order; expected a model of each row"):
        Tracker(problem_of(cumulated, x=x, y=np.cumsum(x)))


def test_a_fit_is_the_problem_and_the_prior_as_its_report_is() -> None:
    x = np.linspace(0.5, 1.5, 30)
    y = 2 * x + 0.05 * np.random.default_rng(0).standard_normal(30)
    fit = miho.fit(lambda x, a: a * x, x, y, {"a": (0, 5)})
    row = {"x": 1.0, "y": 2.1}
    expected = Tracker(fit.report()).update(row)
    for tracker in (Tracker(fit), Tracker(fit.report(), prior=fit)):
        assert tracker.update(row).values == expected.values


def test_a_parameter_that_the_fit_does_not_know_may_be_anywhere_in_its_bounds() -> None:
    """Without z the data say nothing about b, so its estimate is the start, near a bound."""
    x = np.linspace(0.5, 1.5, 30)
    rows = {"x": x, "z": 0 * x, "y": 2 * x + 0.05 * np.random.default_rng(0).standard_normal(30)}
    bounds = {"a": (0, 5), "b": (0, 5)}
    fit = miho.fit(lambda x, z, a, b: a * x + b * z, rows, "y", bounds, start={"a": 1, "b": 4.9})
    assert fit.values["b"] == pytest.approx(4.9)
    low, high = Tracker(fit).state.intervals()[1]
    assert (low, high) == (0, 5)


@pytest.mark.parametrize("seed", [0, 11])  # estimates of -0.8 and 2 standard errors
@pytest.mark.parametrize("known", [{"space": {"a": (-5, 5)}}, {"start": {"a": 0.0}}])
def test_a_parameter_that_is_almost_0_may_jump(known: dict[str, Any], seed: int) -> None:
    """A share of its value is no size, so the bounds or, if they are wide, its error give one."""
    rng = np.random.default_rng(seed)
    x, noise = rng.uniform(-1, 1, 400), 0.02 * rng.standard_normal(400)
    y = np.where(np.arange(400) < 200, 0.0, 0.8) * x + noise
    tracker = Tracker(miho.fit(lambda x, a: a * x, x[:60], y[:60], **known))
    states = [tracker.update({"x": x[k], "y": y[k]}) for k in range(60, 400)]
    [alarm] = [state.alarm for state in states if state.alarm]
    assert str(alarm).startswith("a rose by 0.8")
    low, high = states[-1].intervals()[0]
    assert low < 0.8 < high


def test_a_positive_parameter_that_is_hardly_known_jumps_by_a_share_of_its_value() -> None:
    rng = np.random.default_rng(0)
    x, noise = rng.uniform(-1, 1, 700), 0.05 * rng.standard_normal(700)
    y = np.where(np.arange(700) < 600, 1.2, 0.9) * x + noise
    data = miho.Dataset("line", {"x": x[:50], "y": y[:50]}, {"x": "", "y": ""}, "y")
    space = miho.Space((miho.Parameter("a", "", 0, 100),))
    problem = miho.CurveFit(lambda x, *, a: a * x, data, space, sigma=0.05)
    tracker = Tracker(problem, prior={"a": (1.0, 0.45)})
    states = [tracker.update({"x": x[k], "y": y[k]}) for k in range(700)]
    [alarm] = [state.alarm for state in states if state.alarm]
    assert str(alarm).startswith("a fell by")


@pytest.mark.parametrize("sigma", [None, 0.1])
@pytest.mark.parametrize("seed", [5, 6, 9])
def test_errors_that_a_filter_has_correlated_are_no_change(seed: int, sigma: float | None) -> None:
    """Errors after a low pass of first order, in constant parameters."""
    rng, n = np.random.default_rng(seed), 2500
    x, errors = np.sin(0.02 * np.arange(n)), rng.standard_normal(n)
    for k in range(1, n):
        errors[k] = 0.8 * errors[k - 1] + 0.2 * errors[k]
    rows = {"x": x, "y": 2 * x + 1 + 0.3 * errors}
    learned = {name: column[:600] for name, column in rows.items()}
    tracker = Tracker(miho.fit(line, learned, "y", {"a": (0, 5), "b": (0, 5)}, sigma=sigma))
    states = [tracker.update({"x": x[k], "y": rows["y"][k]}) for k in range(600, n)]
    assert not any(state.alarm for state in states)
