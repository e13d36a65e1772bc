"""Data of vehicles: logs, tire and engine tests, synthetic drives and the embedded tires."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.vehicle.data.axle_samples import load_axle_samples
    from miho.vehicle.data.braking_samples import load_braking_samples
    from miho.vehicle.data.driving_log import CHANNELS, DrivingLog, load_driving_log
    from miho.vehicle.data.seong import DataUnavailableError, load_seong_sample
    from miho.vehicle.data.synthetic_brake import (
        brake_deceleration_test,
        brake_play_test,
        brake_pressure_test,
        brake_step_test,
        brake_torque_test,
    )
    from miho.vehicle.data.synthetic_drive import tire_drive
    from miho.vehicle.data.synthetic_engine import dyno_test, engine_driving_log, load_engine_drive
    from miho.vehicle.data.synthetic_handling import (
        simulated_axle_drive,
        simulated_weave,
        steering_test,
    )
    from miho.vehicle.data.synthetic_outliers import tire_outlier_test
    from miho.vehicle.data.tir_sampling import (
        SamplingRanges,
        embedded_tire,
        sample_axle,
        sample_lateral,
        sample_tir,
        unmodelled_spread,
    )
    from miho.vehicle.data.torque_samples import TorqueRules, TorqueSamples, load_torque_samples

__all__ = [
    "CHANNELS", "DataUnavailableError", "DrivingLog", "SamplingRanges", "TorqueRules",
    "TorqueSamples", "brake_deceleration_test", "brake_play_test", "brake_pressure_test",
    "brake_step_test", "brake_torque_test", "dyno_test", "embedded_tire", "engine_driving_log",
    "load_axle_samples", "load_braking_samples", "load_driving_log", "load_engine_drive",
    "load_seong_sample", "load_torque_samples", "sample_axle", "sample_lateral", "sample_tir",
    "simulated_axle_drive", "simulated_weave", "steering_test", "tire_drive", "tire_outlier_test",
    "unmodelled_spread",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
