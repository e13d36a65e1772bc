"""A driving log: named channels on one clock, filtered without phase shift."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second
from numpy.typing import NDArray

from miho.data.csv import PLAIN, CSVError, TextFormat, TextTable
from miho.data.dataset import file_name
from miho.data.preview import Reading
from miho.data.units import si
from miho.quantities import Array, g
from miho.validate import positive

Mask = NDArray[np.bool_]

CHANNELS = MappingProxyType(
    {
        "time": "s", "vx": "m/s", "vy": "m/s", "yaw_rate": "rad/s", "ax": "m/s^2", "ay": "m/s^2",
        "steering": "rad", "gear": "-", "engine_speed": "rad/s", "throttle": "-", "brake": "Pa",
        "bank": "rad", "grade": "rad",
    }
)  # fmt: skip
"""The channels a log may have, and their SI units; signs as in `DrivingLog`."""

JITTER = 0.01
"""Time steps within this fraction of their median count as uniform."""
MAX_STEP = 2.5
"""A time step of more medians than this is a gap."""
SHORTEST = 10
"""Samples that a log has at least."""

PLAUSIBLE = (
    ("throttle", -0.05, 1.05, "is its unit %?"),
    ("steering", -1.2, 1.2, "is its unit deg, or is it the hand wheel's?"),
    ("bank", -0.8, 0.8, "is its unit deg?"),
    ("grade", -0.5, 0.5, "is its unit deg or %?"),
    ("yaw_rate", -10.0, 10.0, "is its unit deg/s?"),
    ("vx", -150.0, 150.0, "is its unit km/h?"),
    ("vy", -100.0, 100.0, "is its unit km/h?"),
    ("ax", -100.0, 100.0, "is its unit wrong?"),
    ("ay", -100.0, 100.0, "is its unit wrong?"),
)
"""Channels with their smallest and largest value in any car, in SI units, and what a value beyond
suggests."""


@dataclass(frozen=True, eq=False)
class DrivingLog:
    """Channels (N,) in SI units and radians, sampled uniformly; only `time` must be there.

    vx, vy [m/s], ax, ay [m/s^2] along the car's axes at its centre of gravity, x forward and y to
    the left; yaw_rate [rad/s] and steering, the mean angle of the front wheels [rad], positive to
    the left; gear from 1, 0 for neutral; engine_speed [rad/s]; throttle from 0 to 1; brake
    pressure [Pa]; grade [rad], positive uphill; bank [rad], positive when the left side is lower,
    as in a left-hand oval's turns: a roll angle of ISO 8855 has the opposite sign.

    `accelerometer` says what ax and ay are: what a sensor fixed to the car shows, which feels the
    support against weight on a grade or bank (True), or the acceleration of the motion (False).
    `reading` describes the file that the log is from.
    """

    name: str
    channels: Mapping[str, Array]
    accelerometer: bool = True
    reading: Reading | None = None

    def __post_init__(self) -> None:
        # Channels become read-only copies, finite and of one length, on a uniform clock.
        channels = {}
        for key, values in self.channels.items():
            if key not in CHANNELS:
                raise ValueError(
                    f"log {self.name}: channel {key!r} is unknown; known are {', '.join(CHANNELS)}"
                )
            channel = np.array(values, dtype=float)
            if channel.ndim != 1 or not np.isfinite(channel).all():
                raise ValueError(
                    f"log {self.name}: channel {key!r} must be one finite number per sample; got "
                    f"shape {channel.shape} with {np.count_nonzero(~np.isfinite(channel))} not "
                    "finite"
                )
            channel.flags.writeable = False
            channels[key] = channel
        lengths = {key: channel.size for key, channel in channels.items()}
        if len(set(lengths.values())) != 1 or lengths.get("time", 0) < SHORTEST:
            raise ValueError(
                f"log {self.name}: channels have {lengths} samples; expected `time` and all others "
                f"to have the same number, at least {SHORTEST}"
            )
        steps = np.diff(channels["time"])
        step = float(np.median(steps))
        if not (np.abs(steps - step) <= JITTER * step).all():
            worst = int(np.argmax(np.abs(steps - step)))
            raise ValueError(
                f"log {self.name}: time steps {steps[worst]:.6g} s after "
                f"{channels['time'][worst]:.6g} s where others are {step:.6g} s; resample it"
            )
        # A value that no car reaches is in another unit.
        for key, low, high, hint in PLAUSIBLE:
            if key in channels and not ((channels[key] >= low) & (channels[key] <= high)).all():
                worst = int(np.argmax(np.abs(channels[key])))
                raise ValueError(
                    f"log {self.name}: {key} reaches {channels[key][worst]:.4g}; expected "
                    f"{low} to {high} {CHANNELS[key]}; {hint}"
                )
        object.__setattr__(self, "channels", channels)

    def __len__(self) -> int:
        return self.channels["time"].size

    def __contains__(self, channel: str) -> bool:
        return channel in self.channels

    def __getitem__(self, channel: str) -> Array:
        """The channel of that name, (N,)."""
        try:
            return self.channels[channel]
        except KeyError:
            raise ValueError(
                f"log {self.name}: needs channel {channel!r}; it has {', '.join(self.channels)}"
            ) from None

    @property
    def dt(self) -> float:
        """Sampling step [s]."""
        time = self.channels["time"]
        return float((time[-1] - time[0]) / (time.size - 1))

    def filtered(self, channel: str, cutoff: float) -> Array:
        """A channel after `low_pass`, in its own unit."""
        return low_pass(self[channel], self.dt, cutoff)

    def rate(self, channel: str, cutoff: float) -> Array:
        """The derivative of a channel, per second: central differences of `filtered`."""
        return np.asarray(np.gradient(self.filtered(channel, cutoff), self.dt))

    def longitudinal_acceleration(self, cutoff: float) -> Array:
        """Acceleration of the motion along x [m/s^2], filtered: from ax, else v_x' - v_y r.

        Without ax, a log that lacks vy or yaw_rate is taken to drive straight: v_x' alone.
        """
        if "ax" not in self:
            rate = self.rate("vx", cutoff)
            if "vy" not in self or "yaw_rate" not in self:
                return rate
            return rate - self.filtered("vy", cutoff) * self.filtered("yaw_rate", cutoff)
        weight = self._weight("grade", cutoff) if self.accelerometer else 0.0
        return self.filtered("ax", cutoff) - weight

    def lateral_acceleration(self, cutoff: float) -> Array:
        """Acceleration of the motion along y [m/s^2], filtered: from ay, else v_y' + v_x r."""
        if "ay" not in self:
            turning = self.filtered("vx", cutoff) * self.filtered("yaw_rate", cutoff)
            return self.rate("vy", cutoff) + turning
        weight = self._weight("bank", cutoff) if self.accelerometer else 0.0
        return self.filtered("ay", cutoff) + weight

    def angle(self, channel: str, cutoff: float) -> Array:
        """Bank or grade [rad], filtered; level where the log does not say."""
        return self.filtered(channel, cutoff) if channel in self else np.zeros(len(self))

    def _weight(self, channel: str, cutoff: float) -> Array:
        return np.asarray(g * np.sin(self.angle(channel, cutoff)))

    def away_from_ends(self, cutoff: float) -> Mask:
        """Mask (N,) of samples at least 1 / cutoff [s] from both ends of the log."""
        return self.inside(np.ones(len(self), dtype=bool), cutoff)

    def inside(self, phases: Mask, cutoff: float) -> Mask:
        """Mask (N,) of samples in the phases (N,) at least 1 / cutoff [s] away from their ends.

        A step one such time away changes what `low_pass` gives by some 0.2 % of its height.
        """
        around = np.ones(2 * round(1 / (cutoff * self.dt)) + 1, dtype=bool)
        return np.asarray(scipy.ndimage.binary_erosion(phases, around))


