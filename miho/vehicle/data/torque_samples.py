"""Engine torque from a driving log: Eq. 6-7 with grade and rotating mass (Sec. III-B)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
import scipy  # loads its subpackages on first use: importing them takes a second
from numpy.typing import NDArray

from miho.data.csv import TextFormat
from miho.data.dataset import Dataset
from miho.quantities import Array
from miho.validate import positive
from miho.vehicle.data.driving_log import DrivingLog, load_driving_log
from miho.vehicle.models.longitudinal import Longitudinal
from miho.vehicle.models.vehicle_settings import from_settings

Mask = NDArray[np.bool_]

UNITS = {"omega": "rad/s", "throttle": "-", "torque": "Nm"}


class TorqueSamples(NamedTuple):
    """Samples of the torque, and the effect of each rule.

    Attributes
    ----------
    dataset : Dataset
        Samples that no rule drops.
    dropped : mapping of str to int
        Number of samples that each rule dropped. A sample counts for the first rule that drops it,
        in this order.
    """

    dataset: Dataset
    dropped: Mapping[str, int]


@dataclass(frozen=True, kw_only=True)
class TorqueRules:
    """Rules that select samples of a steady engine, in gear and with the brakes off.

    In this order, the rules drop

        ends        the first and last 1 / `cutoff` [s];
        speed       vx below `min_speed`;
        shift       no gear, or a change of gear within `window`;
        clutch      within `window`, engine speed that differs from the wheels' by more than the
                    fraction `max_slip`: the clutch slips or the tires spin;
        brake       within `window`, brake pressure above `max_brake`;
        transient   throttle that moved by more than `tolerance` in the last `settle` or will within
                    `window`: a turbocharged engine responds slowly;
        cornering   |v_x r| above `max_lateral`, because steered wheels drag; only if the log has
                    yaw_rate;
        throttle    throttle that differs by more than `tolerance` from the requested one, if any.

    Parameters
    ----------
    cutoff : float
        Cutoff of the low pass [Hz].
    min_speed : float
        Smallest speed [m/s].
    window : float
        Time around an event [s]. It should cover 1 / cutoff, because filters spread the effects of
        a shift over its neighbours.
    settle : float
        Time after a change of the throttle [s].
    tolerance : float
        Largest change of the throttle [-].
    max_slip : float
        Largest relative difference of engine and wheel speed [-].
    max_brake : float
        Largest brake pressure [Pa].
    max_lateral : float
        Largest lateral acceleration [m/s^2].

    Raises
    ------
    ValueError
        If a setting is not positive.
    """

    cutoff: float = 5.0
    min_speed: float = 10.0
    window: float = 0.3
    settle: float = 0.5
    tolerance: float = 0.02
    max_slip: float = 0.05
    max_brake: float = 5e4
    max_lateral: float = 3.0

    def __post_init__(self) -> None:
        for field in fields(self):
            positive(f"rules.{field.name}", getattr(self, field.name))

    def apply(
        self, log: DrivingLog, car: Longitudinal, throttle: float | None = None
    ) -> TorqueSamples:
        """Torque of the engine in the samples that no rule drops.

        The torque follows from ax (if it is not logged, `longitudinal_acceleration` uses the
        speeds), vx, gear and grade.

        Parameters
        ----------
        log : DrivingLog
            A log with the channels vx, gear, engine_speed, throttle and brake.
        car : Longitudinal
            The car.
        throttle : float, optional
            Opening [0, 1] of the samples to use; by default all.

        Returns
        -------
        TorqueSamples
            Columns omega [rad/s], throttle [-] and the output torque [Nm], and the dropped samples.

        Raises
        ------
        ValueError
            If no sample is left, with the counts of each rule.
        """
        if throttle is not None and not 0 <= throttle <= 1:
            raise ValueError(f"throttle is {throttle!r}; expected 0 to 1, for example 0.3 for 30 %")

        # Masks (N,) of the samples that each rule drops.
        vx, omega = (log.filtered(channel, self.cutoff) for channel in ("vx", "engine_speed"))
        pedal, gear = log["throttle"], log["gear"]
        engaged = np.isin(gear, np.arange(1, len(car.gear_ratios) + 1))
        gear = np.where(engaged, gear, 1.0)
        shift = ~engaged
        shift[1:] |= log["gear"][1:] != log["gear"][:-1]
        slip = np.abs(omega - car.engine_speed(vx, gear)) > self.max_slip * np.abs(omega)
        rules = {
            "ends": ~log.away_from_ends(self.cutoff),
            "speed": vx < self.min_speed,
            "shift": self._nearby(shift, log.dt),
            "clutch": self._nearby(slip & engaged, log.dt),
            "brake": self._nearby(log["brake"] > self.max_brake, log.dt),
            "transient": self._swing(pedal, log.dt) > self.tolerance,
        }
        if "yaw_rate" in log:
            turning = np.abs(vx * log.filtered("yaw_rate", self.cutoff))
            rules["cornering"] = turning > self.max_lateral
        if throttle is not None:
            rules["throttle"] = np.abs(pedal - throttle) > self.tolerance
        # Each rule counts among the samples that earlier rules kept.
        remaining = np.ones(len(log), dtype=bool)
        dropped = {}
        for rule, drops in rules.items():
            dropped[rule] = int(np.count_nonzero(remaining & drops))
            remaining &= ~drops
        if not remaining.any():
            moving = engaged & (vx > self.min_speed)
            ratios = omega[moving] / car.engine_speed(vx, gear)[moving]
            steady_pedal = pedal[~rules["transient"]]
            raise ValueError(self._nothing_left(log, dropped, ratios, steady_pedal))

        ax, grade = log.longitudinal_acceleration(self.cutoff), log.angle("grade", self.cutoff)
        torque = car.engine_torque(ax, vx, gear, grade)
        columns = {"omega": omega, "throttle": pedal, "torque": torque}
        samples = {name: values[remaining] for name, values in columns.items()}
        return TorqueSamples(Dataset(f"{log.name}_torque", samples, UNITS, "torque"), dropped)

    def _nothing_left(
        self, log: DrivingLog, dropped: Mapping[str, int], ratios: Array, steady_pedal: Array
    ) -> str:
        """A message with the likely cause: inconsistent speeds, or the wrong opening.

        `ratios` are engine speeds divided by the speeds that vx and gear imply, while the car
        moves.
        """
        counts = ", ".join(f"{rule} {count}" for rule, count in dropped.items() if count)
        message = f"log {log.name}: no sample of {len(log)} is left; dropped by {counts}"
        ratio = float(np.median(ratios)) if ratios.size else 1.0
        if abs(ratio - 1) > self.max_slip:
            return (
                f"{message}; engine_speed is mostly {ratio:.3g} times the speed that vx, gear "
                "and the vehicle give: check their units and the gear ratios"
            )
        if dropped.get("throttle") and np.ptp(log["throttle"]) > 0:
            openings, durations = np.unique(np.round(100 * steady_pedal), return_counts=True)
            longest = openings[np.argsort(durations)[::-1][:5]]
            message += f"; openings held longest: {', '.join(f'{v / 100:g}' for v in longest)}"
        return f"{message}; loosen the rule that drops too many"

    def _nearby(self, events: Mask, dt: float) -> Mask:
        """True within `window` of an event."""
        around = np.ones(2 * round(self.window / dt) + 1, dtype=bool)
        return np.asarray(scipy.ndimage.binary_dilation(events, around))

    def _swing(self, pedal: Array, dt: float) -> Array:
        """Range of the values from `settle` ago to `window` ahead."""
        before, after = round(self.settle / dt), round(self.window / dt)
        size = before + after + 1
        origin = before - size // 2
        high, low = (
            extreme(pedal, size, origin=origin, mode="nearest")
            for extreme in (scipy.ndimage.maximum_filter1d, scipy.ndimage.minimum_filter1d)
        )
        return np.asarray(high - low)


def torque_samples(
    log: DrivingLog, car: Longitudinal, throttle: float | None = None, **rules: float
) -> Dataset:
    """The dataset of `TorqueRules.apply`; `rules` are fields of `TorqueRules`."""
    return _rules(rules).apply(log, car, throttle).dataset


def load_torque_samples(
    path: str,
    columns: Sequence[str],
    units: Sequence[str],
    vehicle: Mapping[str, object],
    headers: Sequence[str] | None = None,
    flip: Sequence[str] = (),
    delays: Mapping[str, float] | None = None,
    accelerometer: bool = True,
    start: float = 0.0,
    end: float | None = None,
    throttle: float | None = None,
    rules: Mapping[str, float] | None = None,
    every: int = 1,
    delimiter: str | None = None,
    decimal: str = "point",
    skip_rows: int = 0,
    drop_rows: Sequence[int] = (),
    comment: str | None = None,
) -> Dataset:
    """Load `torque_samples` from a driving log in a CSV file.

    Parameters
    ----------
    path, columns, units
        See `load_driving_log`.
    vehicle : mapping of str to object
        Fields of `Longitudinal`.
    headers, flip, delays, accelerometer, start, end
        See `load_driving_log`.
    throttle : float, optional
        Opening [0, 1] of the samples to use; by default all.
    rules : mapping of str to float, optional
        Fields of `TorqueRules`.
    every : int
        Keep the first of every `every` samples.
    delimiter, decimal, skip_rows, drop_rows, comment
        See `miho.data.csv.TextFormat`.

    Returns
    -------
    Dataset
        The samples that `TorqueRules` selects.

    Raises
    ------
    CSVError
        For a fault in the file, including gaps and times that do not increase.
    ValueError
        For an invalid setting, or if no sample is left.
    """
    car, chosen = from_settings(Longitudinal, vehicle), _rules(rules or {})
    log = load_driving_log(
        path, columns, units, headers, flip=flip, delays=delays, accelerometer=accelerometer,
        start=start, end=end,
        text=TextFormat(delimiter, decimal, skip_rows, drop_rows, comment),
    )  # fmt: skip
    samples = chosen.apply(log, car, throttle).dataset
    return replace(samples.thinned(every), reading=log.reading)


def _rules(settings: Mapping[str, float]) -> TorqueRules:
    allowed = [field.name for field in fields(TorqueRules)]
    for name in settings:
        if name not in allowed:
            raise ValueError(f"rules.{name} is unknown; allowed are {', '.join(allowed)}")
    return TorqueRules(**settings)
