"""What a report says where the search may have failed: of the search, not of data or model."""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,type-arg"
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from miho import Budget, CurveFit, Dataset, Parameter, Space, minimize
from miho.identification import Report, make_report
from miho.identification.conclusion import conclusion_from
from miho.identification.irreducible import Irreducible
from miho.identification.refit import refit
from miho.methods.least_squares import LeastSquares
from miho.methods.variable_projection import VariableProjection
from miho.models.function_model import FunctionModel
from miho.optim import Descents, RandomSearch
from tests.identification.published import misra1a

Array = NDArray[np.float64]

BLAME = (
    "not identifiable", "wrong shape", "which is not an input", "units, signs", "from 0: its",
    "hard to distinguish", "do not depend on", "does not determine", "are correlated",
)  # fmt: skip


def ended(*ends: float, started: int | None = None) -> Descents:
    n = len(ends)
    return Descents(n if started is None else started, n, n, 0, tuple(sorted(ends)))


@pytest.mark.parametrize(
    ("descents", "doubt"),
    [
        (None, "a single search cannot show"),
        (ended(started=1), "no descent finished"),
        (ended(1.0), "the only finished descent found this optimum, and one is too few"),
        (ended(2.0), "the only finished descent ended elsewhere"),
        (ended(1.0, 1.0), "2 of 2 descents found this optimum, and 2 are too few"),
        (ended(*[1.0] * 6), "6 of 6 descents found this optimum, and 6 are too few"),
        (ended(*[1.0] * 7), ""),
        (ended(*[1.0] * 9, 2.0, 2.0, 3.0), ""),
        (ended(1.0, *[2.0] * 29), "only 1 of 30 descents found this optimum; they ended at 2"),
        (ended(*[1.0] * 6, *[2.0] * 124), "only 6 of 130"),
        (
            ended(*[1.0] * 5, 2.0, 3.0),
            "only 5 of 7 descents found this optimum; they ended at 3 different errors; estimated "
            "chance that another search finds a better one: 7.1 %",
        ),
        (ended(*[1.0] * 8, *np.linspace(2, 9, 22)), "only 8 of 30"),
        (ended(*[1.1] * 30), "none of 30 descents found this optimum"),
        (ended(*1 + np.linspace(0, 9e-5, 10)), ""),
    ],
)
def test_descents_that_agree_are_evidence(descents: Descents | None, doubt: str) -> None:
    conclusion = conclusion_from(1.0, 1e-14, [descents] if descents else [])
    assert doubt in conclusion.doubt if doubt else not conclusion.doubt
    assert not conclusion.certain


def test_the_evidence_counts_starts_descents_and_what_they_may_have_missed() -> None:
    """3 (3 + 1) / (20 * 19) is the share of Boender and Rinnooy Kan, of which 1 / 4 is better."""
    descents = ended(*[1.0] * 17, 2.0, 3.0, 3.0)
    conclusion = conclusion_from(1.0, 0.0, [replace(descents, screened=1234)])
    assert conclusion.evidence == (
        "17 of 20 descents (1,234 starting points screened) found this optimum. Estimated chance "
        "that another search finds a better one: 0.79 %"
    )
    assert conclusion_from(1.0, 0.0, [descents]).evidence.startswith(
        "17 of 20 descents found this optimum. "
    )
    check = replace(ended(*[1.0] * 5), screened=100)
    evidence = conclusion_from(1.0, 0.0, [descents, check]).evidence
    assert evidence.startswith("22 of 25 descents (100 starting points screened) found"), evidence


def test_what_was_dropped_on_fewer_rows_is_said_and_may_be_an_optimum_of_its_own() -> None:
    """Of 12, 2 were dropped: 3 optima at worst, so that 3 / (12 * 11) = 2.3 % find a better one."""
    brackets = replace(
        ended(*[1.0] * 10), started=12, finished=12, screened=99, dropped=2, brackets=True
    )
    conclusion = conclusion_from(1.0, 0.0, [brackets])
    assert conclusion.evidence == (
        "10 of 12 independent searches (99 starting points screened) found this optimum, and 2 "
        "were stopped on a part of the rows because they were no better. Estimated chance that "
        "another search finds a better one: 2.3 %"
    )
    assert not conclusion.doubt
    few = replace(brackets, ends=(1.0,) * 7, started=8, finished=8, dropped=1)
    assert conclusion_from(1.0, 0.0, [few]).doubt == (
        "only 7 of 8 independent searches (99 starting points screened) found this optimum, and 1 "
        "was stopped on a part of the rows because it was no better; estimated chance that another "
        "search finds a better one: 3.6 %"
    )
    evidence = conclusion_from(1.0, 0.0, [brackets, ended(1.0)]).evidence
    assert evidence.startswith("11 of 13 descents (99 starting points screened)"), (
        "not all are brackets"
    )


