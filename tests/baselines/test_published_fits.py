"""Published problems: numbers as printed, and models that reproduce the published fits."""

import math
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
import scipy.optimize

from baselines.problems import (
    PublishedFit,
    PublishedModel,
    load_published,
    published_fit,
    published_names,
)
from baselines.problems.published_model import FORMS
from miho.identification import CurveFit
from miho.optim import Parameter, Space

NIST = [name for name in published_names() if published_fit(name).collection == "nist"]
EXACT = {"biggs", "glasser1", "glasser2", "gulf", "lanczos1"}
"""Their residuals are those of rounding: of the data, or of a printed parameter."""
PRINTED = {
    # sums of squares in More, Garbow and Hillstrom (1981)
    "bard": 8.21487e-3, "jennrich": 124.362, "osborne2": 4.01377e-2,
    # residual sums of squares in Bates and Watts (1988)
    "bod": 25.99, "isomerization": 3.2345, "puromycin": 1195.4,
}  # fmt: skip
DEVIATIONS = {"dnase": (0.02684, 13), "indometh": (0.04103, 7), "theoph": (0.732, 8)}
"""Residual standard deviations and degrees of freedom that R prints of its examples."""
TARGETS = {
    # in gslnls' nls_test_problem, which names them after Bates and Watts
    "chloride": (39.0948975505463, 0.828436576821748, 0.158522388849914),
    "leaves": (21.2040375905717, math.log(296.449927062274), 0.777218543698019, 1.61890922917627),
    "lubricant": (
        1054.54053185586, 206.545778895884, 1.46031478978246, -0.259654831213851,
        0.0225737061160327, 0.401384284921933, 0.0352840506436575, 57.404631430396,
        -0.476721102261905,
    ),
    "sulfisoxazole": (81.2440378005701, 1.30598900748147, 162.594414330483, 0.161785643456763),
    "tetracycline": (0.148801441927812, 0.715743513376835, 2.64966476940712, 0.412231010811697),
}  # fmt: skip


def squares(fit: PublishedFit) -> float:
    """The sum of squares at the published optimum."""
    model = PublishedModel(fit.model)
    inputs = (fit.dataset[name] for name in model.inputs)
    residuals = model.predict(np.array([fit.optimum]), *inputs)[0] - fit.dataset["y"]
    return float((residuals**2).sum())


def test_all_of_nist_are_there() -> None:
    assert len(NIST) == 27


@pytest.mark.parametrize("name", sorted(set(published_names()) - EXACT))
def test_the_published_optimum_has_the_published_sum_of_squares(name: str) -> None:
    """To the eleven digits that are printed of both.

    Half a unit in the last of these is 5e-11 of the sum at most. That of the parameters changes the
    sum by its square, which shows where residuals are small: 1e-10 in Lanczos2.
    """
    fit = published_fit(name)
    assert squares(fit) == pytest.approx(fit.squares, rel=2e-10)


@pytest.mark.parametrize("name", sorted(PRINTED.keys() | DEVIATIONS.keys() | TARGETS.keys()))
def test_the_fits_are_those_of_the_publications(name: str) -> None:
    """To what is printed: a unit in the last digit, and for parameters a search's tolerance.

    Those of gslnls differ from the optimum by up to 1.3e-5, in directions that hardly show in the
    sum of squares.
    """
    fit = published_fit(name)
    if name in PRINTED:
        exponent = Decimal(str(PRINTED[name])).as_tuple().exponent
        assert fit.squares == pytest.approx(PRINTED[name], rel=0, abs=10.0 ** int(exponent))
    if name in DEVIATIONS:
        printed, freedom = DEVIATIONS[name]
        assert math.sqrt(fit.squares / freedom) == pytest.approx(printed, rel=5e-4)
        assert freedom == len(fit.dataset) - len(fit.optimum)
    if name in TARGETS:
        np.testing.assert_allclose(fit.optimum, TARGETS[name], rtol=2e-5)


