"""The vehicle: its file, its views as other models, and what it refuses."""

from functools import cache
from typing import Any

import hydra
import pytest
from omegaconf import OmegaConf

from experiments.app.compose import CONF
from miho.vehicle.driving.vehicle import Vehicle


@cache
def av21() -> dict[str, Any]:
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        settings = OmegaConf.to_container(hydra.compose("vehicle/av21_full").vehicle)
    assert isinstance(settings, dict)
    return {str(name): value for name, value in settings.items()}


def test_the_av21_of_the_configuration() -> None:
    car = Vehicle.from_settings(av21())
    assert car.wheelbase == pytest.approx(2.971, abs=1e-12)
    assert car.single_track.lf == 1.70
    assert car.longitudinal.ratio(6) == pytest.approx(0.8889 * 3.0)
    static = 9.80665 * car.mass * car.lr / car.wheelbase
    assert static / 2 == pytest.approx(1678, rel=1e-3), "newtons on a front wheel at rest"


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"lf": 0.0, "lr": 0.0}, "vehicle.lf is 0.0; expected a positive number"),
        ({"mass": float("nan")}, "vehicle.mass is nan; expected a finite number"),
        ({"mass": "800"}, "vehicle.mass is '800'; expected a finite number"),
        ({"C_d": -0.1}, "vehicle.C_d is -0.1; expected a number of at least 0"),
        ({"efficiency": 1.2}, "vehicle.efficiency is 1.2; expected at most 1"),
        ({"gear_ratios": []}, "vehicle.gear_ratios is (); give a positive ratio for each gear"),
        ({"idle_speed": 800.0}, "vehicle.idle_speed is 800 rad/s; expected below"),
        ({"unsprung_mass_front": 400.0}, "vehicle.unsprung_mass_front is 400 kg; expected less"),
        ({"wheels": 4}, "vehicle.wheels is unknown; allowed are mass, lf, lr"),
    ],
)
def test_refused(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError) as caught:
        Vehicle.from_settings(av21() | changes)
    assert str(caught.value).startswith(sentence)
    assert "\n" not in str(caught.value)


def test_a_missing_parameter() -> None:
    some = {name: value for name, value in av21().items() if name != "h_cg"}
    with pytest.raises(ValueError, match=r"^vehicle\.h_cg is missing; give it in SI units$"):
        Vehicle.from_settings(some)
