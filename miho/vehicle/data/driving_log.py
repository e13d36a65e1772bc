"""A driving log: named channels on a common clock, filtered without phase shift."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import scipy  # loads its subpackages on first use: importing them takes a second
from numpy.typing import NDArray

from miho.data.csv import PLAIN, TextFormat, TextTable
from miho.data.dataset import file_name
from miho.data.measurements import check_columns, check_names
from miho.data.preview import Reading
from miho.data.text_lines import CSVError
from miho.quantities import Array, g
from miho.units import si
from miho.validate import positive

Mask = NDArray[np.bool_]

CHANNELS = MappingProxyType(
    {
        "time": "s", "vx": "m/s", "vy": "m/s", "yaw_rate": "rad/s", "ax": "m/s^2", "ay": "m/s^2",
        "steering": "rad", "gear": "-", "engine_speed": "rad/s", "throttle": "-", "brake": "Pa",
        "bank": "rad", "grade": "rad",
    }
)  # fmt: skip
"""Channels that a log may contain, and their SI units; for signs see `DrivingLog`."""

JITTER = 0.01
"""Time steps within this fraction of their median count as uniform."""
MAX_STEP = 2.5
"""A time step of more than this many medians is a gap."""
SHORTEST = 10
"""Smallest number of samples in a log."""

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
"""Smallest and largest value of a channel in any car, in SI units, and the likely cause of a value
outside this range."""


@dataclass(frozen=True, eq=False)
class DrivingLog:
    """Uniformly sampled channels (N,) in SI units and radians.

    Parameters
    ----------
    name : str
        Name of the log.
    channels : mapping of str to array_like
        Channels of `CHANNELS`; only `time` is required. vx, vy [m/s] and ax, ay [m/s^2] are along
        the car's axes at its centre of gravity, x forward and y to the left. yaw_rate [rad/s] and
        steering, the mean angle of the front wheels [rad], are positive to the left. gear counts
        from 1; 0 is neutral. engine_speed is in rad/s, throttle from 0 to 1, brake is a pressure
        [Pa]. grade [rad] is positive uphill. bank [rad] is positive if the left side is lower, as
        in turns of a left-hand oval; a roll angle of ISO 8855 has the opposite sign.
    accelerometer : bool
        Whether ax and ay are readings of a sensor fixed to the car, which include the support
        against weight on a grade or bank, or accelerations of the motion (False).
    reading : Reading, optional
        Description of the source file.

    Raises
    ------
    ValueError
        If a channel is unknown, not finite or implausible, or if time steps are not uniform.
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
                f"{channels['time'][worst]:.6g} s, but others are {step:.6g} s; resample it"
            )
        # A value that no car reaches has another unit.
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
        """A channel after `low_pass`, in its unit."""
        return low_pass(self[channel], self.dt, cutoff)

    def rate(self, channel: str, cutoff: float) -> Array:
        """Time derivative of a channel: central differences of `filtered`."""
        return np.asarray(np.gradient(self.filtered(channel, cutoff), self.dt))

    def longitudinal_acceleration(self, cutoff: float) -> Array:
        """Filtered acceleration of the motion along x [m/s^2], from ax, else v_x' - v_y r.

        A log without ax that also lacks vy or yaw_rate is assumed to drive straight: v_x' alone.
        """
        if "ax" not in self:
            rate = self.rate("vx", cutoff)
            if "vy" not in self or "yaw_rate" not in self:
                return rate
            return rate - self.filtered("vy", cutoff) * self.filtered("yaw_rate", cutoff)
        weight = self._weight("grade", cutoff) if self.accelerometer else 0.0
        return self.filtered("ax", cutoff) - weight

    def lateral_acceleration(self, cutoff: float) -> Array:
        """Filtered acceleration of the motion along y [m/s^2], from ay, else v_y' + v_x r."""
        if "ay" not in self:
            turning = self.filtered("vx", cutoff) * self.filtered("yaw_rate", cutoff)
            return self.rate("vy", cutoff) + turning
        weight = self._weight("bank", cutoff) if self.accelerometer else 0.0
        return self.filtered("ay", cutoff) + weight

    def angle(self, channel: str, cutoff: float) -> Array:
        """Filtered bank or grade [rad]; zero if it is not logged."""
        return self.filtered(channel, cutoff) if channel in self else np.zeros(len(self))

    def _weight(self, channel: str, cutoff: float) -> Array:
        return np.asarray(g * np.sin(self.angle(channel, cutoff)))

    def away_from_ends(self, cutoff: float) -> Mask:
        """Mask (N,) of samples at least 1 / cutoff [s] from both ends of the log."""
        return self.inside(np.ones(len(self), dtype=bool), cutoff)

    def inside(self, phases: Mask, cutoff: float) -> Mask:
        """Mask (N,) of samples in the phases (N,) at least 1 / cutoff [s] away from their ends.

        A step at that distance changes the output of `low_pass` by about 0.2 % of its height.
        """
        around = np.ones(2 * round(1 / (cutoff * self.dt)) + 1, dtype=bool)
        return np.asarray(scipy.ndimage.binary_erosion(phases, around))


