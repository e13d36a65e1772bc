"""`miho.fit_many`, against SciPy's fit of each dataset alone."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.optimize import curve_fit

import miho
from miho.core import machine
from miho.fitting.search import searched
from miho.identification import CurveFit
from miho.models.model import rows_of
from miho.vehicle.models import Pacejka

BOX = {"a": (0, 10), "b": (0.05, 20), "c": (-5, 5)}
t = np.linspace(0, 3, 50)
rng = np.random.default_rng(0)
TRUTH = np.stack([rng.uniform(0.5, 5, 60), rng.uniform(0.3, 5, 60), rng.uniform(-1, 1, 60)], 1)


def decay(t, a, b, c):
    return a * np.exp(-b * t) + c


def opaque(t, a, b, c):
    return decay(np.asarray(t), a, b, c)


y = np.array([decay(t, *theta) for theta in TRUTH]) + 0.02 * rng.standard_normal((60, 50))
NAMES = ["a", "b", "c"]
ERRORS = ["a_error", "b_error", "c_error"]


@pytest.mark.parametrize("model", [decay, opaque])
def test_each_is_scipys_fit(model) -> None:
    table = miho.fit_many(model, t, y, BOX)
    assert table["converged"].all()
    assert table.attrs["better"] == 0
    for k in range(0, 60, 7):
        theta, covariance = curve_fit(decay, t, y[k], TRUTH[k], xtol=1e-12)
        # Both end where the sum of squares changes by 1e-10 of itself or less.
        assert table.loc[k, NAMES].tolist() == pytest.approx(theta, rel=1e-4)
        errors = np.sqrt(np.diag(covariance))
        assert table.loc[k, ERRORS].tolist() == pytest.approx(errors, rel=1e-3)


def test_groups_of_a_frame_may_differ_in_length_and_columns() -> None:
    frames = []
    for k in range(8):
        rows = slice(0, 30 + 2 * k)
        frames.append(pd.DataFrame({"run": f"r{k}", "t": t[rows] + 0.01 * k, "V": y[k, rows]}))
    table = miho.fit_many(decay, pd.concat(frames), "V", BOX, by="run")
    assert list(table.index) == [f"r{k}" for k in range(8)]
    assert table["rows"].tolist() == [30 + 2 * k for k in range(8)]
    for k, frame in enumerate(frames):
        theta, _ = curve_fit(decay, frame["t"], frame["V"], TRUTH[k], xtol=1e-12)
        assert table.loc[f"r{k}", NAMES].tolist() == pytest.approx(theta, rel=1e-4)


def test_groups_by_several_columns_have_an_index_of_several_levels() -> None:
    frames = [
        pd.DataFrame({"car": "AB"[k // 2], "lap": k % 2, "t": t, "V": y[k]}) for k in range(4)
    ]
    table = miho.fit_many(decay, pd.concat(frames), "V", BOX, by=["car", "lap"])
    assert table.index.names == ["car", "lap"]
    assert table.loc[("B", 1), "a"] == pytest.approx(
        miho.fit_many(decay, t, y[3:4], BOX)["a"][0], rel=1e-6
    )
    for by in ([], ["car", "run"], 3):
        with pytest.raises(ValueError, match="expected the names of columns of a data frame x"):
            miho.fit_many(decay, frames[0], "V", BOX, by=by)


ALPHA = np.linspace(-0.15, 0.15, 40)
TIRE = Pacejka()
TIRE_BOX = {"B": (2, 40), "C": (1, 2.5), "D": (1e3, 9e3), "Sx": (-0.05, 0.05), "Sy": (-500, 500)}


def _forces(count: int) -> NDArray[np.float64]:
    curve = TIRE.predict(np.array([[12.0, 1.5, 4000.0, 0.0, 50.0]]), ALPHA)[0]
    return curve + np.random.default_rng(4).normal(0, 100, (count, ALPHA.size))


@pytest.mark.parametrize("wrong", [0, 20, 39])
def test_degrees_and_signs_of_each_dataset_are_checked(wrong: int) -> None:
    forces = _forces(40)
    alpha = np.tile(ALPHA, (40, 1))
    alpha[wrong] = np.rad2deg(ALPHA)
    with pytest.raises(ValueError, match=rf"^dataset {wrong}: alpha, row 1: .* column in deg"):
        miho.fit_many(TIRE, alpha, forces, TIRE_BOX)
    forces[wrong] *= -1
    with pytest.raises(ValueError, match=rf"^dataset {wrong}: Fy: Fy rises with alpha"):
        miho.fit_many(TIRE, ALPHA, forces, TIRE_BOX)
    frame = pd.DataFrame({"alpha": np.tile(ALPHA, 40), "F": forces.ravel()})
    frame["run"] = [f"r{k // 40}" for k in range(1600)]
    with pytest.raises(ValueError, match=rf"^dataset r{wrong}: Fy: Fy rises with alpha"):
        miho.fit_many(TIRE, frame, "F", TIRE_BOX, by="run")


def test_datasets_of_a_convention() -> None:
    table = miho.fit_many(TIRE, ALPHA, _forces(3), TIRE_BOX)
    reversed_ = miho.fit_many(TIRE, ALPHA, -_forces(3), TIRE_BOX, convention="adapted-sae")
    pd.testing.assert_frame_equal(table, reversed_)
    meant = miho.fit_many(TIRE, ALPHA, -_forces(3), TIRE_BOX | {"D": (-9e3, -1e3)})
    assert (meant["D"] < 0).all()
    with pytest.raises(ValueError, match="expected for the data of a tire only"):
        miho.fit_many(decay, t, y, BOX, convention="sae")


def test_a_simulation_gets_the_rows_of_each_dataset_alone() -> None:
    """Whose times rise to the last row; the lengths differ, and so do those of equal times."""

    def summed(t, a, b):
        assert (np.diff(t) > 0).all()
        return np.cumsum(a * np.exp(-b * t))

    lengths = [50, 40, 50, 30, 50, 40]
    frames = [
        pd.DataFrame({"run": k, "t": t[:n], "V": summed(t[:n], *TRUTH[k, :2]) + y[k, :n] / 100})
        for k, n in enumerate(lengths)
    ]
    box = {"a": (0, 10), "b": (0.05, 20)}
    table = miho.fit_many(summed, pd.concat(frames), "V", box, by="run")
    for k, frame in enumerate(frames):
        theta, _ = curve_fit(summed, frame["t"], frame["V"], TRUTH[k, :2], xtol=1e-12)
        assert table.loc[k, ["a", "b"]].tolist() == pytest.approx(theta, rel=1e-4)


def test_tied_and_fixed_parameters_have_columns_too() -> None:
    table = miho.fit_many(decay, t, y[:2], {"a": (0, 10)}, fixed={"c": 0.1}, tied={"b": "2 * a"})
    assert (table["c"] == 0.1).all()
    assert (table["c_error"] == 0).all()
    assert table["b"].tolist() == pytest.approx((2 * table["a"]).tolist())
    assert table["b_error"].tolist() == pytest.approx((2 * table["a_error"]).tolist())
    theta, _ = curve_fit(lambda t, a: a * np.exp(-2 * a * t) + 0.1, t, y[1], 2.0, xtol=1e-12)
    assert table.loc[1, "a"] == pytest.approx(theta[0], rel=1e-4)


@pytest.mark.skipif(machine() is None, reason="there is no machine")
def test_a_descent_that_ends_at_the_edge_of_what_has_values_has_not_converged() -> None:
    lines = 1 + 2 * t + 0.01 * rng.standard_normal((3, 50))
    box, start = {"a": (-10, 10), "b": (0, 5)}, {"a": 0.0, "b": 0.5}
    table = miho.fit_many(
        lambda t, a, b: a + b * t + 0 * np.sqrt(1 - b), t, lines, box, start=start
    )
    assert table["b"].tolist() == pytest.approx([1.0] * 3)
    assert not table["converged"].any()


@pytest.mark.parametrize("unit", [1e20, 1e-20])
def test_the_unit_of_a_parameter_does_not_matter(unit: float) -> None:
    box, start = {**BOX, "a": (0, 10 * unit)}, {"a": 1.3 * unit, "b": 0.5, "c": 0.0}
    plain = miho.fit_many(decay, t, y[:9], BOX)
    for given in (None, start):
        table = miho.fit_many(
            lambda t, a, b, c: decay(t, a / unit, b, c), t, y[:9], box, start=given
        )
        assert table["converged"].all()
        assert (table["a"] / unit).tolist() == pytest.approx(plain["a"].tolist(), rel=1e-6)
        assert (table["a_error"] / unit).tolist() == pytest.approx(
            plain["a_error"].tolist(), rel=1e-5
        )


@pytest.mark.parametrize("on_machine", [True, False])
def test_what_the_data_do_not_determine_has_an_infinite_error(on_machine) -> None:
    def sums(t, a, b, c, d):
        t = t if on_machine else np.asarray(t)
        return (a + c) * np.exp(-b * t) + d * d * 0.0

    box = {"a": (0, 10), "b": (0.05, 20), "c": (-5, 5), "d": (-1, 1)}
    table = miho.fit_many(sums, t, y[:3], box, start={"a": 1.0, "b": 1.0, "c": 1.0, "d": 0.5})
    assert np.isinf(table[["a_error", "c_error", "d_error"]]).all(axis=None)
    alone = miho.fit_many(
        lambda t, a, b: a * np.exp(-b * t), t, y[:3], {"a": (0, 20), "b": (0, 20)}
    )
    assert table["b_error"].tolist() == pytest.approx(
        (alone["b_error"] * np.sqrt(48 / 46)).tolist(), rel=1e-3
    )
    tied = miho.fit_many(sums, t, y[:3], box, tied={"a": "2 * c"})
    assert np.isfinite(tied[["a_error", "c_error"]]).all(axis=None)
    assert np.isinf(tied["d_error"]).all()


@pytest.mark.parametrize("model", [decay, opaque])
def test_an_effect_whose_inverse_square_overflows_counts_as_none(model) -> None:
    """A second peak far beyond the rows: its slopes are 1e-160."""

    def peaks(t, a, b, d, m):
        return model(t, a, b, 0) + d * np.exp(-((t - m) ** 2))

    table = miho.fit_many(
        peaks, t, y[:2], {"a": (0, 10), "b": (0.05, 20), "d": (0, 1), "m": (22, 22.4)}
    )
    assert np.isfinite(table[["a_error", "b_error"]]).all(axis=None)
    assert not np.isfinite(table[["d_error", "m_error"]]).any(axis=None)


@pytest.mark.slow
def test_a_parameter_at_its_bound_has_no_error() -> None:
    table = miho.fit_many(decay, t, y[:2], {**BOX, "a": (0, 0.2)})
    assert (table["a"] == 0.2).all()
    assert table["a_error"].isna().all()


PHASES = np.random.default_rng(4).uniform(0.5, 9.0, 40)


@pytest.mark.slow
@pytest.mark.parametrize("top", [10, 200])
def test_many_optima_are_told_of(monkeypatch: pytest.MonkeyPatch, top: float) -> None:
    """A sine's period: descents of what is no formula end in wrong ones without common starts, and
    so do those of a formula in a box that has hundreds of optima."""
    monkeypatch.setattr("miho.fitting.many_fits.BEST", 0)
    rng = np.random.default_rng(0)
    rises = np.sort(rng.uniform(0, 3, 50))
    rates = rng.uniform(0.5, top, 40)
    waves = np.sin(rates[:, None] * 4 * rises) + 0.01 * rng.standard_normal((40, 50))

    def wave(t, w):
        return np.sin(w * 4 * (t if top > 10 else np.asarray(t)))

    with pytest.warns(UserWarning, match="from which all have descended now; the 20 others"):
        table = miho.fit_many(wave, rises, waves, {"w": (0.1, top)})
    assert table.attrs["better"] > 0
    if top > 10:  # datasets of other models are all searched if there are so few
        with pytest.warns(UserWarning, match="of 10 datasets .* descended now; narrow the bounds"):
            miho.fit_many(wave, rises, waves[:10], {"w": (0.1, top)})


@pytest.mark.skipif(machine() is None, reason="without the machine some end elsewhere")
@pytest.mark.parametrize("columns", [lambda t: t, pytest.param(np.asarray, marks=pytest.mark.slow)])
def test_many_optima_are_not_mistaken_for_the_best(columns) -> None:
    waves = np.sin(PHASES[:, None] * 4 * t) + 0.01 * rng.standard_normal((40, 50))
    table = miho.fit_many(lambda t, w: np.sin(w * 4 * columns(t)), t, waves, {"w": (0.1, 10)})
    assert table["w"].tolist() == pytest.approx(PHASES.tolist(), abs=0.01)


@pytest.mark.skipif(machine() is None, reason="without the machine some end elsewhere")
def test_peaks_are_found_where_they_are() -> None:
    """In a wide box, most of whose curves have no peak among the rows."""
    x = np.linspace(0, 10, 50)
    at = np.random.default_rng(5).uniform(1, 9, 100)
    noise = 0.05 * np.random.default_rng(6).standard_normal((100, 50))
    peaks = 3 * np.exp(-((x - at[:, None]) ** 2) / 0.5) + 1 + noise
    table = miho.fit_many(
        lambda x, a, m, s, c: a * np.exp(-((x - m) ** 2) / (2 * s**2)) + c,
        x, peaks, {"a": (0, 400), "m": (0, 200), "s": (0.05, 200), "c": (-50, 100)},
    )  # fmt: skip
    assert table["m"].tolist() == pytest.approx(at.tolist(), abs=0.1)
    assert table["converged"].all()
    assert table.attrs == {"checked": 20, "better": 0}


def test_optima_of_a_longer_search_are_starts_of_all() -> None:
    """Most starts of this box are on a plateau, where the first descents of all datasets end."""
    x = np.linspace(0, 10, 60)
    rates = np.linspace(0.2, 5, 60)
    decays = 2 * np.exp(-rates[:, None] * x) + 0.01 * rng.standard_normal((60, 60))
    with pytest.warns(UserWarning, match="from which all have descended now"):
        table = miho.fit_many(
            lambda x, a, b: a * np.exp(-b * x), x, decays, {"a": (0, 1e6), "b": (0, 1e6)}
        )
    assert table["b"].tolist() == pytest.approx(rates.tolist(), rel=0.1)


@pytest.mark.parametrize("model", [decay, opaque])
def test_from_a_start_each_descends_alone(model) -> None:
    searched = miho.fit_many(decay, t, y, BOX)
    starts = {name: 1.2 * TRUTH[:, k] for k, name in enumerate("abc")}
    one = {"a": 2.0, "b": 1.0, "c": 0.0}
    for start in (starts, one, {**one, "b": starts["b"]}):
        table = miho.fit_many(model, t, y, BOX, start=start)
        assert table.attrs == {"checked": 0, "better": 0}
        assert table["converged"].all()
        for name in NAMES:
            assert table[name].tolist() == pytest.approx(searched[name].tolist(), abs=1e-4)
            errors = searched[f"{name}_error"].tolist()
            assert table[f"{name}_error"].tolist() == pytest.approx(errors, rel=1e-3)


def test_a_start_goes_with_ties_and_constraints() -> None:
    box = {"a": (0, 10), "c": (-5, 5)}
    searched = miho.fit_many(decay, t, y[:3], box, tied={"b": "2 * a"}, constraints="c < a")
    table = miho.fit_many(
        decay, t, y[:3], box, tied={"b": "2 * a"}, constraints="c < a",
        start={"a": TRUTH[:3, 0], "c": 0.1},
    )  # fmt: skip
    for name in NAMES:
        assert table[name].tolist() == pytest.approx(searched[name].tolist(), abs=1e-4)


@pytest.mark.parametrize("lengths", [(50, 50), (50, 40)])
def test_a_configuration_at_which_the_model_raises_has_no_value(lengths: tuple[int, int]) -> None:
    """At rates above 4, from where only the starts are better than a step back."""

    def raising(t: np.ndarray, a: float, b: float) -> np.ndarray:
        if b > 4:
            raise RuntimeError("too fast")
        return a * np.exp(-b * t)

    runs = [(t[:n], a * np.exp(-1.5 * t[:n])) for n, a in zip(lengths, (1, 2), strict=True)]
    frames = [pd.DataFrame({"run": k, "t": x, "V": v}) for k, (x, v) in enumerate(runs)]
    arguments = raising, pd.concat(frames), "V", {"a": (0, 5), "b": (0, 10)}
    table = miho.fit_many(*arguments, by="run")
    assert table[["a", "b"]].to_numpy() == pytest.approx(np.array([[1, 1.5], [2, 1.5]]), rel=1e-6)
    with pytest.raises(ValueError, match="raising raises RuntimeError: too fast"):
        miho.fit_many(*arguments[:3], {"a": (0, 5), "b": (5, 9)}, by="run", start={"a": 1, "b": 6})


@pytest.mark.parametrize("count", [2, 7])
def test_few_datasets_are_searched_once_and_not_from_common_starts(
    monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    searches: list[object] = []

    def counted(problem: CurveFit, **settings: int) -> miho.Fit:
        searches.append(problem)
        return searched(problem, **settings)

    monkeypatch.setattr("miho.fitting.many_fits.searched", counted)
    monkeypatch.setattr("miho.fitting.descents.Batch.screened", None)
    truth = np.arange(count) + 1.0
    table = miho.fit_many(lambda t, a: a * np.sort(t), t, truth[:, None] * t, {"a": (0, 9)})
    assert table["a"].tolist() == pytest.approx(truth.tolist())
    assert len(searches) == count


def test_a_dataset_at_which_the_model_always_raises_has_no_values() -> None:
    def raising(t: np.ndarray, a: float, b: float) -> np.ndarray:
        if t.size == 40:
            raise RuntimeError("too short")
        return a * np.exp(-b * t)

    runs = [pd.DataFrame({"run": n, "t": t[:n], "V": np.exp(-1.5 * t[:n])}) for n in (50, 40)]
    box = {"a": (0, 5), "b": (0, 10)}
    table = miho.fit_many(raising, pd.concat(runs), "V", box, by="run", start={"a": 1, "b": 1})
    assert table["error"].tolist() == [pytest.approx(0, abs=1e-9), np.inf]
    assert table.loc[40, ["a", "a_error", "b", "b_error"]].isna().all()
    assert table["converged"].tolist() == [True, False]


def test_a_model_that_raises_at_a_configuration_is_called_once() -> None:
    calls: list[np.ndarray] = []

    def predict(thetas: np.ndarray, *inputs: np.ndarray) -> np.ndarray:
        calls.append(thetas)
        raise RuntimeError("too fast")

    assert np.isnan(rows_of(predict, np.ones((1, 2)), t)).all()
    assert len(calls) == 1


def test_what_does_not_fit_together_is_refused_in_a_line() -> None:
    frame = pd.DataFrame({"run": 1, "t": t, "V": y[0]})
    for arguments, keywords, message in (
        ((decay, t, y[0], BOX), {}, "shape \\(50,\\); expected \\(datasets, rows\\)"),
        ((decay, t, [y[0], y[0][:9]], BOX), {}, "y: expected an array of numbers"),
        ((decay, t, y * 1j, BOX), {}, "y is complex128; expected real numbers"),
        ((decay, pd.to_datetime(t, unit="s"), y, BOX), {}, "x is datetime.*; expected real numb"),
        ((decay, t, y.T, BOX), {}, r"x has 50 rows and y has 60; give y as \(datasets, rows\)"),
        (
            (decay, t, y, BOX),
            {"start": [1, 1, 1]},
            "start is \\[1, 1, 1\\]; give its values by name",
        ),
        ((decay, frame, "V", BOX), {"by": "lap"}, "by is 'lap' and y is 'V'; expected"),
        ((decay, frame, "V", BOX), {"by": frame["run"]}, "by is a Series and y is 'V'; expected"),
        ((decay, t, {"p": y[0]}, BOX), {}, "y is a dict; expected an array"),
        ((decay, t, y, [(0, 5)] * 3), {}, "bounds are of type list; give them by name"),
        ((decay, t, y, BOX), {"seed": None}, "seed is None; expected a whole number"),
        ((decay, t[:7], y, BOX), {}, "x has 7 rows and y has 50"),
        ((decay, t, np.where(y > 1, np.nan, y), BOX), {}, "a number is missing"),
        ((decay, t, np.ma.masked_greater(y, 1), BOX), {}, "a number is missing"),
        ((decay, t, y, {"a": (0, 1)}), {}, "b has no bounds"),
        ((decay, t, y, BOX), {"start": {"a": 1, "b": 1}}, "lacks c"),
        ((decay, t, y, BOX), {"start": {"a": [1, 2], "b": 1, "c": 1}}, "a has 2 values"),
        ((decay, t, y, BOX), {"start": {"a": [], "b": 1, "c": 1}}, "a has 0 values"),
        ((decay, t, y, BOX), {"start": {"a": 1, "b": 1, "c": 9}}, "c is 9; give one from -5"),
        ((decay, t, y, BOX), {"start": {"a": 1, "b": 1, "c": np.nan}}, "c is nan"),
        ((decay, -1e9 * t, y, {**BOX, "b": (1, 2)}), {}, "is not finite at t"),
        (
            (decay, t, np.vstack([y[:1], y[1:] * np.inf]), BOX),
            {},
            "dataset 1: a number .* in row 1;",
        ),
        ((decay, t, [np.ma.array(y[0], mask=t == t[2])], BOX), {}, "dataset 0: .* in row 3;"),
        ((decay, [np.ma.array(t, mask=t == t[2])], y[:1], BOX), {}, "dataset 0: .* in row 3;"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            miho.fit_many(*arguments, **keywords)
        assert "\n" not in str(caught.value)
