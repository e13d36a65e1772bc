"""The identification problem: its loss is Eq. 5, in any batch."""

import contextlib
import ctypes
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from baselines.problems.published_model import FORMS, PublishedModel
from miho import Budget, CurveFit, Dataset, Oracle, Parameter, Space
from miho.core import machine
from miho.identification.residuals import Loss, Square
from miho.identification.robust_loss import Cauchy, Huber
from miho.models.expression import Expression
from miho.models.model import DifferencedModel, Model
from miho.optim import MIHOGN, BudgetExhausted
from miho.vehicle.models import Pacejka, PacejkaCurvature, TorqueCubic
from tests.identification import published

needs_machine = pytest.mark.skipif(machine() is None, reason="the machine was not built")
SPACE = Space(
    (
        Parameter("B", "1/rad", 0, 40),
        Parameter("C", "-", 0, 3),
        Parameter("D", "N", 100, 6000),
        Parameter("Sx", "rad", -0.1, 0.1),
        Parameter("Sy", "N", -500, 500),
    )
)


def problem(n: int = 211) -> CurveFit:
    rng = np.random.default_rng(1)
    alpha = rng.uniform(-0.2, 0.2, n)
    force = -3000 * np.tanh(10 * alpha) + rng.normal(0, 100, n)
    return CurveFit(
        Pacejka(),
        Dataset("d", {"alpha": alpha, "Fy": force}, {"alpha": "rad", "Fy": "N"}, "Fy"),
        SPACE,
    )


def test_loss_is_equation_5() -> None:
    p = problem()
    B, C, D, Sx, Sy = theta = np.array([11.0, 1.3, 2900.0, 0.01, 30.0])
    alpha, force = p.dataset["alpha"], p.dataset["Fy"]
    model = D * np.sin(C * np.arctan(B * (-alpha + Sx))) + Sy
    expected = np.mean((force - model) ** 2)
    assert p.loss(theta[None])[0] == pytest.approx(expected, rel=1e-14)
    assert np.mean(p.residuals(theta) ** 2) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("n", [1, 7, 300, 3000])
def test_a_batch_equals_its_rows_bit_for_bit(n: int) -> None:
    p = problem(n)
    thetas = SPACE.initial(257)
    batch = p.loss(thetas)
    assert [p.loss(theta[None])[0] for theta in thetas] == batch.tolist()
    assert p.loss(thetas[100:171]).tolist() == batch[100:171].tolist()


def test_fidelity_uses_a_fixed_part_of_the_data() -> None:
    p = problem(200)
    theta = SPACE.initial(3)
    assert np.array_equal(p.loss(theta, 0.25), problem(200).loss(theta, 0.25))
    residuals = p.residuals(theta[0])
    part = p._order[:50]
    assert p.loss(theta[:1], 0.25)[0] == pytest.approx(np.mean(residuals[part] ** 2), rel=1e-14)
    assert not np.array_equal(p.loss(theta, 0.25), p.loss(theta))
    assert p.cost(0.25) == 0.25
    assert p.cost(0.251) == 51 / 200, "it uses 51 rows"


@needs_machine
@pytest.mark.parametrize("fidelity", [0.01, 0.25, 0.251, 0.999])
def test_a_fidelity_runs_on_the_machine(fidelity: float, monkeypatch: pytest.MonkeyPatch) -> None:
    p = problem(2000)
    thetas = SPACE.initial(50)
    part = p._order[: round(p.cost(fidelity) * 2000)]
    rows = p.model.predict(thetas, p.inputs[0][part]) - p.dataset["Fy"][part]

    assert p.loss(thetas, fidelity).shape == (50,), "which compares it with NumPy's"

    def predict(*arguments: object) -> None:
        raise AssertionError("it went the way of NumPy")

    monkeypatch.setattr(Pacejka, "predict", predict)
    assert p.loss(thetas, fidelity) == pytest.approx(np.mean(rows**2, axis=1), rel=1e-12)


