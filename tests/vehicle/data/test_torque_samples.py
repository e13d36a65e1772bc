"""Torque samples: the torque that drove a simulated car is found again, and nothing else."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import g

from miho.quantities import Array
from miho.vehicle.data import DrivingLog, TorqueRules, load_torque_samples
from miho.vehicle.data.torque_samples import torque_samples
from miho.vehicle.models import Longitudinal

SETTINGS = {
    "mass": 800.0, "wheel_radius": 0.31, "final_drive": 3.0, "efficiency": 0.9,
    "gear_ratios": (2.9167, 1.875, 1.3809, 1.1154, 0.96, 0.8889), "engine_inertia": 0.2,
    "wheel_inertia": 3.0, "C_d": 0.474, "C_r": 120.0,
}  # fmt: skip
CAR = Longitudinal(**SETTINGS)
DT = 0.02
TIME = DT * np.arange(2001)


def torque_of(omega: Array) -> Array:
    """A torque curve of a held throttle [Nm]."""
    return 100 + 0.4 * omega - 0.0008 * omega**2


def drive(grade: float = 0.03, noise: float = 0.0) -> DrivingLog:
    """40 s at 20 % throttle from 12 m/s, shifting up at 480 rad/s; on a hill, as a sensor feels it.

    Integrated by Euler steps: the log's own acceleration is what moved it.
    """
    vx, gear, rows = 12.0, 2, []
    for _ in TIME:
        omega = float(CAR.engine_speed(vx, gear))
        if omega > 480:
            gear += 1
            omega = float(CAR.engine_speed(vx, gear))
        ax = float(CAR.acceleration(torque_of(np.array(omega)), vx, gear, grade))
        rows.append((vx, ax + g * np.sin(grade), gear, omega))
        vx += ax * DT
    values = np.array(rows).T
    scale = np.array([0.02, 0.2, 0.0, 1.0])[:, None]
    values = values + noise * scale * np.random.default_rng(0).standard_normal(values.shape)
    level = np.zeros(TIME.size)
    channels = dict(zip(("vx", "ax", "gear", "engine_speed"), values, strict=True))
    rest = {"time": TIME, "throttle": level + 0.2, "brake": level, "grade": level + grade}
    return DrivingLog("drive", channels | rest)


@pytest.fixture(scope="module")
def uphill() -> DrivingLog:
    return drive()


def changed(log: DrivingLog, **channels: Array) -> DrivingLog:
    return replace(log, channels={**log.channels, **channels})


def event(log: DrivingLog, seconds: float, **values: float) -> DrivingLog:
    """The log with other values from 10 s on for so long."""
    since = TIME - 10.0
    during = (since >= 0.0) & (since < seconds)
    return changed(log, **{key: np.where(during, v, log[key]) for key, v in values.items()})


def test_the_torque_is_found_again(uphill: DrivingLog) -> None:
    """Across three gears within 0.05 Nm: what is left is the filter's rounding."""
    assert len(set(uphill["gear"])) >= 3
    data = torque_samples(uphill, CAR)
    assert dict(data.units) == {"omega": "rad/s", "throttle": "-", "torque": "Nm"}
    assert data.output == "torque"
    np.testing.assert_allclose(data["torque"], torque_of(data["omega"]), atol=0.05)
    speed_alone = {key: v for key, v in uphill.channels.items() if key != "ax"}
    data = torque_samples(DrivingLog("drive", speed_alone), CAR)
    np.testing.assert_allclose(data["torque"], torque_of(data["omega"]), atol=1.0)


def test_noise_averages_out() -> None:
    """0.2 m/s^2 of white noise becomes 6 Nm after the filter; its mean stays within 1 Nm."""
    data = torque_samples(drive(noise=1.0), CAR)
    error = data["torque"] - torque_of(data["omega"])
    assert np.std(error) < 8.0
    assert abs(np.mean(error)) < 1.0


@pytest.mark.parametrize("what", ["grade", "engine_inertia", "wheel_inertia"])
def test_what_eq_6_leaves_out_counts(uphill: DrivingLog, what: str) -> None:
    """Without the grade or the rotating mass, the torque is wrong by more than its tolerance."""
    if what == "grade":
        log = changed(replace(uphill, accelerometer=False), grade=np.zeros(TIME.size))
        log = changed(log, ax=uphill["ax"] - g * np.sin(0.03))
        data = torque_samples(log, CAR)
    else:
        data = torque_samples(uphill, replace(CAR, **{what: 0.0}))
    assert np.abs(data["torque"] - torque_of(data["omega"])).max() > 2.0


def test_shifts_are_dropped_with_their_neighbours(uphill: DrivingLog) -> None:
    samples = TorqueRules().apply(uphill, CAR)
    shifts = np.count_nonzero(np.diff(uphill["gear"]))
    assert samples.dropped["shift"] == shifts * 31, "0.3 s on either side at 50 Hz"
    assert samples.dropped["ends"] == 20
    assert len(samples.dataset) == TIME.size - sum(samples.dropped.values())


