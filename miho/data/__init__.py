"""Datasets: the class, its loaders and the embedded tires."""

from miho.data.csv import CSVError, load_csv
from miho.data.dataset import Dataset
from miho.data.seong import DataUnavailableError, load_seong_sample
from miho.data.tir_sampling import SamplingRanges, embedded_tire, sample_tir, unmodelled_spread

__all__ = [
    "CSVError", "DataUnavailableError", "Dataset", "SamplingRanges", "embedded_tire", "load_csv",
    "load_seong_sample", "sample_tir", "unmodelled_spread",
]  # fmt: skip