def test_what_is_known_needs_no_descents() -> None:
    alone = ended(1.0, *[2.0] * 29)
    assert conclusion_from(1.0, 9e-16, [alone], best_known=1.0).certain
    missed = conclusion_from(4.0, 9e-16, [ended(*[4.0] * 30)], best_known=1.0)
    assert "100 % above the error of the best known optimum" in missed.doubt
    noise = Irreducible(1.0, 0.9, 1.1)
    assert conclusion_from(1.0, 9e-16, [], irreducible=noise, error=1.0).certain
    assert conclusion_from(1.0, 9e-16, [ended(1.0)], irreducible=noise, error=1.0).certain
    assert conclusion_from(1.0, 9e-16, [], irreducible=noise, error=1.2).doubt
    assert conclusion_from(1.0, 9e-16, [alone], irreducible=noise, error=1.0).doubt, (
        "ended elsewhere"
    )
    coarse = Irreducible(1.0, 0.6, 9.0)
    assert conclusion_from(1.0, 9e-16, [], irreducible=coarse, error=1.0).doubt
    zero = ended(*[1e-22, 3e-20, 1e-25, 4e-19, 2e-21, 6e-23, 5e-20])
    assert not conclusion_from(1e-25, 1e-16, [zero]).doubt, "differences of rounding"


def two_decays(x, *, b1, b2, b3, b4, b5):
    return b1 + b2 * np.exp(-x * b4) + b3 * np.exp(-x * b5)


def gauss(x, *, b1, b2, b3, b4, b5, b6, b7, b8):
    peaks = b3 * np.exp(-(((x - b4) / b5) ** 2)) + b6 * np.exp(-(((x - b7) / b8) ** 2))
    return b1 * np.exp(-b2 * x) + peaks


def hahn1(x, *, b1, b2, b3, b4, b5, b6, b7):
    return (b1 - b2 * x + b3 * x**2 - b4 * x**3) / (1 - b5 * x + b6 * x**2 - b7 * x**3)


def enso(x, *, b1, b2, b3, b4, b5, b6, b7, b8, b9):
    t = 2 * np.pi * x
    year = b2 * np.cos(t / 12) + b3 * np.sin(t / 12)
    others = b5 * np.cos(t / b4) + b6 * np.sin(t / b4) + b8 * np.cos(t / b7) + b9 * np.sin(t / b7)
    return b1 + year + others


def bennett5(x, *, b1, b2, b3):
    return b1 * (b2 + x) ** (-1 / b3)


def mgh10(x, *, b1, b2, b3):
    return b1 * np.exp(b2 / (x + b3))


Box = list[tuple[float, float]]


def fit(function, box: Box, x: Array, y: Array, scale="linear", linear=()) -> CurveFit:
    names = function.__kwdefaults__ or function.__code__.co_varnames[1 : 1 + len(box)]
    function.__annotations__ = {"x": "-", **dict.fromkeys(names, "-"), "return": "-"}
    space = Space(
        tuple(Parameter(n, "-", *b, scale=scale) for n, b in zip(names, box, strict=True))
    )
    data = Dataset(function.__name__, {"x": x, "y": y}, {"x": "-", "y": "-"}, "y")
    return CurveFit(FunctionModel(function, linear=tuple(linear)), data, space)


def accused(report: Report) -> list[str]:
    return [note for note in report.notes if any(words in note for words in BLAME)]