@pytest.mark.parametrize("rho", [Square(), Cauchy(200.0)])
@pytest.mark.parametrize("fidelity", [1e-9, 0.01, 0.25, 0.251, 0.999, 1.0])
def test_residuals_at_a_fidelity_are_those_of_its_rows(fidelity: float, rho: Loss) -> None:
    """In the fixed order, and their mean square is the loss; all rows come as the data have them.

    The loss to the 1e-12 at which compiled and NumPy's sines agree.
    """
    p = replace(problem(2000), rho=rho)
    theta = np.array([11.0, 1.3, 2900.0, 0.01, 30.0])
    m = round(p.cost(fidelity) * p.rows)
    part = p._order[:m] if fidelity < 1 else slice(None)
    residuals, jacobian = p.residuals(theta, fidelity), p.jacobian(theta, fidelity)
    assert m == max(1, np.ceil(fidelity * 2000 - 1e-6))
    assert jacobian.shape == (m, 5)
    scale = np.abs(p.dataset["Fy"]).max()
    np.testing.assert_allclose(residuals, p.residuals(theta)[part], rtol=0, atol=1e-12 * scale)
    columns = p.jacobian(theta)
    np.testing.assert_allclose(
        jacobian / np.abs(columns).max(axis=0),
        columns[part] / np.abs(columns).max(axis=0),
        rtol=0,
        atol=1e-12,
    )
    loss = p.loss(theta[None], fidelity)[0]
    assert np.mean(residuals**2) == pytest.approx(loss, rel=1e-12)
    oracle = Oracle(p, Budget())
    oracle.residuals(theta, fidelity)
    oracle.jacobian(theta, fidelity)
    assert oracle.evaluations == pytest.approx((1 + 5) * m / 2000, rel=1e-12)
    assert len(oracle.trace) == (fidelity == 1.0), "only all rows tell the loss"


@needs_machine
@pytest.mark.parametrize(
    "model",
    [
        Pacejka(),
        *(
            pytest.param(model, marks=pytest.mark.slow)
            for model in (PacejkaCurvature(), TorqueCubic(), *map(PublishedModel, FORMS))
        ),
    ],
    ids=lambda model: model.name or type(model).__name__,
)
def test_rows_of_the_machine_are_numpys(model: Expression) -> None:
    """Of any rows i to j; to 1e-9 of a column: roundings where large terms cancel."""
    rng = np.random.default_rng(4)
    N, d = 101, len(model.parameters)
    columns = {name: rng.uniform(0.1, 2.0, N) for name in model.inputs}
    y = rng.standard_normal(N)
    data = Dataset("rows", {**columns, "output": y}, {**model.inputs, "output": model.output},
                   "output")  # fmt: skip
    space = Space(tuple(Parameter(n, u, 0.2, 2.0) for n, u in model.parameters.items()))
    p = CurveFit(model, data, space)
    rows = p.kernel.rows
    assert rows is not None
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 8)
    write_residuals, write_slopes = map(call, rows.calls[:2].tolist())
    value, derivatives = rows.calls[2:].tolist()
    checked = 0
    for theta in space.sample(20, rng, "uniform"):
        for i, j in ((0, N), (0, 1), (40, 57), (100, 101)):
            r, J = np.full(j - i, np.nan), np.full((d, j - i + 2), np.nan)
            at, X, y_, r_, J_ = (a.ctypes.data for a in (theta, rows.X, rows.y, r, J))
            write_residuals(value, at, X, N, y_, i, j, r_)
            write_slopes(derivatives, at, X, N, i, j, J_, J.shape[1])
            some = p._order[i:j]
            for machines, numpys in (
                (r, model.predict(theta[None], *p.inputs)[0] - y),
                *zip(J[:, : j - i], model.jacobian(theta, *p.inputs).T, strict=True),
            ):
                valued = np.isfinite(numpys)
                scale = np.abs(numpys[valued]).max(initial=1.0)
                assert (np.isfinite(machines) == valued[some]).all()
                checked += np.count_nonzero(valued[some])
                np.testing.assert_allclose(
                    machines[valued[some]], numpys[some][valued[some]], rtol=1e-9, atol=1e-9 * scale
                )
            assert np.isnan(J[:, j - i :]).all(), "no more rows than these"
    assert checked


def test_a_model_with_a_memory_costs_all_rows_at_any_fidelity() -> None:
    class Ordered(Pacejka):
        ordered = True

    data = problem().dataset
    ordered = CurveFit(Ordered(), data, SPACE)
    oracle = Oracle(ordered, Budget())
    theta = ordered.space.decode(ordered.space.initial(1))
    assert oracle(theta, 0.1)[0] == ordered.loss(theta)[0] == oracle.best
    assert oracle.evaluations == 1


def test_jacobian_against_differences() -> None:
    p = problem()
    theta = np.array([11.0, 1.3, 2900.0, 0.01, 30.0])
    jacobian = p.jacobian(theta)
    for k, step in enumerate(1e-6 * np.abs(theta)):
        h = step * (np.arange(5) == k)
        difference = (p.residuals(theta + h) - p.residuals(theta - h)) / (2 * step)
        assert jacobian[:, k] == pytest.approx(difference, rel=1e-6, abs=1e-6 * np.ptp(difference))


