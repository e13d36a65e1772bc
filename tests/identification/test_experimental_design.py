"""Which rows to measure next: textbook designs, exhaustive search, and bad input."""

import itertools
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pandas as pd
import pytest
import scipy.stats

import miho
from miho.data import Dataset
from miho.identification import CurveFit, Design, Report, make_report, optimal_design
from miho.identification.exchange import Information, best_groups
from miho.models.model import Array, DifferencedModel, Model
from miho.optim import Parameter, Space
from tests.identification.published import line, puromycin
from tests.printed import flat


class Plane(DifferencedModel):
    """y = a u + b v."""

    inputs = MappingProxyType({"u": "rad", "v": "N"})
    parameters = MappingProxyType({"a": "-", "b": "-"})
    output = "-"

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        a, b = thetas.T[:, :, None]
        return np.asarray(a * inputs[0] + b * inputs[1])


class Memory(Plane):
    """y = a u + b times the sum of v so far."""

    ordered = True

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        return super().predict(thetas, inputs[0], np.cumsum(inputs[1]))


def quick(problem: CurveFit, theta: list[float]) -> Report:
    return make_report(problem, np.array(theta), profiles=False)


def straight_line() -> Report:
    """Ten rows, symmetric about 0."""
    x = np.linspace(-0.5, 0.5, 10)
    y = 1 + 2 * x + 0.1 * np.random.default_rng(0).standard_normal(10)
    return quick(line(y, x), [1.0, 2.0])


def plane(model: Model, v: Array, **columns: Array) -> CurveFit:
    rng = np.random.default_rng(1)
    u = rng.uniform(0.5, 1, v.size)
    y = model.predict(np.array([[2.0, 3.0]]), u, v)[0] + 0.1 * rng.standard_normal(v.size)
    units = {"u": "rad", "v": "N", "y": "-"} | dict.fromkeys(columns, "-")
    data = Dataset("plane", {"u": u, "v": v, "y": y, **columns}, units, "y")
    return CurveFit(
        model, data, Space((Parameter("a", "-", -10, 10), Parameter("b", "-", -10, 10)))
    )


def expected(design: Design, name: str, column: str = "expected half width") -> float:
    return float(design.table.set_index("quantity").loc[name, column])


@pytest.mark.parametrize("goal", [None, "b"])
def test_a_line_is_measured_at_both_ends(goal: str | None) -> None:
    """Half at each end is D-optimal, and best for the slope (Fedorov 1972, Ch. 2)."""
    report = straight_line()
    design = optimal_design(report, {"x": np.linspace(-1, 1, 21)}, 10, goal=goal, repeats=5)
    assert design.chosen["x"].tolist() == [-1.0] * 5 + [1.0] * 5
    # The slope's variance is that of the noise over the sum of squares: 10 more, of 18 rows.
    spread = np.sum(report.problem.inputs[0] ** 2) + 10
    half = scipy.stats.t.ppf(0.975, 18) * report.at.noise / np.sqrt(spread)
    assert expected(design, "b") == pytest.approx(half, rel=1e-12)
    assert expected(design, "b", "present half width") == pytest.approx(
        np.diff(report.at.intervals())[1, 0] / 2, rel=1e-12
    )
    even = np.sum(report.problem.inputs[0] ** 2) + 10 * np.mean(np.linspace(-1, 1, 21) ** 2)
    assert expected(design, "b", "evenly half width") == pytest.approx(
        half * np.sqrt(spread / even), rel=1e-12
    )


def test_michaelis_menten_is_measured_at_two_concentrations() -> None:
    """At the largest, s, and at K s / (2 K + s) (Duggleby, J. Theor. Biol. 81, 1979, p. 671).

    The twelve present rows count little beside 2000; the levels lie 1 % apart.
    """
    report = quick(puromycin(), [212.7, 0.0641])
    K, s = report.at.theta[1], 2.0
    levels = np.geomspace(0.01, s, 533)
    design = optimal_design(report, levels, 2000, repeats=2000)
    values, counts = np.unique(design.chosen["x"], return_counts=True)
    assert values[-1] == s
    np.testing.assert_allclose(values[:-1], K * s / (2 * K + s), rtol=0.015)
    assert counts[-1] == pytest.approx(1000, abs=15)


