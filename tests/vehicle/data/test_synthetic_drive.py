"""The simulated drive with twelve tire parameters, and outputs below each other."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from miho.data import Dataset, stacked
from miho.vehicle.data import tire_drive
from miho.vehicle.data.synthetic_drive import DRIVE_TRUTH
from miho.vehicle.models import PacejkaCurvature, SingleTrack
from miho.vehicle.models.single_track_motion import DRIVE_NOISE

CAR = {"mass": 800.0, "lf": 1.7, "lr": 1.271, "Izz": 850.0}


@pytest.mark.slow
def test_the_motion_is_that_of_the_single_track_car() -> None:
    """Five seconds by SciPy at 1e-9, with the forces of `PacejkaCurvature`: Sx is -Sh there."""
    data, car = tire_drive(CAR, duration=5.0, noise=0.0), SingleTrack(**CAR)
    t, ax, steering = (np.split(data[name], 3)[0] for name in ("t", "ax", "steering"))
    tires = np.array(list(DRIVE_TRUTH.values())).reshape(2, 6) * [1, 1, 1, 1, -1, 1]
    state, motion = np.array([30.0, 0.0, 0.0]), [np.array([30.0, 0.0, 0.0])]
    for row in range(t.size - 1):

        def rates(_: float, z: np.ndarray, row: int = row) -> list[float]:
            slip = car.slip_angles(*z, steering[row])
            F_f, F_r = (
                PacejkaCurvature().predict(tire[None], np.atleast_1d(alpha))[0, 0]
                for tire, alpha in zip(tires, slip, strict=True)
            )
            F_f *= np.cos(steering[row])
            lateral, turn = (F_f + F_r) / car.mass, (car.lf * F_f - car.lr * F_r) / car.Izz
            return [ax[row] + z[1] * z[2], lateral - z[0] * z[2], turn]

        span = (t[row], t[row + 1])
        state = solve_ivp(rates, span, state, rtol=1e-9, atol=1e-9).y[:, -1]
        motion.append(state)
    for name, expected in zip(DRIVE_NOISE, np.transpose(motion), strict=True):
        off = np.split(data[name], 3)[0] - expected
        assert np.abs(off).max() < 1e-3 * DRIVE_NOISE[name]


def test_noise_and_disturbance_are_as_stated() -> None:
    exact, noisy, blown = (
        tire_drive(CAR, "gentle", 60.0, noise, gusts)
        for noise, gusts in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    )
    assert np.std(noisy["value"] - exact["value"]) == pytest.approx(1.0, rel=0.05)
    assert np.array_equal(np.unique(exact["output"]), [0, 1, 2])
    # In a row of 20 ms a force of 400 N moves 800 kg by 0.01 m/s, along: nothing else does.
    speed = np.split(blown["vx"] - exact["vx"], 3)[0]
    assert np.std(np.diff(speed)) == pytest.approx(0.01, rel=0.1)


def test_outputs_stand_below_each_other() -> None:
    columns = {"t": [0.0, 1.0], "a": [1.0, 2.0], "b": [10.0, 20.0]}
    units = dict.fromkeys(columns, "m")
    data = Dataset("both", {name: np.array(c) for name, c in columns.items()}, units, "a")
    rows = stacked(data, {"b": 10.0, "a": 0.5})
    assert rows.output == "value"
    assert rows["value"].tolist() == [1.0, 2.0, 2.0, 4.0]
    assert rows["output"].tolist() == [0.0, 0.0, 1.0, 1.0]
    assert rows["a"].tolist() == [1.0, 2.0, 1.0, 2.0]
    for scales, message in (
        ({}, "scales is empty"),
        ({"a": 0.0}, "scale of a is 0.0"),
        ({"c": 1.0}, "no column 'c'"),
    ):
        with pytest.raises(ValueError, match=message):
            stacked(data, scales)
    with pytest.raises(ValueError, match="has a column 'output' already"):
        stacked(rows, {"a": 1.0})


@pytest.mark.parametrize(
    "bad", [{"style": "calm"}, {"duration": 0.0}, {"noise": -1.0}, {"disturbance": -1.0}]
)
def test_bad_settings_are_named(bad: dict[str, float]) -> None:
    ((name, value),) = bad.items()
    with pytest.raises(ValueError, match=rf"{name} is {value!r}; expected"):
        tire_drive(CAR, **bad)  # type: ignore[arg-type]