def test_a_failed_search_blames_neither_data_nor_model() -> None:
    """Two decays like those of NIST's MGH17, whose rates are 1e-3 of the box.

    The search, by differences, ends where the faster one is over before the second row.
    """

    def no_formula(x, *, b1, b2, b3, b4, b5):
        return two_decays(np.asarray(x), b1=b1, b2=b2, b3=b3, b4=b4, b5=b5)

    x = np.arange(0.0, 330, 10)
    truth = np.array([0.375, 1.936, -1.465, 0.01287, 0.02212])
    problem = fit(no_formula, [(0, 500), (0, 1500), (-1000, 1000), (0, 10), (0, 20)], x, x)
    y = problem.model.predict(truth[None], x)[0] + 1e-3 * np.cos(37 * np.arange(x.size))
    problem = fit(no_formula, [(0, 500), (0, 1500), (-1000, 1000), (0, 10), (0, 20)], x, y)
    record = minimize(LeastSquares(), problem, seed=0)
    assert record.loss > 10 * problem.loss(truth[None])[0], "or this tests nothing"
    report = make_report(problem, record.theta, descents=record.descents, remedy="type this")
    assert re.match(r"the optimum is in doubt: only \d of 30 descents", report.notes[0])
    assert "do not depend on b5, although they do elsewhere in the box" in report.notes[0]
    assert report.notes[1] == "type this"
    assert not accused(report)[1:], "only the first sentence, which is of the search"
    good = make_report(problem, record.theta, descents=record.descents, better=truth)
    assert good.at.theta == pytest.approx(truth, rel=0.2)
    assert (
        "none of 30 descents (1,500 starting points screened) found this" in good.conclusion.doubt
    )


def test_an_error_close_to_the_noise_does_not_make_a_local_optimum_certain() -> None:
    """A sine of period 7.3 in noise as large as itself, searched for periods from 2 to 200.

    A wrong period has an error only 12 % above that of the noise, within its uncertainty.
    """

    def wave(x, *, c, a, b, T):
        return c + a * np.sin(2 * np.pi * x / T) + b * np.cos(2 * np.pi * x / T)

    x = np.linspace(0, 100, 100)
    y = 3 + np.sin(2 * np.pi * x / 7.3) + np.random.default_rng(0).normal(0, 1, 100)
    problem = fit(wave, [(-10, 10), (-5, 5), (-5, 5), (2, 200)], x, y)
    record = minimize(LeastSquares(), problem, seed=0)
    assert record.theta is not None
    report = make_report(problem, record.theta, descents=record.descents, profiles=False)
    assert report.at.theta[3] > 10, "or this tests nothing"
    assert report.error < report.irreducible.high, "or this tests nothing"
    assert report.conclusion.doubt
    assert not accused(report)


def test_a_parameter_without_effect_anywhere_is_not_identifiable() -> None:
    def line(x, *, a, b):
        return a * x + 0 * b

    x = np.linspace(0, 1, 50)
    problem = fit(line, [(-5, 5), (-5, 5)], x, 2 * x + 0.1 * np.cos(37 * np.arange(50)))
    report = make_report(problem, np.array([2.0, 1.0]), descents=ended(*[0.005] * 30))
    assert any(
        "do not depend on b: not identifiable, whatever the method" in n for n in report.notes
    )


def test_a_method_without_descents_says_that_it_is_one_search() -> None:
    problem = misra1a()
    record = minimize(RandomSearch(), problem, Budget(evaluations=50))
    assert record.descents is None
    report = make_report(problem, record.theta)
    assert "a single search cannot show" in report.notes[0]


def test_residual_standard_deviation_is_the_certified_one() -> None:
    """NIST StRD, Misra1a: 1.0187876330E-01 with 12 degrees of freedom."""
    report = make_report(misra1a(), np.array([250.0, 5e-4]))
    assert report.freedom == 12
    assert report.residual_standard_deviation == pytest.approx(1.0187876330e-01, rel=1e-9)
    row = report.errors.set_index("on").loc["residual standard deviation, 12 degrees of freedom"]
    assert row["error"] == report.residual_standard_deviation


def test_a_wall_of_nan_is_no_end() -> None:
    """y = a ln(x - b) + c is NaN where b is above the smallest x, close to the best b."""

    def logarithm(x, *, a, b, c):
        return a * np.log(x - b) + c

    x = np.linspace(1, 5, 60)
    y = 2 * np.log(x - 0.99999) + 1 + 0.05 * np.random.default_rng(0).standard_normal(60)
    problem = fit(logarithm, [(0, 10), (-5, 5), (-5, 5)], x, y)
    record = minimize(LeastSquares(), problem)
    assert record.rejected
    report = make_report(problem, record.theta, descents=record.descents)
    assert not report.conclusion.doubt
    frame = report.parameters
    assert np.isfinite(frame[["value", "standard error", "profile low", "profile high"]]).all(
        axis=None
    )
    assert (
        (frame["profile low"] < frame["value"]) & (frame["value"] < frame["profile high"])
    ).all()
    # An independent way to the same optimum: for each b the rest is a straight line. The grid
    # misses the best b by up to 0.2 % of its distance to the wall, and 1e-4 of the squares.
    errors = []
    for b in 1 - np.geomspace(1e-6, 1e-3, 2001):
        columns = np.stack([np.log(x - b), np.ones(60)], axis=1)
        errors.append(np.linalg.lstsq(columns, y)[1][0])
    assert report.error**2 * 60 == pytest.approx(min(errors), rel=1e-4)


