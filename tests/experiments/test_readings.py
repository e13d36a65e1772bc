"""The readings' methods, their plan, and the interpreted loops whose cost is measured."""

from pathlib import Path

import numpy as np
import pytest

from experiments.app.build import ConfigError, build
from experiments.app.compose import CONF, composed
from experiments.benchmarks import interpreted
from experiments.check import readings
from miho.identification import CurveFit

STEPS = 3


@pytest.fixture(scope="module")
def tire() -> CurveFit:
    return build(composed(["dataset=tire_lf", "dataset.n=200"])).problem


def test_every_option_is_read_and_every_reading_has_its_options() -> None:
    named = {name for each in readings.READINGS for name in each.methods.values()}
    variants = readings.VARIANTS.keys()
    assert variants <= named
    assert {p.stem for p in (CONF / "optimizer").glob("*.yaml")} >= named - variants
    assert len({each.words for each in readings.READINGS}) == len(readings.READINGS)


def test_every_variant_is_its_method_with_other_settings() -> None:
    for request in readings.plan(1):
        name, identity = request.identity.optimizer, request.identity
        _, settings = readings.VARIANTS.get(name, (name, {}))
        assert settings.items() <= identity.config["optimizer"].items()


@pytest.mark.slow
def test_the_plan_is_of_full_size_and_names_each_method_once() -> None:
    requests = list(readings.plan(2))
    identities = [request.identity for request in requests]
    assert len({identity.id for identity in identities}) == len(requests)
    named = {name for each in readings.READINGS for name in each.methods.values()}
    assert {identity.optimizer for identity in identities} == named
    for identity in identities:
        optimizer, budget = identity.config["optimizer"], identity.config["budget"]
        assert budget["evaluations"] >= 500_000
        if identity.optimizer.startswith("miho"):
            assert (optimizer["R"], optimizer["eta"]) == (10_000, 5)


def test_costs_that_were_not_measured_are_asked_for(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is missing; run python -m"):
        readings.costs_of(tmp_path / "interpreted.csv")
    (tmp_path / "interpreted.csv").write_text("method,interpreted,compiled\nmiho,100,2.5\n")
    costs = readings.costs_of(tmp_path / "interpreted.csv")
    assert costs == {"interpreted": {"miho": pytest.approx(1e-4)}, "compiled": {
        "miho": pytest.approx(2.5e-6)}}  # fmt: skip


def test_the_interpreted_loss_is_the_loss(tire: CurveFit) -> None:
    thetas = tire.space.initial(20)
    values = [interpreted.loss(theta, *interpreted._data(tire)) for theta in thetas]
    # Sums of 200 squares in another order, of polynomials that are exact to 3e-15.
    np.testing.assert_allclose(values, tire.loss(thetas), rtol=1e-12)


def test_the_interpreted_descent_goes_down_the_gradient(tire: CurveFit) -> None:
    theta = tire.space.initial(1)[0]
    for _ in range(STEPS):
        gradient = 2 / tire.residuals(theta).size * tire.jacobian(theta).T @ tire.residuals(theta)
        theta = tire.space.clip(theta - 1e-10 * gradient)
    np.testing.assert_allclose(interpreted.descent(tire, 6 * STEPS), theta, rtol=1e-10)


def test_interpreted_mutations_and_swarms_lower_the_loss(tire: CurveFit) -> None:
    start = tire.loss(tire.space.initial(1))[0]
    assert interpreted.mutations(tire, 300) < start
    assert interpreted.swarm(tire, 2000, 20) < tire.loss(tire.space.initial(20)).min()
