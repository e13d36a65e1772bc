"""Datasets: the class, its loaders, synthetic tests and the embedded tires."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.data.axle_samples import load_axle_samples
    from miho.data.braking_samples import load_braking_samples
    from miho.data.csv import CSVError, load_csv
    from miho.data.dataset import Dataset
    from miho.data.driving_log import CHANNELS, DrivingLog, load_driving_log
    from miho.data.mat import load_mat
    from miho.data.published_fits import (
        PublishedFit,
        load_published,
        published_fit,
        published_names,
        zero_residuals,
    )
    from miho.data.seong import DataUnavailableError, load_seong_sample
    from miho.data.stacking import stacked
    from miho.data.synthetic_brake import (
        brake_deceleration_test,
        brake_pressure_test,
        brake_step_test,
        brake_torque_test,
    )
    from miho.data.synthetic_drive import tire_drive
    from miho.data.synthetic_engine import dyno_test, engine_driving_log, load_engine_drive
    from miho.data.synthetic_handling import simulated_axle_drive, simulated_weave
    from miho.data.synthetic_outliers import tire_outlier_test
    from miho.data.synthetic_play import brake_play_test
    from miho.data.synthetic_steering import steering_test
    from miho.data.tir_sampling import (
        SamplingRanges,
        embedded_tire,
        sample_axle,
        sample_lateral,
        sample_tir,
        unmodelled_spread,
    )
    from miho.data.torque_samples import TorqueRules, TorqueSamples, load_torque_samples

__all__ = [
    "CHANNELS", "CSVError", "DataUnavailableError", "Dataset", "DrivingLog", "PublishedFit",
    "SamplingRanges", "TorqueRules", "TorqueSamples", "brake_deceleration_test", "brake_play_test",
    "brake_pressure_test", "brake_step_test", "brake_torque_test", "dyno_test", "embedded_tire",
    "engine_driving_log", "load_axle_samples", "load_braking_samples", "load_csv",
    "load_driving_log", "load_engine_drive", "load_mat", "load_published", "load_seong_sample",
    "load_torque_samples", "published_fit", "published_names", "sample_axle", "sample_lateral",
    "sample_tir", "simulated_axle_drive", "simulated_weave", "stacked", "steering_test",
    "tire_drive", "tire_outlier_test", "unmodelled_spread", "zero_residuals",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