@pytest.mark.parametrize(
    ("rule", "values", "seconds", "before", "after"),
    [
        ("shift", {"gear": 0.0}, 1.0, 0.3, 0.3),
        ("brake", {"brake": 1e6}, 1.0, 0.3, 0.3),
        ("transient", {"throttle": 0.5}, 2.0, 0.3, 0.5),
    ],
)
def test_each_rule_drops_its_samples(
    uphill: DrivingLog,
    rule: str,
    values: dict[str, float],
    seconds: float,
    before: float,
    after: float,
) -> None:
    """An event of so many seconds drops itself and what lies so far before and after it.

    Of a moved throttle only the moves count: 0.8 s for the first and 0.8 s for the second.
    """
    samples = TorqueRules().apply(event(uphill, seconds, **values), CAR)
    usual = TorqueRules().apply(uphill, CAR).dropped[rule]
    length = 2 * (before + after) if rule == "transient" else seconds + before + after
    assert samples.dropped[rule] - usual == pytest.approx(length / DT, abs=2)


def test_a_slipping_clutch_and_spinning_wheels_are_dropped(uphill: DrivingLog) -> None:
    during = (TIME >= 10.0) & (TIME < 11.0)
    for factor in (1.15, 0.85):
        log = changed(uphill, engine_speed=uphill["engine_speed"] * np.where(during, factor, 1.0))
        samples = TorqueRules().apply(log, CAR)
        extra = samples.dropped["clutch"] - TorqueRules().apply(uphill, CAR).dropped["clutch"]
        assert extra == pytest.approx(1.6 / DT, abs=6)


def test_slow_turning_and_other_throttles_are_dropped(uphill: DrivingLog) -> None:
    log = changed(uphill, yaw_rate=np.where(TIME > 20, 0.3, 0.0))
    assert TorqueRules().apply(log, CAR).dropped["cornering"] > 700
    assert "cornering" not in TorqueRules().apply(uphill, CAR).dropped
    log = changed(uphill, throttle=np.where(TIME > 20, 0.5, 0.2))
    data = torque_samples(log, CAR, throttle=0.5)
    assert set(data["throttle"]) == {0.5}
    fast = TorqueRules(min_speed=20.0).apply(uphill, CAR)
    assert fast.dropped["speed"] == pytest.approx(np.count_nonzero(uphill["vx"] < 20), abs=12)


def test_nothing_left_says_which_rule(uphill: DrivingLog) -> None:
    with pytest.raises(ValueError, match=r"no sample of 2001 is left; .*throttle \d+; loosen"):
        torque_samples(uphill, CAR, throttle=0.9)


def test_channels_that_must_be_there(uphill: DrivingLog) -> None:
    for channel in ("gear", "engine_speed", "throttle", "brake"):
        rest = {key: values for key, values in uphill.channels.items() if key != channel}
        with pytest.raises(ValueError, match=f"needs channel '{channel}'"):
            torque_samples(DrivingLog("drive", rest), CAR)


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"shift": 0.3}, "rules.shift is unknown; allowed are cutoff, min_speed"),
        ({"window": 0.0}, "rules.window is 0.0; expected a positive number"),
        ({"window": "long"}, "rules.window is 'long'; expected a positive number"),
        ({"max_slip": True}, "rules.max_slip is True"),
        ({"cutoff": np.nan}, "rules.cutoff is nan"),
    ],
)
def test_bad_rules(uphill: DrivingLog, rules: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        torque_samples(uphill, CAR, **rules)


@pytest.fixture
def file(tmp_path: Path, uphill: DrivingLog) -> Callable[[], Path]:
    def write() -> Path:
        path = tmp_path / "hill.csv"
        scale = {"engine_speed": 60 / (2 * np.pi), "throttle": 100.0}
        columns = {key: values * scale.get(key, 1.0) for key, values in uphill.channels.items()}
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        path.write_text("\n".join([",".join(columns), *(",".join(map(repr, r)) for r in rows)]))
        return path

    return write


def test_from_a_file(file: Callable[[], Path], uphill: DrivingLog) -> None:
    data = load_torque_samples(
        str(file()),
        ["time", "vx", "ax", "gear", "engine_speed", "throttle", "brake", "grade"],
        ["s", "m/s", "m/s^2", "-", "rpm", "%", "Pa", "rad"],
        {**SETTINGS, "lf": 1.7},
        throttle=0.2,
        rules={"window": 0.4},
    )
    expected = torque_samples(uphill, CAR, throttle=0.2, window=0.4)
    assert data.name == "hill_torque"
    np.testing.assert_allclose(data["torque"], expected["torque"], rtol=1e-9)


def test_wrong_units_and_openings_are_told(uphill: DrivingLog) -> None:
    with pytest.raises(
        ValueError, match=r"mostly 0.278 times the speed that vx, gear .* check their units"
    ):
        torque_samples(changed(uphill, vx=3.6 * uphill["vx"]), CAR)
    with pytest.raises(ValueError, match=r"throttle is 30; expected 0 to 1, for example 0.3"):
        torque_samples(uphill, CAR, throttle=30)
    opening = np.where(TIME < 25, 0.2, 0.35)
    with pytest.raises(ValueError, match=r"held longest: 0.2, 0.35"):
        torque_samples(changed(uphill, throttle=opening), CAR, throttle=0.6)
