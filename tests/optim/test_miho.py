"""MIHO against a literal, sequential transcription of Alg. 1."""

import numpy as np
import pytest
from numpy.typing import NDArray

from miho import MIHO, Budget, minimize
from miho.optim import Outcome, hyperband_table
from miho.optim.miho import annealed_sigma, mutate
from miho.optim.seeds import stream
from miho.testing import DecayFit

Array = NDArray[np.float64]


def transcription(R: int, eta: int, seed: int) -> tuple[Array, float, int]:
    """Alg. 1 line by line: one rung at a time, all its configurations side by side."""
    problem = DecayFit()
    space = problem.space.seeded(problem.name, seed)
    rng = stream("own", problem.name, seed, "MIHO")
    low, high = space.bounds
    sigma_max = space.sigma[0]
    best, best_loss, evaluations = np.empty(2), np.inf, 0
    P, L = np.empty((0, 2)), np.empty(0)
    for rung in hyperband_table(R, eta):
        if rung.j == 0:
            first = rung.s == hyperband_table(R, eta)[0].s
            P = space.initial(rung.n) if first else space.sample(rung.n, rng)
            L = np.array([problem.loss(space.decode(p)[None])[0] for p in P])
            evaluations += len(P)
        else:
            top = sorted(range(len(L)), key=lambda i: (L[i], i))[: rung.n]
            P, L = P[top], L[top]
        for step in range(rung.mutations):
            sigma = sigma_max * (1 - step / rung.mutations)
            noise = rng.standard_normal(P.shape)
            for i in range(len(P)):
                mutant = np.clip(noise[i] * sigma + P[i], low, high)
                loss = problem.loss(space.decode(mutant)[None])[0]
                evaluations += 1
                if loss < L[i]:
                    P[i], L[i] = mutant, loss
        if L.min() < best_loss:
            best, best_loss = P[np.argmin(L)].copy(), L.min()
    return space.decode(best), best_loss, evaluations


@pytest.mark.parametrize(("R", "eta"), [(1, 2), (8, 2), (30, 3), (100, 5)])
def test_equals_the_transcription(R: int, eta: int) -> None:
    record = minimize(MIHO(R=R, eta=eta), DecayFit(), seed=5)
    theta, loss, evaluations = transcription(R, eta, 5)
    assert record.outcome is Outcome.CONVERGED
    assert record.evaluations == evaluations
    assert record.loss == pytest.approx(loss, rel=1e-12)
    assert record.theta == pytest.approx(theta, rel=1e-9)


def test_evaluations_are_those_of_the_table() -> None:
    """A fresh configuration costs one evaluation, a survivor's loss is not paid for again."""
    table = hyperband_table(10_000, 5, "floor")
    expected = sum(g.n * (g.mutations + (g.j == 0)) for g in table)
    assert expected == 355_349
    record = minimize(MIHO(R=100, eta=3), DecayFit())
    table = hyperband_table(100, 3)
    assert record.evaluations == sum(g.n * (g.mutations + (g.j == 0)) for g in table)


def test_annealing() -> None:
    space = DecayFit.space
    linear = annealed_sigma(space, 10)
    assert linear[:, 0] == pytest.approx(0.5 * np.linspace(1, 0.1, 10))
    exponential = annealed_sigma(space, 8, "exponential")
    assert exponential[[0, 2, 4], 0] == pytest.approx([0.5, 0.25, 0.125])
    assert annealed_sigma(space, 0).shape == (0, 2)


def test_clipping() -> None:
    space = DecayFit.space
    P = np.tile(space.bounds[1], (1000, 1))
    boxed = mutate(P, space.sigma[0], space, stream("t"), "box")
    assert space.contains(space.decode(boxed)).all()
    lower = mutate(P, space.sigma[0], space, stream("t"), "lower")
    assert (lower > space.bounds[1]).any()
    assert (lower >= space.bounds[0]).all()
    P = np.tile(space.bounds[0], (1000, 1))
    free = mutate(P, space.sigma[0], space, stream("t"), "none")
    np.testing.assert_array_equal(free, P + space.sigma[0] * stream("t").standard_normal(P.shape))
    assert (free < space.bounds[0]).any()


def test_it_finds_the_optimum_of_a_smooth_problem() -> None:
    """Independent value: SciPy's least squares from the same box."""
    from scipy.optimize import least_squares

    problem = DecayFit()
    optimum = least_squares(problem.residuals, [1.0, 1.0], problem.jacobian)
    record = minimize(MIHO(R=1000, eta=5), DecayFit(), Budget(evaluations=40_000))
    assert record.loss == pytest.approx(np.mean(optimum.fun**2), rel=1e-4)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"R": 0}, "R is 0"),
        ({"eta": 1}, "eta is 1"),
        ({"rounding": "up"}, "one of ceil, floor"),
        ({"sampling": "grid"}, "one of normal"),
        ({"annealing": "cosine"}, "one of linear"),
        ({"clip": "upper"}, "one of box"),
        ({"early_stopping": "no"}, "early_stopping is 'no'; expected True or False"),
    ],
)
def test_bad_settings(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MIHO(**settings)


def test_fresh_proposals_are_draws_of_the_initial_distribution() -> None:
    """MIHO without mutation compares a configuration with a draw that does not depend on it."""
    space = DecayFit.space
    settings = MIHO(proposal="fresh")
    sigma = space.sigma[0]
    draws = [
        settings.proposals(P, sigma, space, stream("t"))
        for P in (np.zeros((5, 2)), np.ones((5, 2)))
    ]
    assert np.array_equal(draws[0], draws[1])
    assert np.array_equal(draws[0], space.sample(5, stream("t")))