def low_pass(values: Array, dt: float, cutoff: float) -> Array:
    """Values (N,) sampled every dt [s] without what lies above the cutoff [Hz], nothing delayed.

    A Butterworth filter of second order runs forward and backward, so that the phase stays and
    half the amplitude (-6 dB) is left at the cutoff. It needs the whole log: not for control.
    """
    if not 0 < cutoff < 0.5 / dt:
        raise ValueError(
            f"cutoff is {cutoff:g} Hz; expected above 0 and below {0.5 / dt:g} Hz, half the "
            "sampling rate"
        )
    sections = scipy.signal.butter(2, cutoff, fs=1 / dt, output="sos")
    return np.asarray(scipy.signal.sosfiltfilt(sections, values))


def load_driving_log(
    path: str | os.PathLike[str],
    columns: Sequence[str],
    units: Sequence[str],
    headers: Sequence[str] | None = None,
    *,
    flip: Sequence[str] = (),
    delays: Mapping[str, float] | None = None,
    steering_ratio: float = 1.0,
    sensor_x: float = 0.0,
    accelerometer: bool = True,
    start: float = 0.0,
    end: float | None = None,
    text: TextFormat = PLAIN,
) -> DrivingLog:
    """A log from a CSV file with a header line; the time counts from the file's first row.

    `columns` names channels of `CHANNELS`, `units` theirs in the file and `headers` the file's own
    names, in the same order. `flip` names channels whose sign is opposite to that of `DrivingLog`.
    `delays` maps channels to how late they are [s] against the others (negative: early).
    `steering_ratio` divides the steering angle, if it is the hand wheel's. `sensor_x` says how far
    ahead of the centre of gravity vy was measured [m]; yaw_rate must be there then. `start` and
    `end` [s] cut the file. `text` says how it is written.

    Steps within 1 % of their median stay as they are; otherwise the channels are interpolated to
    steps of the median (the gear takes its nearest value). Steps of more than 2.5 medians are
    gaps, which are refused: nothing was measured there.
    """
    headers = list(columns) if headers is None else headers
    delays = delays or {}
    _check_channels(columns, units, headers, flip, delays)
    positive("steering_ratio", steering_ratio)

    # The file's numbers in SI units and our signs, over the time since its first row.
    table = TextTable(Path(path), headers, header=True, text=text)
    numbers = table.numbers()
    reading = Reading.of(os.fspath(path), numbers, units, table.notes)
    channels = {
        channel: numbers[header] * si(unit).factor * (-1.0 if channel in flip else 1.0)
        for channel, unit, header in zip(columns, units, headers, strict=True)
    }
    time = channels["time"] = channels["time"] - channels["time"][0]

    # The rows from start to end, among which there is no gap.
    chosen = (time >= start) & (time <= (np.inf if end is None else end))
    if np.count_nonzero(chosen) < SHORTEST:
        raise ValueError(
            f"start {start:g} s and end {end} s leave {np.count_nonzero(chosen)} of {time.size} "
            f"samples, which last {time[-1]:g} s; expected at least {SHORTEST}"
        )
    channels = {key: values[chosen] for key, values in channels.items()}
    lines = np.array(table.line_numbers[table.first :])[chosen]
    _refuse_gaps(Path(path), channels["time"], lines)

    # All channels at the same instants, of the road wheels and of the centre of gravity.
    if "steering" in channels:
        channels["steering"] = channels["steering"] / steering_ratio
    channels = _resampled(channels, delays)
    if sensor_x and "vy" in channels:
        if "yaw_rate" not in channels:
            raise ValueError(f"sensor_x is {sensor_x}; to move vy it needs the channel 'yaw_rate'")
        channels["vy"] = channels["vy"] - sensor_x * channels["yaw_rate"]
    return DrivingLog(file_name(path), channels, accelerometer, reading)


