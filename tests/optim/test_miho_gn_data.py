"""Hyperband over Gauss-Newton steps on data: certified, exact, of little noise, rarely telling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from baselines.problems import PublishedModel, load_published, published_fit
from miho.data import Dataset
from miho.identification import CurveFit
from miho.optim import MIHOGN, Budget, Outcome, Parameter, Space, minimize
from tests.optim.decays import SPACE, Decay, fit

NIST = {
    "misra1a": (
        "rise",
        [(-935.81828951, 1674.76041869), (-0.001925703943145, 0.002575860374955)],
        [2.3894212918e02, 5.5015643181e-04],
        [2.7070075241e00, 7.2668688436e-06],
    ),
    "mgh09": (
        "kowalik_osborne",
        [(-111.43956185981, 136.63236879439), (-174.44794719199, 213.63922952072),
         (-186.07318921188, 227.69624571882), (-174.75165718126, 213.88771951194)],
        [1.9280693458e-01, 1.9128232873e-01, 1.2305650693e-01, 1.3606233068e-01],
        [1.1435312227e-02, 1.9633220911e-01, 8.0842031232e-02, 9.0025542308e-02],
    ),
    "thurber": (
        "cubic_over_cubic",
        [(-350, 2650), (-1250, 3750), (-424.572659465, 1407.811028235),
         (-119.3748993095, 234.7915436005), (-0.65, 2.35), (-0.15, 0.85), (-0.06, 0.14)],
        [1.2881396800e03, 1.4910792535e03, 5.8323836877e02, 7.5416644291e01, 9.6629502864e-01,
         3.9797285797e-01, 4.9727297349e-02],
        [4.6647963344e00, 3.9571156086e01, 2.8698696102e01, 5.5675370270e00, 3.1333340687e-02,
         1.4984928198e-02, 6.5842344623e-03],
    ),
    "mgh17": (
        "osborne_1",
        [(-222.9352447134, 273.3106547655), (-666.75, 818.25), (-545.5, 444.5), (-4.445, 5.455),
         (-8.89, 10.91)],
        [3.7541005211e-01, 1.9358469127e00, -1.4646871366e00, 1.2867534640e-02, 2.2122699662e-02],
        [2.0723153551e-03, 2.2031669222e-01, 2.2175707739e-01, 4.4861358114e-04, 8.9471996575e-04],
    ),
}  # fmt: skip
"""Formula, box (ten times as wide as the spread of NIST's starts), certified values, deviations."""


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 6))]
)
@pytest.mark.parametrize(
    "name", ["misra1a", *(pytest.param(k, marks=pytest.mark.slow) for k in list(NIST)[1:])]
)
def test_nists_certified_parameters_are_found(name: str, seed: int) -> None:
    """From no start of NIST's, to 1e-3 of their standard deviations; of two terms in either order.

    Steps end where they promise 1e-8 of the loss, of which m - d times that is a squared distance
    in standard deviations: 6e-4 of one for the 30 degrees of freedom of the largest.
    """
    formula, box, certified, deviations = NIST[name]
    model = PublishedModel(formula)
    space = Space(
        tuple(Parameter(p, "-", *sides) for p, sides in zip(model.parameters, box, strict=True))
    )
    problem = CurveFit(model, load_published(name), space)
    record = minimize(MIHOGN(), problem, seed=seed)
    assert record.outcome is Outcome.CONVERGED
    assert record.loss == pytest.approx(problem.loss(np.array([certified]))[0], rel=2e-8)
    assert record.theta is not None
    theta = record.theta
    if name == "mgh17" and theta[3] > theta[4]:
        theta = theta[[0, 2, 1, 4, 3]]
    assert (np.abs(theta - certified) < 1e-3 * np.array(deviations)).all()


def test_exact_data_are_fitted_to_their_rounding() -> None:
    """Ends differ by their rounding alone, and are one optimum."""
    problem = fit(noise=0.0)
    record = minimize(MIHOGN(), problem)
    assert record.outcome is Outcome.CONVERGED
    assert record.loss <= problem.rounding
    assert record.theta is not None
    np.testing.assert_allclose(record.theta, [2.0, 0.7, 0.3], rtol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_a_large_offset_hides_no_noise(seed: int) -> None:
    """Noise of 1e-9 of the output is not rounding: descents go on until its optimum.

    That is by SciPy, without the offset, whose removal rounds by 1e-7 of the noise. Losses agree to
    1e-5: rounding of the output, 1e-10, correlates with the noise of 1e-3 by chance.
    """
    offset, exact = 1e6, fit(400)
    t, rng = exact.dataset["t"], np.random.default_rng(2)
    y = offset + 2 * np.exp(-0.7 * t) + 1e-3 * rng.standard_normal(t.size)
    c = replace(SPACE.parameters[2], low=0.0, high=2 * offset)
    data = Dataset("offset", {"t": t, "y": y}, {"t": "s", "y": "V"}, "y")
    problem = CurveFit(Decay(), data, Space((*SPACE.parameters[:2], c)))
    best = least_squares(
        lambda x: x[0] * np.exp(-x[1] * t) + x[2] - (y - offset),
        [2, 0.7, 0],
        xtol=1e-12,
        ftol=1e-12,
    )
    record = minimize(MIHOGN(), problem, seed=seed)
    assert record.outcome is Outcome.CONVERGED
    assert record.descents is not None
    assert record.descents.ends == pytest.approx([2 * best.cost / t.size] * 7, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_last_digits_of_data_are_no_rounding(seed: int) -> None:
    """Lanczos1 is exact but for its 14th digit, which NIST's sum of squares is of.

    Descents end there and agree. The sum of squares to 1 %: rounding of an output of 1 by 2e-16 is
    0.3 % of errors of 8e-14, and each row has another one.
    """
    published = published_fit("lanczos1")
    box = (("b1", 10), ("b2", 100), ("b3", 90), ("b4", 300), ("b5", 160), ("b6", 500))
    space = Space(tuple(Parameter(p, "-", top / 1e4, top, scale="log") for p, top in box))
    problem = CurveFit(PublishedModel(published.model), published.dataset, space)
    record = minimize(MIHOGN(), problem, Budget(evaluations=40_000), seed)
    assert record.outcome is Outcome.CONVERGED
    assert record.descents is not None
    assert record.descents.agreeing is not None
    assert record.descents.agreeing >= 5
    assert 24 * np.array(record.descents.ends[:5]) == pytest.approx(published.squares, rel=0.01)


def test_what_one_row_in_a_hundred_tells_is_identified() -> None:
    """c alone is told by late rows, which few random rows hold; half of the data is far too many.

    The optimum is that of the best b, to the 1e-8 of the loss at which steps end.
    """
    rng = np.random.default_rng(3)
    t = np.where(
        rng.random(20_000) < 0.01, rng.uniform(50, 60, 20_000), rng.uniform(0, 0.2, 20_000)
    )
    y = 2 * np.exp(-0.7 * t) + 0.3 + 0.01 * rng.standard_normal(t.size)
    data = Dataset("rare", {"t": t, "y": y}, {"t": "s", "y": "V"}, "y")
    for seed in range(3):
        record = minimize(MIHOGN(), CurveFit(Decay(), data, SPACE), seed=seed)
        assert record.outcome is Outcome.CONVERGED
        assert record.theta is not None
        np.testing.assert_allclose(record.theta, [2.0, 0.7, 0.3], rtol=0.02)
        # Later improvements are of the last digits, and depend on the processor.
        near = np.asarray(record.trace.loss) <= record.loss * (1 + 1e-8)
        assert np.asarray(record.trace.evaluations)[near][0] < 30
