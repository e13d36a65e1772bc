"""The settings of PSO do what they say, and those with constriction are those of its source."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from experiments.check.readings import VARIANTS
from miho import Budget, minimize
from miho.methods.pso import PSO, PSOState
from miho.optim import Outcome
from miho.testing import DecayFit

CONF = Path(__file__).parents[2] / "conf" / "optimizer"


def settings_of(name: str) -> dict[str, Any]:
    """What a file says, without what it inherits."""
    text = (CONF / f"{name}.yaml").read_text(encoding="utf-8")
    others = ("name", "defaults", "_target_")
    return {key: value for key, value in yaml.safe_load(text).items() if key not in others}


def constriction() -> PSO:
    return PSO(**settings_of("pso_constriction"))


@pytest.mark.parametrize("n", [100, 500])
@pytest.mark.parametrize("end", ["constriction", "constriction_no_limit"])
def test_the_paper_s_swarms_with_constriction_have_its_coefficients(n: int, end: str) -> None:
    own = {key: value for key, value in settings_of(f"pso_{n}").items() if key == "particles"}
    swarm = PSO(**(own | VARIANTS[f"pso_{n}_{end}"][1]))
    expected = constriction()
    assert swarm.particles == n
    assert (swarm.c1, swarm.c2) == (expected.c1, expected.c2)
    assert [swarm._inertia(i) for i in (0, 700, 10**6)] == [expected.inertia_start] * 3
    assert swarm.velocity_limit == (None if end.endswith("no_limit") else 0.5)


def moved(optimizer: PSO, velocity: float) -> PSOState:
    """A particle at the middle of the box after one step, whose only pull is its velocity."""
    state = optimizer.init(DecayFit.space, np.random.default_rng(0))
    low, high = DecayFit.space.bounds
    state.positions[:] = (low + high) / 2
    state.velocities[:] = velocity * (high - low)
    optimizer.tell(state, optimizer.ask(state), np.ones(1))
    return state


def test_a_limit_bounds_the_step_and_null_does_not() -> None:
    """In units of the range: the position starts at 0.5 and the inertia is 1."""
    low, high = DecayFit.space.bounds
    swarm = partial(PSO, particles=1, inertia_start=1.0, bounds="none")
    for limit, expected in ((0.25, 0.75), (None, 1.25)):
        position = (moved(swarm(velocity_limit=limit), 0.75).positions - low) / (high - low)
        np.testing.assert_allclose(position, expected, rtol=1e-14)  # a few roundings


def test_a_particle_stops_at_a_bound_or_leaves_the_box() -> None:
    swarm = partial(PSO, particles=1, inertia_start=1.0, velocity_limit=None)
    clipped, free = moved(swarm(), 0.75), moved(swarm(bounds="none"), 0.75)
    np.testing.assert_array_equal(clipped.positions[0], DecayFit.space.bounds[1])
    assert not clipped.velocities.any()
    assert (free.positions[0] > DecayFit.space.bounds[1]).all()
    assert free.velocities.all()


def test_a_swarm_without_inertia_weight_limit_and_bounds_diverges_and_ends() -> None:
    settings: dict[str, Any] = {"inertia_start": 1.0, "inertia_end": 1.0, "velocity_limit": None}
    budget = Budget(evaluations=200_000)
    record = minimize(PSO(particles=20, bounds="none", **settings), DecayFit(), budget, seed=1)
    assert record.outcome is Outcome.CONVERGED
    assert record.evaluations < 200_000
    assert record.outside > record.evaluations / 2
    boxed = minimize(PSO(particles=20, **settings), DecayFit(), Budget(evaluations=5000), seed=1)
    assert boxed.outcome is Outcome.BUDGET
    assert boxed.outside == 0


@pytest.mark.parametrize("sampling", ["normal", "uniform", "uniform_plus_noise"])
def test_it_starts_where_sampling_says(sampling: str) -> None:
    space = DecayFit.space
    start = space.initial(200, sampling)
    free = PSO(particles=200, sampling=sampling, bounds="none")
    np.testing.assert_array_equal(free.init(space, np.random.default_rng(0)).positions, start)
    boxed = PSO(particles=200, sampling=sampling).init(space, np.random.default_rng(0)).positions
    np.testing.assert_array_equal(boxed, np.clip(start, *space.bounds))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"bounds": "reflect"}, "bounds is 'reflect'; expected one of clip, none"),
        ({"sampling": "grid"}, "sampling is 'grid'; expected one of normal"),
        ({"velocity_limit": 0.0}, "velocity_limit is 0.0; expected a positive number"),
    ],
)
def test_bad_settings(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PSO(**settings)


def test_constriction_is_that_of_clerc_and_kennedy() -> None:
    """chi = 2 / |2 - phi - sqrt(phi^2 - 4 phi)| with phi = 2.05 + 2.05."""
    optimizer, phi = constriction(), 4.1
    chi = 2 / abs(2 - phi - np.sqrt(phi**2 - 4 * phi))
    assert chi == pytest.approx(0.7298, abs=5e-5)
    assert [optimizer._inertia(i) for i in (0, 500, 10**6)] == pytest.approx([chi] * 3, rel=1e-14)
    assert (optimizer.c1, optimizer.c2) == pytest.approx((2.05 * chi,) * 2, rel=1e-14)


def test_constriction_converges() -> None:
    record = minimize(constriction(), DecayFit(), Budget(evaluations=10_000), seed=1)
    longer = minimize(PSO(particles=30, iterations=200), DecayFit(), Budget(evaluations=30_000))
    assert record.loss == pytest.approx(longer.loss, rel=1e-9)
