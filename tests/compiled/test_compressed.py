"""The loss from few nodes: within its tolerance of the sum over all points, wherever asked."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from miho import MIHO, Budget, CurveFit, Dataset, Parameter, Space, minimize
from miho.compiled.compressed import CompressedLoss
from miho.compiled.fit import FitKernel
from miho.compiled.panels import ORDERS, STARTS, panels
from miho.identification.loss import Huber
from miho.models import Pacejka, PacejkaCurvature, TorqueCubic
from miho.models.expression import Expression

Array = NDArray[np.float64]

COMPILES = pytest.mark.slow
"""Panels and their kernels take half a minute to compile."""
LOW = np.array([0.0, 0.0, 500.0, -0.1, -1000.0])
HIGH = np.array([200.0, 200.0, 10_000.0, 0.1, 1000.0])
SPACE = Space(
    tuple(
        Parameter(name, unit, low, high)
        for (name, unit), low, high in zip(Pacejka.parameters.items(), LOW, HIGH, strict=True)
    )
)
TRUE = np.array([12.0, 1.4, 4500.0, 0.005, 60.0])


def sample(N: int, noise: float = 150.0) -> tuple[Array, Array]:
    rng = np.random.default_rng(N)
    x = rng.uniform(-0.2, 0.2, N)
    return x, Pacejka().predict(TRUE[None], x)[0] + noise * rng.standard_normal(N)


def candidates(n: int) -> Array:
    """Half from the wide box, with B or C at 0 at times, half around the optimum."""
    rng = np.random.default_rng(7)
    wide = rng.uniform(LOW, HIGH, (n // 2, 5))
    wide[::20, 0] = 0.0
    wide[1::20, 1] = 0.0
    wide[2::20, :2] *= -1
    return np.vstack([wide, TRUE * (1 + 0.1 * rng.standard_normal((n // 2, 5)))])


def full(x: Array, y: Array, thetas: Array, model: Expression | None = None) -> Array:
    """The mean square over all points, summed in extended precision."""
    residuals = (model or Pacejka()).predict(thetas, x) - y
    return np.asarray(np.mean(residuals.astype(np.longdouble) ** 2, axis=1), float)


def problem(N: int, compressed: bool, noise: float = 150.0) -> CurveFit:
    x, y = sample(N, noise)
    dataset = Dataset("d", {"alpha": x, "Fy": y}, {"alpha": "rad", "Fy": "N"}, "Fy")
    return CurveFit(Pacejka(), dataset, SPACE, compressed=compressed)


@COMPILES
@pytest.mark.parametrize(("N", "n"), [(1, 40), (50, 2000), (3000, 2000), (30_000, 200)])
def test_within_the_tolerance_over_the_wide_box(N: int, n: int) -> None:
    x, y = sample(N)
    thetas = candidates(n)
    loss = CompressedLoss(Pacejka(), x, y)
    expected = np.concatenate(
        [full(x, y, part) for part in np.array_split(thetas, 1 + n * N // 10**6)]
    )
    assert loss.losses(thetas) == pytest.approx(expected, rel=1e-9)


@COMPILES
@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 1e-6])
def test_a_coarse_tolerance_holds_too_and_takes_fewer_values(tolerance: float) -> None:
    """Where truncation shows: the bound, not rounding, is what holds the error down."""
    x, y = sample(3000)
    thetas = candidates(1000)
    expected = full(x, y, thetas)
    unlimited = np.full(len(thetas), np.inf)
    losses, counts = CompressedLoss(Pacejka(), x, y, tolerance).counted(thetas, unlimited)
    error = np.abs(losses / expected - 1).max()
    assert 1e-15 < error <= tolerance
    assert counts.sum() < CompressedLoss(Pacejka(), x, y).counted(thetas, unlimited)[1].sum()
    assert counts[-1] < 300


@pytest.mark.slow  # it compiles a model of its own
def test_curvature() -> None:
    x, y = sample(3000)
    rng = np.random.default_rng(3)
    thetas = rng.uniform([0, 0, 500, -6, -0.1, -900], [60, 4, 9e3, 2, 0.1, 900], (500, 6))
    model = PacejkaCurvature()
    for tolerance in (1e-2, 1e-9):
        loss = CompressedLoss(model, x, y, tolerance)
        assert loss.losses(thetas) == pytest.approx(full(x, y, thetas, model), rel=tolerance)
    assert np.median(loss.counted(thetas, np.full(500, np.inf))[1]) < 1000


@pytest.mark.parametrize("model", [Pacejka(), PacejkaCurvature()])
def test_bounds_hold_on_ellipses(model: Expression) -> None:
    """Against the model itself at complex inputs on the ellipse, where the maximum is."""
    rng = np.random.default_rng(5)
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 400))
    checked = 0
    for _ in range(3000):
        centre, rho, half = rng.uniform(-0.2, 0.2), rng.uniform(1.1, 8), 10 ** rng.uniform(-3, -0.7)
        a, b = half * (rho + 1 / rho) / 2, half * (rho - 1 / rho) / 2
        theta = list(rng.uniform([-60, -4, 1, -0.1, 0], [60, 4, 9, 0.1, 0]))
        if isinstance(model, PacejkaCurvature):
            theta.insert(3, rng.uniform(-6, 2))
        assert model.bound is not None
        amplitude, v = model.bound((centre, a, b), tuple(theta))
        if v < 50:
            z = centre + a * circle.real + 1j * b * circle.imag
            value = model.value((z,), tuple(theta))
            assert np.abs(value).max() <= amplitude * np.exp(v) * (1 + 1e-9)
            assert np.abs(np.diff(value)).max() < 0.5 * amplitude * np.exp(v)  # no cut is crossed
            checked += 1
    assert checked > 500


@pytest.mark.slow  # it compiles a model of its own
def test_a_cubic_takes_four_values_of_each_quarter() -> None:
    rng = np.random.default_rng(2)
    x = rng.uniform(100, 700, 3000)
    thetas = rng.uniform(-500, 500, (50, 4))
    model = TorqueCubic()
    y = model.predict(thetas[:1], x)[0] + rng.standard_normal(3000)
    losses, counts = CompressedLoss(model, x, y).counted(thetas, np.full(50, np.inf))
    expected = np.mean((model.predict(thetas, x) - y) ** 2, axis=1)
    assert losses == pytest.approx(expected, rel=1e-12)
    assert set(counts) == {2 * 16}  # first how large the loss is, then the loss


@COMPILES
def test_equal_models_share_one_compilation() -> None:
    x = np.linspace(50, 700, 100)
    first, second, other = (
        CompressedLoss(TorqueCubic(omega_max), x, x)._compiled for omega_max in (650, 650, 600)
    )
    assert first is second
    assert first is not other


@COMPILES
def test_lower_fidelities_are_those_of_the_points() -> None:
    thetas = candidates(40)
    compressed, plain = (problem(3000, switch) for switch in (True, False))
    assert compressed.loss(thetas, 0.3).tolist() == plain.loss(thetas, 0.3).tolist()
    assert compressed.loss(thetas).tolist() != plain.loss(thetas).tolist()


@COMPILES
def test_data_without_scatter_use_every_point() -> None:
    x, y = sample(3000, noise=0.0)
    thetas = TRUE * (1 + np.geomspace(1e-9, 1e-3, 20)[:, None] * np.array([1, 1, 0, 0, 0]))
    losses, counts = CompressedLoss(Pacejka(), x, y).counted(thetas, np.full(20, np.inf))
    assert set(counts) == {3000}
    assert losses == pytest.approx(problem(3000, False, noise=0.0).loss(thetas), rel=1e-12)


@COMPILES
def test_a_loss_below_the_expected_scatter_is_summed_point_by_point() -> None:
    """A steep curve in few wide panels looks like scatter until a candidate meets it."""
    x = np.sort(np.random.default_rng(0).uniform(-0.2, 0.2, 3000))
    theta = np.array([[1e5, 1.0, 4000.0, 0.0, 0.0]])
    y = Pacejka().predict(theta, x)[0] + 1e-4 * np.sin(1e7 * x)
    losses, counts = CompressedLoss(Pacejka(), x, y).counted(theta, np.array([np.inf]))
    assert losses == pytest.approx(full(x, y, theta), rel=1e-9)
    assert counts[0] >= 3000


@COMPILES
def test_repeated_inputs() -> None:
    x, y = sample(3000)
    x = np.round(x, 2)
    thetas = candidates(200)
    assert CompressedLoss(Pacejka(), x, y).losses(thetas) == pytest.approx(
        full(x, y, thetas), rel=1e-9
    )


@COMPILES
def test_clustered_inputs() -> None:
    rng = np.random.default_rng(4)
    x = np.concatenate([0.1 + 1e-9 * rng.standard_normal(500), rng.standard_normal(500) ** 3 / 50])
    y = 1000 * rng.standard_normal(1000)
    thetas = candidates(200)
    assert CompressedLoss(Pacejka(), x, y).losses(thetas) == pytest.approx(
        full(x, y, thetas), rel=1e-9
    )


def test_every_rule_keeps_the_sum_of_squares_of_polynomials() -> None:
    x, y = sample(500)
    tree = panels(x, y)
    polynomial = np.polynomial.Chebyshev([3.0, -1.0, 2.0, 0.5], domain=[-0.2, 0.2])
    order = np.argsort(x)
    for k in range(tree.centre.size):
        rows = order[tree.first[k] : tree.last[k]]
        if tree.below[k] < 0:
            continue
        for o in range(tree.orders[k]):
            for degree in (3, ORDERS[o] - 1):
                q = (
                    polynomial
                    if degree == 3
                    else np.polynomial.Chebyshev.basis(degree, [-0.2, 0.2])
                )
                t, w, u = tree.nodes[k, :, STARTS[o] : STARTS[o + 1]]
                square = np.sum((w * 100 * q(t) - u) ** 2) + tree.rests[k, o]
                assert square == pytest.approx(np.sum((100 * q(x[rows]) - y[rows]) ** 2), rel=1e-11)


@COMPILES
def test_a_batch_equals_its_rows_bit_for_bit() -> None:
    p = problem(3000, compressed=True)
    thetas = candidates(60)
    batch = p.loss(thetas)
    assert [p.loss(theta[None])[0] for theta in thetas] == batch.tolist()


@COMPILES
def test_limits_change_no_decision() -> None:
    x, y = sample(3000)
    loss = CompressedLoss(Pacejka(), x, y)
    thetas = candidates(1000)
    losses = loss.losses(thetas)
    factors = np.random.default_rng(1).uniform(0.9, 1.1, len(thetas))
    for limits in (losses * factors, losses, np.nextafter(losses, np.inf), losses / 10):
        limited, _ = loss.counted(thetas, limits)
        better = losses < limits
        assert limited[better].tolist() == losses[better].tolist()
        assert (limited[~better] >= limits[~better]).all()


@COMPILES
def test_compiled_steps_give_the_trace_of_single_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    optimizer = MIHO(R=60, eta=3)
    compiled = minimize(optimizer, problem(3000, compressed=True), Budget(), seed=1)
    monkeypatch.setattr(FitKernel, "climb", None)
    plain = minimize(optimizer, problem(3000, compressed=True), Budget(), seed=1)
    assert compiled.loss == plain.loss
    assert compiled.theta.tolist() == plain.theta.tolist()
    assert compiled.evaluations == plain.evaluations
    points = problem(3000, compressed=False)
    assert points.loss(compiled.theta[None])[0] == pytest.approx(compiled.loss, rel=1e-9)


@COMPILES
def test_residuals_and_fidelities_are_of_the_points() -> None:
    compressed, all_points = problem(3000, compressed=True), problem(3000, compressed=False)
    assert compressed.residuals(TRUE).tolist() == all_points.residuals(TRUE).tolist()
    assert compressed.loss(TRUE[None], 0.5).tolist() == all_points.loss(TRUE[None], 0.5).tolist()


def test_what_cannot_be_compressed_is_told() -> None:
    p = problem(50, compressed=False)
    with pytest.raises(ValueError, match=r"compressed is true for Pacejka .* Huber; .* false"):
        CurveFit(p.model, p.dataset, SPACE, rho=Huber(100.0), compressed=True)


TWO_MODELS = """
import sys
import numpy as np
from miho.compiled import Steps
from miho.compiled.compressed import CompressedLoss
from miho.models import Pacejka, PacejkaCurvature
from numba.core import event