def test_every_fit_is_checked_against_its_publication() -> None:
    checked = {*NIST, *EXACT, *PRINTED, *DEVIATIONS, *TARGETS}
    assert checked == set(published_names())


@pytest.mark.parametrize("name", sorted(EXACT - {"lanczos1"}))
def test_data_without_errors_are_those_of_their_parameters(name: str) -> None:
    """To the rounding of a few operations."""
    fit = published_fit(name)
    assert fit.squares == 0
    assert squares(fit) <= (1e-14 * np.abs(fit.dataset["y"]).max()) ** 2 * len(fit.dataset)


def test_the_parameters_of_exact_data_are_printed_too_roughly_for_their_residuals() -> None:
    """Lanczos1: eleven digits leave residuals 170 times the certified ones, of 7.7e-14."""
    fit = published_fit("lanczos1")
    assert math.sqrt(fit.squares / 24) == pytest.approx(7.72e-14, rel=1e-3)
    assert math.sqrt(squares(fit) / 24) == pytest.approx(1.29e-11, rel=1e-2)


@pytest.mark.parametrize("name", NIST)
def test_the_numbers_are_those_of_nist(name: str, reference_data: Path) -> None:
    """Starts, certified values, sum of squares and rows, against NIST's own file."""
    fit = published_fit(name)
    (file,) = (p for p in (reference_data / "nist_strd").iterdir() if p.stem.lower() == name)
    lines = file.read_text(encoding="utf-8").splitlines()
    table = [line.split("=")[1].split() for line in lines[40:] if line.startswith("  b")]
    first, second, certified, deviations = np.array(table, dtype=float).T
    assert fit.starts == (tuple(first), tuple(second))
    assert fit.optimum == tuple(certified)
    fields = {key.strip(): text for key, _, text in (line.partition(":") for line in lines[40:60])}
    assert fit.squares == float(fields["Residual Sum of Squares"])
    rows = np.array([line.split() for line in lines[60:] if line.strip()], dtype=float)
    assert len(fit.dataset) == len(rows) == int(fields["Number of Observations"])
    y = np.log(rows[:, 0]) if name == "nelson" else rows[:, 0]
    model = PublishedModel(fit.model)
    np.testing.assert_array_equal(fit.dataset["y"], y)
    for column, values in zip(model.inputs, rows.T[1:], strict=True):
        np.testing.assert_array_equal(fit.dataset[column], values)

    # The residual standard deviation, and those of the parameters, from our derivatives. (The
    # degrees of freedom that NIST prints for Rat43 are 9; its deviation is that of 11.)
    freedom = len(rows) - len(certified)
    deviation = float(fields["Residual Standard Deviation"])
    assert math.sqrt(fit.squares / freedom) == pytest.approx(deviation, rel=2e-10)
    J = model.jacobian(certified, *(fit.dataset[key] for key in model.inputs))
    _, sizes, directions = np.linalg.svd(J * certified, full_matrices=False)
    relative = np.sqrt(((directions.T / sizes) ** 2).sum(axis=1))
    # NIST prints eleven digits; the inverse of Bennett5's and Lanczos' loses up to five of sixteen
    # to its condition, and as many to the digits of the certified values.
    np.testing.assert_allclose(deviation * relative * abs(certified), deviations, rtol=1e-5)


@pytest.mark.parametrize("name", NIST)
def test_a_descent_from_the_second_start_ends_at_six_digits(name: str) -> None:
    """By MINPACK, started anew where it ended: flat sums of squares stop it early."""
    fit = published_fit(name)
    model = PublishedModel(fit.model)
    inputs = tuple(fit.dataset[key] for key in model.inputs)
    theta = np.array(fit.starts[1])
    for _ in range(2):
        theta = scipy.optimize.least_squares(
            lambda theta: model.predict(theta[None], *inputs)[0] - fit.dataset["y"],
            theta,
            lambda theta: model.jacobian(theta, *inputs),
            method="lm", x_scale="jac", ftol=1e-15, xtol=1e-15, gtol=1e-15,
        ).x  # fmt: skip
    np.testing.assert_allclose(theta, fit.optimum, rtol=1e-6)


