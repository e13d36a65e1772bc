"""Sensors: the noise has the stated size, is drawn from the generator, and leaves time alone."""

import numpy as np
import pytest

from miho.vehicle.driving.plant import Motion, Sensors

MOTION = Motion(
    1.0, 2.0, 3.0, 0.1, 40.0, 0.2, 0.3, 1.0, 8.0, 0.02, np.full(4, 130.0), 500.0, 200.0, 4, 1e5,
    np.full(4, 2000.0),
)  # fmt: skip


def test_the_noise_has_the_stated_size() -> None:
    """Of 2000 draws the standard deviation is known to 1.6 %; six of them is never missed."""
    rng = np.random.default_rng(0)
    sensors = Sensors()
    measured = [sensors.measure(MOTION, rng) for _ in range(2000)]
    for name in ("yaw", "vx", "vy", "yaw_rate", "ax", "ay", "engine_speed", "brake_pressure"):
        values = np.array([getattr(motion, name) for motion in measured])
        std = getattr(sensors, name)
        assert values.std() == pytest.approx(std, rel=0.1), name
        assert values.mean() == pytest.approx(getattr(MOTION, name), abs=6 * std / 2000**0.5), name
    wheels = np.array([motion.wheel_speeds for motion in measured])
    np.testing.assert_allclose(wheels.std(axis=0), 0.1, rtol=0.1)
    assert abs(np.corrcoef(wheels.T)[0, 1]) < 0.14, "wheels are drawn one by one"
    assert {motion.time for motion in measured} == {1.0}
    assert {motion.gear for motion in measured} == {4}


def test_without_noise_and_with_a_seed() -> None:
    silent = Sensors(**dict.fromkeys(Sensors.__dataclass_fields__, 0.0))
    still = silent.measure(MOTION, np.random.default_rng(1))
    assert still[:10] == MOTION[:10]
    first, again = (Sensors().measure(MOTION, np.random.default_rng(2)) for _ in range(2))
    assert first.x == again.x != MOTION.x
    with pytest.raises(ValueError, match=r"^ay is -1; expected a number of at least 0$"):
        Sensors(ay=-1)