@pytest.mark.parametrize("target", [False, True])
def test_exchange_finds_what_exhaustive_search_does(target: bool) -> None:
    """Of 495 choices the best, or one as good to 2 %: exchange ends in a local optimum."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        X, c = rng.standard_normal((12, 3)), rng.standard_normal(3)

        def value(rows: Array, X: Array = X, c: Array = c) -> float:
            inverse = np.linalg.inv(np.eye(3) + X[rows].T @ X[rows])
            return float(c @ inverse @ c if target else np.linalg.det(inverse) ** (1 / 3))

        counts = best_groups(X[:, None, :], 4, c if target else None)
        assert counts.sum() == 4
        best = min(value(np.array(rows)) for rows in itertools.combinations(range(12), 4))
        assert value(np.flatnonzero(counts)) <= 1.02 * best


@pytest.mark.parametrize("rows", [1, 3])
def test_information_is_updated_as_it_is_computed_anew(rows: int) -> None:
    """Rank-one updates round by some 1e-16 of the covariance each."""
    rng = np.random.default_rng(0)
    blocks, c = rng.standard_normal((6, rows, 4)), rng.standard_normal(4)
    for target in (None, c):
        information = Information(blocks, target)
        for group in (1, 4, 4, 2):
            information.add(group)
        information.add(2, -1)
        M = np.eye(4) + sum(blocks[k].T @ blocks[k] for k in (1, 4, 4))
        after = [np.linalg.inv(M + block.T @ block) for block in blocks]
        if target is None:
            gains = [-np.linalg.slogdet(V @ M)[1] for V in after]
        else:
            gains = [c @ np.linalg.inv(M) @ c - c @ V @ c for V in after]
        np.testing.assert_allclose(information.gains(), gains, rtol=1e-10)


def test_whole_sweeps_are_chosen() -> None:
    """The best two of six sweeps, by trying all pairs; each gain alone as well."""
    report = quick(plane(Plane(), np.linspace(1, 2, 20)), [2.0, 3.0])
    rng = np.random.default_rng(0)
    rows = pd.DataFrame({"v": rng.uniform(0, 3, 30), "u": rng.uniform(0, 2, 30)})
    rows["sweep"] = rng.permuted(np.repeat([10, 20, 30, 40, 50, 60], 5))
    design = optimal_design(report, rows, 2, groups="sweep", goal="a")
    J = np.column_stack(report.problem.inputs)

    def half_width(sweeps: tuple[int, ...]) -> float:
        all_rows = np.vstack([J, rows.loc[rows["sweep"].isin(sweeps), ["u", "v"]]])
        variance = report.at.noise**2 * np.linalg.inv(all_rows.T @ all_rows)[0, 0]
        return float(np.sqrt(variance) * scipy.stats.t.ppf(0.975, len(all_rows) - 2))

    pairs = {pair: half_width(pair) for pair in itertools.combinations(rows["sweep"].unique(), 2)}
    assert set(design.chosen["sweep"]) == set(min(pairs, key=lambda pair: pairs[pair]))
    assert expected(design, "a") == pytest.approx(min(pairs.values()), rel=1e-8)
    present = np.linalg.inv(J.T @ J)[0, 0]
    for sweep, gain in zip(rows["sweep"].unique(), design.gains["narrows a by %"], strict=True):
        more = np.vstack([J, rows.loc[rows["sweep"] == sweep, ["u", "v"]]])
        fall = np.sqrt(np.linalg.inv(more.T @ more)[0, 0] / present)
        assert gain == pytest.approx(100 * (1 - fall), rel=1e-6)


def test_what_the_data_do_not_determine() -> None:
    report = quick(plane(Plane(), np.zeros(20)), [2.0, 3.0])
    design = optimal_design(report, {"u": [0.5], "v": [0.0, 1000.0, 4000.0]}, 4, repeats=4)
    assert design.chosen["v"].tolist() == [4000.0] * 4
    u = report.problem.inputs[0]
    variance = report.at.noise**2 * np.linalg.inv(
        [[np.sum(u**2) + 1, 4 * 0.5 * 4000], [4 * 0.5 * 4000, 4 * 4000.0**2]]
    )
    half = scipy.stats.t.ppf(0.975, 24 - 2) * np.sqrt(variance[1, 1])
    assert expected(design, "b") == pytest.approx(half, rel=1e-8)
    assert "b, which the present data do not determine, to ±" in flat(design)
    assert "the present data do not determine b; these rows would" in flat(design)
    assert "4 rows at v 4 kN would" in flat(design)
    assert "4 of the rows lie beyond the data, which have v 0 N" in flat(design)

    blind = optimal_design(report, {"u": [0.5, 0.7], "v": [0.0]}, 2)
    assert blind.undeterminable == ["b"]
    assert "no candidate determines b" in flat(blind)
    only_a = optimal_design(report, {"u": [0.5, 9.0], "v": [0.0, 1.0]}, 1, goal="a")
    assert only_a.chosen.to_numpy().tolist() == [[9.0, 0.0]]
    assert "but other candidates would" in flat(only_a)


def test_a_parameter_at_its_bound_is_left_out() -> None:
    x = np.linspace(-0.5, 0.5, 10)
    y = 1 + 2 * x + 0.1 * np.random.default_rng(0).standard_normal(10)
    report = quick(line(y, x, b=(-1, 1)), [1.0, 1.0])
    design = optimal_design(report, {"x": [0.0, 0.4]}, 1)
    assert design.table["quantity"].tolist() == ["a"]
    assert "fixed at a bound, and left out here: b" in flat(design)


def test_widths_of_dependent_rows_fall_by_the_factor_of_independent_ones() -> None:
    event = np.repeat(np.arange(5.0), 4)
    problem = plane(Plane(), np.linspace(1, 2, 20), event=event)
    report = quick(problem, [2.0, 3.0])
    design = optimal_design(report, {"u": [0.5, 1.0], "v": [0.5, 2.5]}, 4)
    J = np.column_stack(problem.inputs)
    more = np.vstack([J, design.chosen])
    fall = np.sqrt(np.diag(np.linalg.inv(more.T @ more)) / np.diag(np.linalg.inv(J.T @ J)))
    np.testing.assert_allclose(
        design.table["expected half width"] / design.table["present half width"], fall, rtol=1e-8
    )
    assert "are correlated" in flat(design)


def test_errors_that_follow_a_column_are_no_noise() -> None:
    problem = plane(Plane(), np.linspace(1, 2, 40), w=np.zeros(40))
    data = problem.dataset
    rng = np.random.default_rng(2)
    w = rng.uniform(0, 1, 40)
    columns = {**data.columns, "w": w, "y": data["y"] + np.sin(6 * w)}
    report = quick(replace(problem, dataset=replace(data, columns=columns)), [2.0, 3.0])
    design = optimal_design(report, {"u": [0.5, 1.0], "v": [0.5, 2.5]}, 1)
    assert "of the errors' variance follows w: this part is not noise" in flat(design)
    assert "this part is not noise" not in flat(optimal_design(straight_line(), {"x": [1.0]}, 1))
    x = np.linspace(0, 1, 300)  # one sweep, along which drift would show as well
    noise = 0.02 * np.random.default_rng(0).standard_normal(300)
    swept = optimal_design(quick(line(np.sin(6 * x) + noise, x), [0.0, 0.0]), {"x": [1.0]}, 1)
    assert "or the measurement drifts in addition to its noise; repeat the measure" in flat(swept)


def test_a_model_with_a_memory_runs_each_group_by_itself() -> None:
    report = quick(plane(Memory(), np.linspace(0.1, 0.2, 20)), [2.0, 3.0])
    rows = pd.DataFrame({"u": 0.7, "v": [1.0, 1.0, 1.0, 0.5, -0.5, 2.0], "run": [0, 0, 0, 1, 1, 1]})
    design = optimal_design(report, rows, 1, goal="b", groups="run")
    assert design.chosen["run"].tolist() == [0, 0, 0]  # sums 1, 2, 3 against 0.5, 0, 2
    with pytest.raises(ValueError, match="expected the column that numbers the manoeuvres"):
        optimal_design(report, rows, 1)


@pytest.mark.parametrize("goal", [None, "b", "c"])
def test_a_wide_range_that_the_data_leave_open_is_not_lost_in_rounding(goal: str | None) -> None:
    """All present rows are at x = 0. The best 4 of 9 further ones are those of all 126 choices."""
    y = 1 + 1e-3 * np.random.default_rng(0).standard_normal(10)
    wide = {"a": (-10, 10), "b": (-1e9, 1e9), "c": (-1e9, 1e9)}
    fit = miho.fit(lambda x, a, b, c: a + b * x + c * x**2, np.zeros(10), y, wide)
    x = np.linspace(-1, 1, 9)

    def criterion(chosen: tuple[int, ...]) -> float:
        information = np.vander(np.r_[np.zeros(10), x[list(chosen)]], 3, increasing=True)
        information = information.T @ information
        if np.linalg.matrix_rank(information) < 3:
            return np.inf
        covariance = np.linalg.inv(information)
        return float(
            np.linalg.det(covariance) if goal is None else np.diag(covariance)["abc".find(goal)]
        )

    best = min(itertools.combinations(range(9), 4), key=criterion)
    chosen = tuple(optimal_design(fit, {"x": x}, 4, goal=goal).chosen.index)
    assert criterion(chosen) == pytest.approx(criterion(best))


def test_a_row_that_alone_determines_a_direction_can_be_exchanged() -> None:
    """Its leverage is 1 to 3e-9, so taking it away again would lose all digits."""
    rows = np.vstack([1e4 * np.array([1.0, 1.0, -1.0]), 1e-12 * np.eye(3), np.zeros((3, 3))])
    assert best_groups(rows[:, None, :], 4)[0] == 1


@pytest.mark.parametrize(
    ("candidates", "settings", "message"),
    [
        (
            {"z": [1.0]},
            {},
            "candidates: no column 'x'; expected rows with all inputs of the model, x",
        ),
        (pd.DataFrame({"x": []}), {}, "candidates: no rows"),
        (pd.DataFrame({"x": [1, "b"]}), {}, r"'x' in row 1 \(from 0\) is 'b'; expected a finite"),
        ({"x": ["b"]}, {}, r"'x' in row 0 \(from 0\) is 'b'; expected a finite"),
        ({"x": [1.0, np.inf]}, {}, r"'x' in row 1 \(from 0\) is (np.float64\()?inf"),
        ({"x": [1.0]}, {"size": 0}, "size is 0; expected a whole number of at least 1"),
        ({"x": [1.0]}, {"size": 2}, "size is 2; expected at most 1, as each of 1 candidates"),
        ({"x": [1.0]}, {"repeats": 0}, "repeats is 0"),
        ({"x": [1.0]}, {"goal": "c"}, "goal is 'c'; choose from a; b; or None for all"),
        ({"x": [1.0]}, {"groups": "sweep"}, "groups is 'sweep'; expected one of the columns x"),
    ],
)
def test_bad_input(candidates: object, settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        optimal_design(straight_line(), candidates, **{"size": 1, **settings})  # type: ignore[arg-type]
    assert "\n" not in str(error.value)


def test_candidates_in_other_units_and_data_without_noise() -> None:
    rows = Dataset("more", {"x": np.array([1.0, 2.0])}, {"x": "m"}, "x")
    with pytest.raises(ValueError, match="'x' is in m; expected -, the unit of the model"):
        optimal_design(straight_line(), rows, 1)
    x = np.linspace(0, 1, 5)
    exact = quick(line(1 + 2 * x, x), [1.0, 2.0])
    with pytest.raises(ValueError, match="reproduced to rounding"):
        optimal_design(exact, {"x": [2.0]}, 1)


def test_a_goal_at_a_bound_and_a_fit_at_its_bounds() -> None:
    x = np.linspace(0, 1, 9)
    y = 2 + 3 * x + 0.1 * np.sin(9 * x)
    fit = miho.fit(lambda x, a, b: a + b * x, x, y, {"a": (0, 9), "b": (0, 1)})
    with pytest.raises(ValueError, match="goal is 'b', which is at a bound; choose from a; or"):
        optimal_design(fit, {"x": x}, 1, goal="b")
    fit = miho.fit(lambda x, a, b: a + b * x, x, y, {"a": (0, 1), "b": (0, 1)})
    with pytest.raises(ValueError, match="every parameter is at a bound; widen the bounds"):
        optimal_design(fit, {"x": x}, 1)


def test_a_fit_is_designed_for_as_its_report_is() -> None:
    x = np.linspace(-1, 1, 30)
    y = 2 * x + 0.05 * np.random.default_rng(0).standard_normal(30)
    fit = miho.fit(lambda x, a: a * x, x, y, {"a": (0, 5)})
    of_fit, of_report = (optimal_design(of, {"x": x}, 3) for of in (fit, fit.report()))
    assert str(of_fit) == str(of_report)


def test_a_polynomial_in_calendar_years_is_designed_for() -> None:
    x = np.linspace(1990, 2020, 60)
    y = ((x - 2005) / 15) ** 4 + 0.1 * np.random.default_rng(0).standard_normal(x.size)
    fit = miho.fit(
        lambda x, a, b, c, d, e: a + b * x + c * x**2 + d * x**3 + e * x**4,
        x, y, dict.fromkeys("abcde", (-1e12, 1e12)),
    )  # fmt: skip
    half = optimal_design(fit, {"x": np.linspace(1980, 2030, 9)}, 3).table
    assert (half["expected half width"] < half["present half width"]).all()


def test_the_expected_uncertainty_is_for_independent_errors() -> None:
    x, rng = np.linspace(0, 5, 200), np.random.default_rng(0)
    errors = scipy.signal.lfilter([0.05], [1, -0.9], rng.standard_normal(x.size))
    fit = miho.fit(lambda x, a, b: a * np.exp(-b * x), x, 2 * np.exp(-x) + errors,
                   {"a": (0, 5), "b": (0, 5)})  # fmt: skip
    assert fit.uncertainty.dependence is not None
    assert optimal_design(fit, {"x": x[::20]}, 2).expected.dependence is None