x = np.linspace(-0.2, 0.2, 3000)
y = -4000 * np.tanh(10 * x) + 100 * np.sin(1e6 * x)
for name in sys.argv[1:]:
    model = {"Pacejka": Pacejka(), "PacejkaCurvature": PacejkaCurvature()}[name]
    theta = np.array([12, 1.4, 4500, *[-1] * (name != "Pacejka"), 0.005, 60])[None]
    loss = CompressedLoss(model, x, y)
    with event.install_recorder("numba:compile") as compiled:
        found, L = loss.losses(theta), np.array([np.inf])
        steps = np.zeros((0, 1, theta.size)), np.zeros((0, theta.size))
        bounds = theta[0] - 1, theta[0] + 1
        loss.climb(Steps(theta, theta.copy(), L, *steps, bounds), np.inf, 0.0)
    expected = np.mean((model.predict(theta, x) - y) ** 2)
    np.testing.assert_allclose([found[0], L[0]], expected, rtol=1e-9)
    print(len(compiled.buffer))
"""


@pytest.mark.slow
def test_two_models_compiled_apart_are_not_taken_for_each_other(tmp_path: Path) -> None:
    """Each compiled in a process of its own, then both read from the cache in either order."""

    def run(*models: str) -> list[int]:
        command = [sys.executable, "-c", TWO_MODELS, *models]
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_OPT": "0"}
        process = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False
        )
        assert process.returncode == 0, process.stderr
        return [int(count) for count in process.stdout.split()]

    run("Pacejka")
    run("PacejkaCurvature")
    assert run("Pacejka", "PacejkaCurvature") == [0, 0]
    assert run("PacejkaCurvature", "Pacejka") == [0, 0]