def _check_channels(
    columns: Sequence[str],
    units: Sequence[str],
    headers: Sequence[str],
    flip: Sequence[str],
    delays: Mapping[str, float],
) -> None:
    """Refuse channels that there are not, units that are not theirs, and no time."""
    if not len(columns) == len(units) == len(headers):
        raise ValueError(
            f"{len(columns)} columns, {len(units)} units and {len(headers)} headers; give one unit "
            "and one header a column"
        )
    for channel, unit in zip(columns, units, strict=True):
        if channel not in CHANNELS:
            raise ValueError(f"column {channel!r} is unknown; known are {', '.join(CHANNELS)}")
        if si(unit).name != CHANNELS[channel]:
            raise ValueError(
                f"column {channel!r} has unit {unit!r}; expected one of {CHANNELS[channel]}"
            )
    for setting, channels in (("flip", flip), ("delays", delays)):
        for channel in channels:
            if channel not in columns or channel == "time":
                raise ValueError(f"{setting}: {channel!r} is not one of the channels read")
    if "time" not in columns or len(set(columns)) != len(columns):
        raise ValueError(f"columns are {', '.join(columns)}; expected 'time' and none twice")


def _refuse_gaps(path: Path, time: Array, lines: NDArray[np.intp]) -> None:
    """Refuse times (N,) that go back or leave a gap; `lines` (N,) are their lines in the file."""
    steps = np.diff(time)
    step = float(np.median(steps))
    back, gaps = np.flatnonzero(steps <= 0), np.flatnonzero(steps > MAX_STEP * step)
    if back.size:
        problem = f"time steps by {steps[back[0]]:g} s; it must increase, remove the row"
        raise CSVError(path, int(lines[back[0] + 1]), 1, problem)
    if gaps.size:
        problem = (
            f"nothing for {steps[gaps[0]]:.3g} s after {time[gaps[0]]:.6g} s, where others are "
            f"{step:.3g} s apart; choose one side with start or end"
        )
        raise CSVError(path, int(lines[gaps[0] + 1]), 1, problem)


def _resampled(channels: Mapping[str, Array], delays: Mapping[str, float]) -> dict[str, Array]:
    """Channels at uniform times, each moved back by its delay; ends that one lacks are cut."""
    time = channels["time"]
    steps = np.diff(time)
    step = float(np.median(steps))
    uniform = bool((np.abs(steps - step) <= JITTER * step).all())
    if uniform and not any(delays.values()):
        return dict(channels)
    first = time[0] - min([0.0, *delays.values()])
    last = time[-1] - max([0.0, *delays.values()])
    if uniform:
        grid = time[(time >= first) & (time <= last)]
    else:
        grid = first + step * np.arange(int((last - first) / step) + 1)
    moved = {"time": grid}
    for key, values in channels.items():
        if key == "gear":
            nearest = np.searchsorted((time[1:] + time[:-1]) / 2, grid + delays.get(key, 0.0))
            moved[key] = values[nearest]
        elif key != "time":
            moved[key] = np.interp(grid + delays.get(key, 0.0), time, values)
    return moved