def test_shapes_are_checked_once() -> None:
    class Flat(Pacejka):
        def predict(self, thetas: object, *inputs: object) -> object:
            return super().predict(thetas, *inputs)[0]

    class Turned(Pacejka):
        def jacobian(self, theta: object, *inputs: object) -> object:
            return super().jacobian(theta, *inputs).T

    p = problem()
    with pytest.raises(ValueError, match=r"Flat.predict gives shape \(211,\); expected \(2, 211\)"):
        CurveFit(Flat(), p.dataset, SPACE)
    with pytest.raises(ValueError, match=r"Turned.jacobian gives shape \(5, 211\)"):
        CurveFit(Turned(), p.dataset, SPACE)


def test_two_spellings_of_a_unit_are_one_unit() -> None:
    class OfFrequency(Pacejka):
        inputs, output = {"alpha": "Hz"}, "m/s^2"

    p = problem()
    data = Dataset("d", p.dataset.columns, {"alpha": "1/s", "Fy": "m/s2"}, "Fy")
    CurveFit(OfFrequency(), data, SPACE)


def test_the_space_must_fit_the_model() -> None:
    class InKilonewtons(Pacejka):
        output = "kN"

    p = problem()
    with pytest.raises(
        ValueError, match="needs the parameters B, C, D, Sx, Sy; the space lacks Sy"
    ):
        CurveFit(p.model, p.dataset, Space(SPACE.parameters[:4]))
    degrees = (*SPACE.parameters[:3], Parameter("Sx", "deg", -5, 5), SPACE.parameters[4])
    with pytest.raises(ValueError, match="'Sx' of the space has unit 'deg'"):
        CurveFit(p.model, p.dataset, Space(degrees))
    data = {"alpha": p.dataset["alpha"], "Fy": p.dataset["Fy"]}
    with pytest.raises(ValueError, match=r"column 'alpha' of d has unit 'deg'; .* needs 'rad'"):
        CurveFit(p.model, Dataset("d", data, {"alpha": "deg", "Fy": "N"}, "Fy"), SPACE)
    with pytest.raises(ValueError, match=r"output 'Fy' of d has unit 'kN'; .* needs 'N'"):
        CurveFit(p.model, Dataset("d", data, {"alpha": "rad", "Fy": "kN"}, "Fy"), SPACE)
    with pytest.raises(ValueError, match=r"unit 'N'; .* needs 'kN'; write the model for 'N'"):
        CurveFit(InKilonewtons(), p.dataset, SPACE)
    other = Dataset("d", {"slip": np.ones(3), "Fy": np.ones(3)}, {"slip": "1", "Fy": "N"}, "Fy")
    with pytest.raises(ValueError, match="no column 'alpha'"):
        CurveFit(p.model, other, SPACE)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dataset": {"alpha": [1.0]}}, "needs a Dataset, got a dict; miho.fit takes other"),
        ({"space": {"B": (1, 2)}}, "needs a Space, got a dict"),
        ({"rho": "huber"}, "needs a Loss, got a str"),
    ],
)
def test_parts_of_a_wrong_type_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(problem(), **changes)  # type: ignore[arg-type]


def test_a_row_that_no_parameters_predict_is_named() -> None:
    x = np.array([1.0, 0.0, 2.0])
    with pytest.raises(ValueError, match=r"is not finite at x = 0 \(row 2 of published\)"):
        published.problem(Inverse(), x, x, [(1, 2), (1, 2)])


@pytest.mark.parametrize("size", [1e160, 1e-160])
def test_an_output_whose_squares_are_no_numbers_is_refused(size: float) -> None:
    p = problem()
    columns = {"alpha": p.dataset["alpha"], "Fy": size * p.dataset["Fy"] / 3000}
    data = Dataset("d", columns, {"alpha": "rad", "Fy": "N"}, "Fy")
    with pytest.raises(ValueError, match=r"column 'Fy' of d reaches .* N, whose square") as refused:
        CurveFit(Pacejka(), data, SPACE)
    assert "\n" not in str(refused.value)
    CurveFit(Pacejka(), replace(data, columns={**columns, "Fy": 0 * columns["Fy"]}), SPACE)


def test_a_linearity_that_is_not_so_is_refused() -> None:
    x = np.linspace(1, 2, 9)
    with pytest.raises(ValueError, match="not linear in a, b as it declares"):
        published.problem(Product(), x, x, [(1, 2), (1, 2)])


