"""Driving logs: what they take, units and signs at the edge, filters without phase shift."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import g
from scipy.signal import butter, sosfilt

from miho.data import CSVError
from miho.data.csv import TextFormat
from miho.vehicle.data import DrivingLog, load_driving_log
from miho.vehicle.data.driving_log import low_pass

TIME = np.arange(200) * 0.02


def make(accelerometer: bool = True, **channels: object) -> DrivingLog:
    return DrivingLog("run", {"time": TIME, "vx": TIME + 20, **channels}, accelerometer)


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    """Columns written to a CSV file under their names."""

    def write(**columns: object) -> Path:
        path = tmp_path / "run 1.csv"
        rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
        lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
        path.write_text("\n".join(lines))
        return path

    return write


def test_a_log_knows_its_channels() -> None:
    log = make()
    assert len(log) == 200
    assert log.dt == pytest.approx(0.02, rel=1e-12)
    assert "vx" in log and "vy" not in log
    with pytest.raises(ValueError, match="needs channel 'vy'; it has time, vx"):
        log["vy"]
    with pytest.raises(ValueError, match="read-only"):
        log["vx"][0] = 1


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ({"speed": TIME}, "channel 'speed' is unknown; known are time, vx"),
        ({"vy": np.full(200, np.nan)}, "'vy' must be one finite number per sample; got"),
        ({"vy": TIME[:-1]}, "expected `time` and all others to have the same number"),
        ({"time": TIME**2}, "but others are .* s; resample it"),
        ({"throttle": TIME + 40}, r"throttle reaches 43\.98; .*is its unit %\?"),
        ({"steering": 0 * TIME - 12}, r"steering reaches -12; .*is its unit deg"),
    ],
)
def test_bad_channels(channels: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(**channels)


def test_low_pass_shifts_nothing() -> None:
    """A sine far below the cutoff stays; the same filter run once delays it by 45 ms."""
    sine = np.sin(2 * np.pi * 1.0 * TIME)
    inner = slice(50, -50)
    assert np.abs(low_pass(sine, 0.02, 5.0) - sine)[inner].max() < 0.005
    once = sosfilt(butter(2, 5.0, fs=50, output="sos"), sine)
    delay = np.arctan(np.sqrt(2) * 0.2 / (1 - 0.04)) / (2 * np.pi)
    late = np.sin(2 * np.pi * (TIME - delay))
    assert np.abs(once - late)[inner].max() < 0.01, "the delay of a Butterworth filter"
    assert np.abs(once - sine)[inner].max() > 0.25


def test_low_pass_halves_at_the_cutoff_and_stops_above() -> None:
    for frequency, left in ((5.0, 0.5), (20.0, 0.0)):
        passed = low_pass(np.sin(2 * np.pi * frequency * TIME + 0.3), 0.02, 5.0)
        assert np.ptp(passed[50:-50]) / 2 == pytest.approx(left, abs=0.01)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 25.0, np.nan])
def test_impossible_cutoffs(cutoff: float) -> None:
    with pytest.raises(ValueError, match="expected above 0 and below 25 Hz"):
        low_pass(TIME, 0.02, cutoff)


def test_rates_are_in_phase() -> None:
    """Of a 0.5 Hz sine, by central differences: (1 - (w dt)^2 / 6) of the derivative."""
    log = make(yaw_rate=np.sin(np.pi * TIME))
    expected = np.pi * np.cos(np.pi * TIME)
    assert np.abs(log.rate("yaw_rate", 5.0) - expected)[50:-50].max() < 0.005


def test_accelerometers_feel_weight() -> None:
    """At a steady speed up a slope and around a bank, the motion has no acceleration."""
    level = np.zeros(200)
    felt = {"ax": level + g * np.sin(0.1), "ay": level - g * np.sin(0.3)}
    log = make(**felt, grade=level + 0.1, bank=level + 0.3)
    assert log.longitudinal_acceleration(5.0) == pytest.approx(0, abs=1e-9)
    assert log.lateral_acceleration(5.0) == pytest.approx(0, abs=1e-9)
    moving = make(accelerometer=False, ax=level + 1.0, grade=level + 0.1)
    assert moving.longitudinal_acceleration(5.0) == pytest.approx(1, abs=1e-9)


def test_accelerations_from_velocities() -> None:
    log = make(vy=0.5 * TIME, yaw_rate=0.2 + 0 * TIME)
    inner = log.away_from_ends(5.0)
    assert np.count_nonzero(~inner) == 20
    turning = 1.0 - 0.5 * TIME * 0.2
    assert log.longitudinal_acceleration(5.0)[inner] == pytest.approx(turning[inner], abs=1e-3)
    expected = 0.5 + (TIME + 20) * 0.2
    assert log.lateral_acceleration(5.0)[inner] == pytest.approx(expected[inner], abs=1e-3)


def test_a_steady_turn_has_the_same_acceleration_with_and_without_accelerometer() -> None:
    """vx 60 m/s, vy -2 m/s, r 0.3 rad/s: ax = -vy r and ay = vx r, though no speed changes."""
    level = np.zeros(200)
    speeds = {"vx": level + 60.0, "vy": level - 2.0, "yaw_rate": level + 0.3}
    for log in (make(**speeds), make(**speeds, ax=level + 0.6, ay=level + 18.0)):
        assert log.longitudinal_acceleration(5.0) == pytest.approx(0.6, abs=1e-9)
        assert log.lateral_acceleration(5.0) == pytest.approx(18.0, abs=1e-9)
    for missing in ("vy", "yaw_rate"):
        rest = {key: values for key, values in speeds.items() if key != missing}
        assert make(**rest).longitudinal_acceleration(5.0) == pytest.approx(0, abs=1e-9)


def test_inside_keeps_away_from_both_ends_of_a_phase() -> None:
    """1 / cutoff is 10 samples; a phase of 21 keeps its middle, one of 20 nothing."""
    phases = np.zeros(200, dtype=bool)
    phases[30:51] = phases[60:80] = phases[150:] = True
    kept = make().inside(phases, 5.0)
    assert np.flatnonzero(kept).tolist() == [40, *range(160, 190)]


def test_a_step_has_little_effect_one_over_the_cutoff_away() -> None:
    step = np.where(np.arange(1000) < 500, 0.0, 1.0)
    changed = np.abs(low_pass(step, 0.002, 5.0) - step)
    assert changed[:401].max() < 0.002 < changed[430]


def test_a_file_in_its_own_units(written: Callable[..., Path]) -> None:
    path = written(stamp=TIME + 1.7e9, kmh=72 + 0 * TIME, pedal=50 + 0 * TIME, wheel=-30 + 0 * TIME)
    log = load_driving_log(
        path,
        ["vx", "time", "throttle", "steering"],
        ["km/h", "s", "%", "deg"],
        ["kmh", "stamp", "pedal", "wheel"],
        flip=["steering"],
        steering_ratio=15.0,
    )
    assert log.name == "run_1"
    assert log["time"] == pytest.approx(TIME, abs=1e-6)
    assert log["vx"] == pytest.approx(20.0, rel=1e-12)
    assert log["throttle"] == pytest.approx(0.5, rel=1e-12)
    assert log["steering"] == pytest.approx(np.radians(2.0), rel=1e-12)


def test_jitter_is_resampled(written: Callable[..., Path]) -> None:
    time = TIME + np.random.default_rng(0).uniform(-0.004, 0.004, 200)
    time = np.delete(time, 77)
    gear = np.where(time < 2.0, 2, 3)
    path = written(time=time, vx=20 + np.sin(time), gear=gear)
    log = load_driving_log(path, ["time", "vx", "gear"], ["s", "m/s", "-"])
    assert np.ptp(np.diff(log["time"])) < 1e-12
    since = log["time"] + time[0]
    assert log["vx"] == pytest.approx(20 + np.sin(since), abs=2.5e-4), "linear: x'' h^2 / 8"
    assert set(log["gear"]) == {2.0, 3.0}
    assert since[np.argmax(log["gear"] == 3)] == pytest.approx(2.0, abs=0.04)


def test_delays_are_taken_back(written: Callable[..., Path]) -> None:
    path = written(
        time=TIME, yaw_rate=np.sin(TIME), steering=np.sin(TIME - 0.1), vx=20 + np.cos(TIME + 0.06)
    )
    log = load_driving_log(
        path,
        ["time", "yaw_rate", "steering", "vx"],
        ["s", "rad/s", "rad", "m/s"],
        delays={"steering": 0.1, "vx": -0.06},
    )
    assert log["time"][[0, -1]] == pytest.approx([0.06, TIME[-1] - 0.1], abs=1e-9)
    assert log["yaw_rate"] == pytest.approx(np.sin(log["time"]), abs=1e-12)
    assert log["steering"] == pytest.approx(np.sin(log["time"]), abs=1e-9)
    assert log["vx"] == pytest.approx(20 + np.cos(log["time"]), abs=1e-9)


def test_vy_is_moved_to_the_centre_of_gravity(written: Callable[..., Path]) -> None:
    path = written(time=TIME, vy=0.3 + 1.5 * 0.2 + 0 * TIME, yaw_rate=0.2 + 0 * TIME)
    columns, units = ["time", "vy", "yaw_rate"], ["s", "m/s", "rad/s"]
    log = load_driving_log(path, columns, units, sensor_x=1.5)
    assert log["vy"] == pytest.approx(0.3, rel=1e-12)
    with pytest.raises(ValueError, match="moving vy requires the channel 'yaw_rate'"):
        load_driving_log(path, columns[:2], units[:2], sensor_x=1.5)


def test_gaps_are_refused_and_can_be_cut(written: Callable[..., Path]) -> None:
    time = np.where(TIME > 1.99, TIME + 3.0, TIME)
    path = written(time=time, vx=20 + time)
    with pytest.raises(CSVError, match=r":102:1: no sample for 3\.02 s after 1\.98 s, .*or end"):
        load_driving_log(path, ["time", "vx"], ["s", "m/s"])
    first = load_driving_log(path, ["time", "vx"], ["s", "m/s"], end=2.0)
    second = load_driving_log(path, ["time", "vx"], ["s", "m/s"], start=4.0)
    assert (len(first), len(second)) == (100, 100)
    assert second["vx"][0] == pytest.approx(25.0)
    with pytest.raises(ValueError, match=r"start 6\.9 s and end None s leave 5 of 200"):
        load_driving_log(path, ["time", "vx"], ["s", "m/s"], start=6.9)


def test_time_goes_forward(written: Callable[..., Path]) -> None:
    time = TIME.copy()
    time[50] = time[49]
    with pytest.raises(CSVError, match=":52:1: time steps by 0 s; it must increase"):
        load_driving_log(written(time=time, vx=time), ["time", "vx"], ["s", "m/s"])


@pytest.mark.parametrize(
    ("columns", "units", "settings", "message"),
    [
        (["time", "vx"], ["s"], {}, "2 columns, 1 units and 2 headers"),
        (["time", "speed"], ["s", "m/s"], {}, "column 'speed' is unknown"),
        (["time", "vx"], ["s", "rad/s"], {}, "'vx' has unit 'rad/s'; expected one of m/s"),
        (["time", "vx"], ["s", "knots"], {}, "unit 'knots' is unknown"),
        (["vx"], ["m/s"], {}, "columns are vx; expected 'time' among them"),
        (["time", "vx", "vx"], ["s", "m/s", "m/s"], {}, "columns is .*; name each once"),
        ("time", ["s"], {}, "columns is 'time'; give a list of names"),
        (["time", "vx"], ["s", "m/s"], {"flip": ["vy"]}, "flip names 'vy'; columns are time, vx"),
        (["time", "vx"], ["s", "m/s"], {"flip": ["time"]}, "'time' cannot be flipped or delayed"),
        (["time", "vx"], ["s", "m/s"], {"delays": {"ax": 1}}, "delays names 'ax'; columns are"),
        (["time", "vx"], ["s", "m/s"], {"steering_ratio": 0.0}, "steering_ratio is 0.0"),
    ],
)
def test_bad_settings(
    written: Callable[..., Path],
    columns: list[str] | str,
    units: list[str],
    settings: dict[str, object],
    message: str,
) -> None:
    with pytest.raises(ValueError, match=message) as error:
        load_driving_log(written(time=TIME, vx=TIME), columns, units, **settings)
    assert "\n" not in str(error.value)


def test_a_log_of_central_europe(tmp_path: Path) -> None:
    """Settings of the text hold for logs too, and places are those of the whole file."""
    rows = [f"{i / 10:.1f};{20 + i};0,5".replace(".", ",") for i in range(20)]
    path = tmp_path / "log.csv"
    text = TextFormat(decimal="comma", skip_rows=1, drop_rows=[3], comment="%")
    head = ["Messung 4", "t;v;x", "s;m/s;-", "% start"]
    path.write_text("\n".join([*head, *rows]))
    log = load_driving_log(path, ["time", "vx"], ["s", "m/s"], ["t", "v"], text=text)
    np.testing.assert_allclose(log["vx"], 20.0 + np.arange(20))
    assert log.reading is not None
    assert [column[0] for column in log.reading.columns] == ["t", "v"]
    assert "separated by semicolons" in log.reading.notes
    path.write_text("\n".join([*head, *rows[:12], *rows[16:], "2,0;40;1"]))
    with pytest.raises(CSVError, match=r"log\.csv:17:1: no sample for 0\.5 s"):
        load_driving_log(path, ["time", "vx"], ["s", "m/s"], ["t", "v"], text=text)
