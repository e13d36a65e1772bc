"""Datasets: the class, its loaders and published data."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.data.csv import load_csv
    from miho.data.dataset import Dataset
    from miho.data.mat import load_mat
    from miho.data.stacking import stacked
    from miho.data.text_lines import CSVError

__all__ = [
    "CSVError", "Dataset", "load_csv", "load_mat", "stacked",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