def low_pass(values: Array, dt: float, cutoff: float) -> Array:
    """Low-pass filter without delay for values (N,) sampled every dt [s].

    A Butterworth filter of second order runs forward and backward, so that the phase is unchanged
    and half the amplitude (-6 dB) remains at the cutoff [Hz]. It needs the whole log, so it is not
    suitable for control.
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
    """Load a log from a CSV file with a header line; time counts from the file's first row.

    Channels are interpolated to uniform steps of the median, unless all steps are within 1 % of it;
    the gear takes its nearest value. Steps of more than 2.5 medians are gaps without measurements
    and are refused.

    Parameters
    ----------
    path : path
        The file.
    columns : sequence of str
        Channels of `CHANNELS`.
    units : sequence of str
        Units of the channels in the file, in the same order.
    headers : sequence of str, optional
        Names of the channels in the file, in the same order.
    flip : sequence of str
        Channels with a sign opposite to `DrivingLog`.
    delays : mapping of str to float, optional
        Delay of channels relative to the others [s]; negative if early.
    steering_ratio : float
        Divides the steering angle, if it is measured at the hand wheel.
    sensor_x : float
        Distance of the vy sensor ahead of the centre of gravity [m]; requires yaw_rate.
    accelerometer : bool
        See `DrivingLog`.
    start, end : float
        Part of the file to use [s].
    text : TextFormat
        Format of the file.

    Returns
    -------
    DrivingLog
        The log.

    Raises
    ------
    CSVError
        For a fault in the file, including gaps and times that do not increase.
    ValueError
        For an invalid setting.
    """
    headers = list(columns) if headers is None else headers
    delays = delays or {}
    _check_channels(columns, units, headers, flip, delays)
    positive("steering_ratio", steering_ratio)

    # Convert the file's numbers to SI units and our signs.
    table = TextTable(Path(path), headers, header=True, text=text)
    numbers = table.numbers()
    reading = Reading.of(os.fspath(path), numbers, units, table.notes)
    channels = {
        channel: numbers[header] * si(unit).factor * (-1.0 if channel in flip else 1.0)
        for channel, unit, header in zip(columns, units, headers, strict=True)
    }
    time = channels["time"] = channels["time"] - channels["time"][0]

    # Select the rows from start to end and refuse gaps.
    chosen = (time >= start) & (time <= (np.inf if end is None else end))
    if np.count_nonzero(chosen) < SHORTEST:
        raise ValueError(
            f"start {start:g} s and end {end} s leave {np.count_nonzero(chosen)} of {time.size} "
            f"samples, which last {time[-1]:g} s; expected at least {SHORTEST}"
        )
    channels = {key: values[chosen] for key, values in channels.items()}
    lines = np.array(table.line_numbers[table.first :])[chosen]
    _refuse_gaps(Path(path), channels["time"], lines)

    # Refer all channels to the same times, the road wheels and the centre of gravity.
    if "steering" in channels:
        channels["steering"] = channels["steering"] / steering_ratio
    channels = _resampled(channels, delays)
    if sensor_x and "vy" in channels:
        if "yaw_rate" not in channels:
            raise ValueError(f"sensor_x is {sensor_x}; moving vy requires the channel 'yaw_rate'")
        channels["vy"] = channels["vy"] - sensor_x * channels["yaw_rate"]
    return DrivingLog(file_name(path), channels, accelerometer, reading)


def _check_channels(
    columns: Sequence[str],
    units: Sequence[str],
    headers: Sequence[str],
    flip: Sequence[str],
    delays: Mapping[str, float],
) -> None:
    """Refuse unknown channels, wrong units and a missing time."""
    check_columns(columns, units, headers, flip)
    check_names("delays", delays, columns)
    for channel, unit in zip(columns, units, strict=True):
        if channel not in CHANNELS:
            raise ValueError(f"column {channel!r} is unknown; known are {', '.join(CHANNELS)}")
        if si(unit).name != CHANNELS[channel]:
            raise ValueError(
                f"column {channel!r} has unit {unit!r}; expected one of {CHANNELS[channel]}"
            )
    if "time" not in columns:
        raise ValueError(f"columns are {', '.join(columns)}; expected 'time' among them")
    if "time" in {*flip, *delays}:
        raise ValueError("flip and delays: 'time' cannot be flipped or delayed; leave it out")


def _refuse_gaps(path: Path, time: Array, lines: NDArray[np.intp]) -> None:
    """Refuse times (N,) that decrease or have gaps; `lines` (N,) are their lines in the file."""
    steps = np.diff(time)
    step = float(np.median(steps))
    back, gaps = np.flatnonzero(steps <= 0), np.flatnonzero(steps > MAX_STEP * step)
    if back.size:
        problem = f"time steps by {steps[back[0]]:g} s; it must increase, remove the row"
        raise CSVError(path, int(lines[back[0] + 1]), 1, problem)
    if gaps.size:
        problem = (
            f"no sample for {steps[gaps[0]]:.3g} s after {time[gaps[0]]:.6g} s, but others are "
            f"{step:.3g} s apart; choose one side with start or end"
        )
        raise CSVError(path, int(lines[gaps[0] + 1]), 1, problem)


def _resampled(channels: Mapping[str, Array], delays: Mapping[str, float]) -> dict[str, Array]:
    """Channels at uniform times with their delays removed; times that a channel lacks are cut."""
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