def test_a_descent_from_behind_the_wall_says_so() -> None:
    def logarithm(x, *, a, b, c):
        return a * np.log(x - b) + c

    x = np.linspace(1, 5, 60)
    problem = fit(logarithm, [(0, 10), (-5, 5), (-5, 5)], x, np.log(x))
    behind = refit(problem, np.array([1.0, 3.0, 1.0]))
    assert math.isinf(behind.cost)
    assert not behind.converged


def test_a_report_ends_in_time_and_says_what_is_missing() -> None:
    report = make_report(misra1a(), np.array([238.9, 5.5e-4]), seconds=1e-9)
    assert "profile intervals of b1, b2 are left out" in report.notes[-1]
    assert "had not ended after" in report.conclusion.doubt
    requested = make_report(misra1a(), np.array([238.9, 5.5e-4]), seconds=1e-9, profiles=True)
    assert all(requested.profiles), "what is asked for takes the time it takes"


def nist(folder: Path, name: str) -> tuple[Array, Array, Array, float, float]:
    """Two starts (d, 2), x, y, certified sum of squares and residual standard deviation."""
    text = (folder / "nist_strd" / f"{name}.dat").read_text()
    starts = np.array(
        [[float(v) for v in m] for m in re.findall(r"b\d+ =\s+(\S+)\s+(\S+)\s+\S+\s+\S+\n", text)]
    )
    rows = re.split(r"Data:\s+y\s+x", text)[1].split()
    y, x = np.array(rows, dtype=float).reshape(-1, 2).T
    squares, deviation = (
        float(re.findall(rf"Residual {what}:\s+(\S+)", text)[0])
        for what in ("Sum of Squares", "Standard Deviation")
    )
    return starts, x, y, squares, deviation


def ten_times(starts: Array) -> Box:
    """From 0 to ten times the larger start, or as far on both sides."""
    size = 10 * np.abs(starts).max(axis=1)
    return [(0.0 if low >= 0 else -s, s) for low, s in zip(starts.min(axis=1), size, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("name", "function", "box", "settings"),
    [
        ("Gauss2", gauss, None, {}),
        ("Gauss3", gauss, None, {}),
        ("MGH17", two_decays, None, {}),
        ("ENSO", enso, None, {}),
        ("Hahn1", hahn1, [(1e-8, 100.0)] * 7, {"scale": "log"}),
        ("Bennett5", bennett5, [(-20000.0, 0.0), (0.0, 500.0), (0.01, 10.0)], {}),
        ("MGH10", mgh10, [(0.0, 1e3), (0.0, 1e7), (0.0, 1e6)], {"linear": ["b1"]}),
    ],
)
def test_nist_problems_are_solved_or_in_doubt(
    reference_data: Path,
    name: str,
    function,
    box: Box | None,
    settings: dict,
    seed: int,
) -> None:
    """In boxes of somebody who does not know the answer; certified numbers are NIST's.

    Without a doubt the residual standard deviation is the certified one, to 1e-4 of it.
    """
    starts, x, y, squares, deviation = nist(reference_data, name)
    problem = fit(function, box or ten_times(starts), x, y, **settings)
    method = VariableProjection() if settings.get("linear") else LeastSquares()
    record = minimize(method, problem, Budget(evaluations=500_000), seed)
    report = make_report(problem, record.theta, descents=record.descents)
    if report.conclusion.doubt:
        assert not accused(report)[1:]
        assert report.notes[0].startswith("the optimum is in doubt")
    else:
        assert report.residual_standard_deviation == pytest.approx(deviation, rel=1e-4)
    low, high = report.parameters["profile low"], report.parameters["profile high"]
    outside = (report.parameters["value"] < low) | (report.parameters["value"] > high)
    assert not outside.any()
    if name in ("Bennett5", "MGH10"):
        assert report.error**2 * x.size == pytest.approx(squares, rel=1e-6), "it converges"
