"""Manoeuvres end where they should, and their logs hold what identification needs."""

import numpy as np
import pytest

from miho.vehicle.data.torque_samples import torque_samples
from miho.vehicle.driving import Sensors, embedded_plant
from miho.vehicle.driving.embedded import embedded_engine
from miho.vehicle.driving.proving_ground import (
    LEAD,
    PERIOD,
    SLIDING,
    Manoeuvre,
    held_throttles,
    perform,
    programme,
    weaves,
)
from tests.vehicle.driving.cars import car

AV21 = car().vehicle
SILENT = Sensors(
    **dict.fromkeys(Sensors.__dataclass_fields__, 0.0)  # every channel exact
)


def test_a_weave_reaches_beyond_the_linear_range_and_stops_before_a_spin() -> None:
    plant = embedded_plant(AV21)
    recording = perform(plant, weaves()[-1])
    slide = [abs(motion.vy) / motion.vx for motion in recording.motions]
    assert max(slide) <= SLIDING
    assert max(abs(motion.ay) for motion in recording.motions) > 10.0


def test_a_held_opening_shows_the_torque_of_the_engine() -> None:
    """Without noise Eq. 6-7 give back the map, less what the torque's lag of 0.2 s leaves.

    After 1 s that is 0.7 % of a rise of 175 Nm, and 0.2 s of a map that rises by some 9 Nm/s on the
    way up: 3 Nm. In the second half, where the car has found its speed, next to nothing.
    """
    plant = embedded_plant(AV21)
    manoeuvre = held_throttles(AV21, 0.3, gears=(3,))[1]
    log = perform(plant, manoeuvre).log("held", SILENT, np.random.default_rng(0))
    samples = torque_samples(log, AV21.longitudinal, throttle=0.3, settle=1.0)
    truth = embedded_engine().torque(samples["omega"], 0.3)
    miss = np.abs(samples["torque"] - truth)
    assert miss.max() < 4.0
    assert miss[len(miss) // 2 :].max() < 1.0
    assert np.ptp(samples["omega"]) > 100.0


def test_pedals_are_pressed_after_the_car_has_rolled() -> None:
    manoeuvre = Manoeuvre(speed=30.0, gear=0, duration=1.0, brake=1e6)
    recording = perform(embedded_plant(AV21), manoeuvre)
    pressed = [command.brake for command in recording.commands]
    assert pressed == [0.0] * round(LEAD / PERIOD) + [1e6] * round((1 - LEAD) / PERIOD)
    assert recording.motions[-1].vx < recording.motions[0].vx


def test_it_ends_when_the_speed_leaves_its_range() -> None:
    manoeuvre = Manoeuvre(speed=30.0, gear=0, duration=5.0, within=(25.0, 31.0), brake=2e6)
    recording = perform(embedded_plant(AV21), manoeuvre)
    assert 0.5 < len(recording.motions) * PERIOD < 5.0
    assert min(motion.vx for motion in recording.motions) >= 25.0


def test_the_programme_names_its_parts() -> None:
    assert list(programme(AV21, (0.05, 1.0))) == ["weave", "braking", "throttle_05", "throttle_100"]


@pytest.mark.parametrize(
    ("change", "told"),
    [({"speed": 3.0}, "speed is 3.0 m/s"), ({"brake": -1.0}, "brake is -1.0"),
     ({"duration": float("nan")}, "duration is nan")],
)  # fmt: skip
def test_wrong_settings_are_one_line(change: dict[str, float], told: str) -> None:
    settings: dict[str, float] = {"speed": 30.0, "duration": 1.0} | change
    with pytest.raises(ValueError, match=told) as error:
        Manoeuvre(gear=1, **settings)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)