@pytest.mark.parametrize("name", published_names())
def test_derivatives_are_exact(name: str) -> None:
    """Against the complex step, which has no error but rounding (Squire and Trapp 1998)."""
    fit = published_fit(name)
    model = PublishedModel(fit.model)
    inputs = tuple(fit.dataset[key] for key in model.inputs)
    rng = np.random.default_rng(0)
    h = 1e-30
    for scatter in (0.0, 0.02, 0.02):
        theta = np.array(fit.optimum) * (1 + scatter * rng.standard_normal(len(fit.optimum)))
        J = model.jacobian(theta, *inputs)
        for k in range(theta.size):
            step = theta + 1j * h * (np.arange(theta.size) == k)
            exact = np.broadcast_to(model.value(inputs, tuple(step)), len(fit.dataset)).imag / h
            np.testing.assert_allclose(J[:, k], exact, rtol=1e-9, atol=1e-11 * abs(exact).max())


@pytest.mark.parametrize("form", sorted(FORMS))
def test_where_a_formula_has_no_value_nothing_is_raised(form: str) -> None:
    """Zeros, which are divided by, and negative and huge parameters; not even a warning."""
    model = PublishedModel(form)
    d = len(model.parameters)
    thetas = np.array([np.zeros(d), -np.ones(d), np.full(d, -1e300), np.full(d, 1e300)])
    inputs = [np.linspace(0.5, 3.0, 7) + k for k in range(len(model.inputs))]
    assert model.predict(thetas, *inputs).shape == (4, 7)
    assert all(model.jacobian(theta, *inputs).shape == (7, d) for theta in thetas)


def test_every_formula_is_used_and_every_problem_has_one() -> None:
    fits = [published_fit(name) for name in published_names()]
    assert {fit.model for fit in fits} == set(FORMS)
    for fit in fits:
        rows = {len(fit.optimum), *map(len, fit.starts)}
        assert rows == {FORMS[fit.model].parameters}, fit.name
        assert set(fit.dataset.columns) == {"y", *PublishedModel(fit.model).inputs}


def test_an_unknown_name_lists_those_that_exist() -> None:
    with pytest.raises(ValueError, match=r"name is 'misra1'; expected one of .*misra1a, misra1b"):
        load_published("misra1")
    with pytest.raises(ValueError, match=r"name is 'misra1a'; expected one of .*rise"):
        PublishedModel("misra1a")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name != "nelson"))
        for name in published_names()
    ],
)
def test_compiled_values_are_those_of_numpy(name: str) -> None:
    """At random parameters, with and without a value there; a division by zero is no error.

    Each value is within some roundings, which the sum of squares averages; sines of large angles
    are the most different (`miho/core/elementary.h`).
    """
    fit = published_fit(name)
    model = PublishedModel(fit.model)
    theta = np.array(fit.optimum)
    names = tuple(model.parameters)
    space = Space(tuple(Parameter(key, "-", -9.9e9, 9.9e9) for key in names))
    problem = CurveFit(model, fit.dataset, space)
    rng = np.random.default_rng(0)
    near = theta * (1 + 0.1 * rng.standard_normal((20, theta.size)))
    far = theta * rng.choice([-10.0, 0.0, 10.0], (20, theta.size))
    thetas = np.vstack([near, far, np.zeros(theta.size)])
    with np.errstate(all="ignore"):
        expected = np.mean((model.predict(thetas, *problem.inputs) - fit.dataset["y"]) ** 2, axis=1)
    losses = problem.loss(thetas)
    finite = np.isfinite(expected)
    np.testing.assert_array_equal(np.isfinite(losses), finite)
    floor = 1e-28 * np.mean(fit.dataset["y"] ** 2)
    np.testing.assert_allclose(losses[finite], expected[finite], rtol=1e-9, atol=floor)
    J = model.jacobian(theta, *problem.inputs)
    np.testing.assert_allclose(problem.jacobian(theta), J, rtol=1e-9, atol=1e-12 * abs(J).max())