class Inverse(published.Line):
    """y = a + b / x."""

    linear = ()

    def predict(self, thetas: np.ndarray, *inputs: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore"):
            return super().predict(thetas, 1 / inputs[0])


class Product(published.Line):
    """y = a b x: linear in each, not in both."""

    def predict(self, thetas: np.ndarray, *inputs: np.ndarray) -> np.ndarray:
        return thetas[:, :1] * thetas[:, 1:] * inputs[0]


def decay(t: "s", *, a: "V", b: "1/s") -> "V":  # type: ignore[name-defined] # noqa: F821
    return a * np.exp(-b * t)


def test_a_function_is_a_model() -> None:
    t = np.linspace(0, 2, 50)
    data = Dataset("d", {"t": t, "y": 2 * np.exp(-1.5 * t)}, {"t": "s", "y": "V"}, "y")
    space = Space((Parameter("a", "V", 0, 5), Parameter("b", "1/s", 0.01, 10, scale="log")))
    fit = CurveFit(decay, data, space)  # type: ignore[arg-type]
    assert fit.name == "decay-d"
    # The data are NumPy's exponentials; the machine's may differ by an ulp of 2 (4e-16).
    assert fit.loss(np.array([[2.0, 1.5]]))[0] <= 1e-31
    for wrong, message in (
        (lambda t, a, b: a, "expected at least one input column and one parameter, got 3 and 0"),
        (Pacejka, "expected an instance of a model class"),
        ("decay", "the model is 'decay'; expected"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            CurveFit(wrong, data, space)  # type: ignore[arg-type]
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("rho", [Square(), Huber(0.02)], ids=["square", "huber"])
@pytest.mark.parametrize("own", [True, False], ids=["derivatives", "differences"])
def test_books_are_of_the_values_that_a_model_gave(own: bool, rho: Loss) -> None:
    """Residuals, Jacobians and all of a run; a robust loss needs no values for its derivatives
    besides those of the residuals. A Jacobian of the model's own counts d of them."""
    values = 0

    class Counted(DifferencedModel if not own else Model):  # type: ignore[misc]
        inputs = MappingProxyType({"t": "s"})
        parameters = MappingProxyType({"a": "V", "b": "1/s", "c": "V"})
        output = "V"

        def predict(self, thetas: np.ndarray, *inputs: np.ndarray) -> np.ndarray:
            nonlocal values
            values += len(thetas) * inputs[0].size
            a, b, c = thetas.T[:, :, None]
            return np.asarray(a * np.exp(-b * inputs[0]) + c)

        if own:

            def jacobian(self, theta: np.ndarray, *inputs: np.ndarray) -> np.ndarray:
                nonlocal values
                values += 3 * inputs[0].size
                a, b, _ = theta
                decay = np.exp(-b * inputs[0])
                return np.stack([decay, -a * inputs[0] * decay, np.ones_like(decay)], axis=1)

    rng, t = np.random.default_rng(6), np.linspace(0, 5, 301)
    y = 2 * np.exp(-0.7 * t) + 0.3 + 0.02 * rng.standard_t(3, t.size)
    data = Dataset("d", {"t": t, "y": y}, {"t": "s", "y": "V"}, "y")
    sides = {"a": ("V", 0.1, 9.0), "b": ("1/s", 0.01, 9.0), "c": ("V", 0.01, 9.0)}
    space = Space(tuple(Parameter(name, *side) for name, side in sides.items()))
    fit = CurveFit(Counted(), data, space, rho)
    oracle, theta = Oracle(fit, Budget()), np.array([2.5, 0.5, 0.2])
    values = 0
    for fidelity in (1.0, 40 / 301):
        oracle.residuals(theta, fidelity)
        oracle.jacobian(theta, fidelity)
        assert values / 301 == oracle.evaluations
    oracle, values = Oracle(fit, Budget(evaluations=60)), 0
    with contextlib.suppress(BudgetExhausted):
        MIHOGN().run(oracle, np.random.default_rng(0))
    assert values / 301 == oracle.evaluations


@pytest.mark.slow
def test_a_wrong_optimum_of_two_inputs_is_more_than_the_noise() -> None:
    """A wave in x as high as z says, in more rows than are looked at; the wrong one is 10 % off."""
    rng = np.random.default_rng(8)
    x, z = rng.uniform(0, 5, (2, 25_000))
    y = np.sin(x) * z + rng.normal(0, 0.1, x.size)
    units = dict.fromkeys(("x", "z", "y"), "1")
    data = Dataset("wave", {"x": x, "z": z, "y": y}, units, "y")

    def wave(x: "1", z: "1", *, a: "1", k: "1") -> "1":  # type: ignore[syntax]
        return a * np.sin(k * x) * z

    space = Space((Parameter("a", "1", 0, 3), Parameter("k", "1", 0, 3)))
    fit = CurveFit(wave, data, space)  # type: ignore[arg-type]
    right, wrong = fit.loss(np.array([[1.0, 1.0], [0.9, 1.1]]))
    assert right < fit.noise < wrong
