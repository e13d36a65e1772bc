"""The sample data that the authors of MIHO published: two tires, 300 rows."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from miho.data.csv import read_numbers
from miho.data.dataset import Dataset

FILE = "tire_data_SA_FyA_FyB.csv"
URL = f"https://raw.githubusercontent.com/hynkis/MIHO/468cabd/csv_files/lateral_model/{FILE}"
SHA256 = "a4ef329c298a35237befeb22d858041089bedc658b0725c9b596ec9b62d8adf5"
FORCES = {"a": "FyA", "b": "FyB"}


class DataUnavailableError(OSError):
    """The data are neither on this machine nor downloadable; the message gives a remedy."""


def load_seong_sample(tire: str) -> Dataset:
    """Slip angle alpha [rad] and lateral force Fy [N] of a tire of the authors' sample data.

    The file has no header row and uses ISO-W signs: positive slip angle, negative force.

    Parameters
    ----------
    tire : {'a', 'b'}
        The tire.

    Returns
    -------
    Dataset
        All 300 rows.

    Raises
    ------
    ValueError
        For another tire.
    DataUnavailableError
        If the file cannot be downloaded or has the wrong checksum.

    References
    ----------
    github.com/hynkis/MIHO (MIT licence), commit 468cabd.
    """
    if tire not in FORCES:
        raise ValueError(f"tire is {tire!r}; the sample data has tires 'a' and 'b'")
    columns = read_numbers(sample_file(), ("alpha", "FyA", "FyB"), header=False)
    return Dataset(
        f"seong_sample_{tire}",
        {"alpha": columns["alpha"], "Fy": columns[FORCES[tire]]},
        {"alpha": "rad", "Fy": "N"},
        "Fy",
    )


def sample_file(url: str = URL, cache: Path | None = None) -> Path:
    """Path of the verified file: in MIHO_DATA_DIR, in the cache, or downloaded into the cache.

    Raises DataUnavailableError if the file cannot be downloaded or has the wrong checksum.
    """
    folder = os.environ.get("MIHO_DATA_DIR")
    if folder:
        for path in (Path(folder) / "seong_sample" / FILE, Path(folder) / FILE):
            if path.is_file():
                return _verified(path)
    import pooch  # slow to import, and warns if notebooks lack widgets

    cache = Path(pooch.os_cache("miho")) if cache is None else cache
    try:
        downloaded = pooch.retrieve(
            url, f"sha256:{SHA256}", fname=FILE, path=cache, progressbar=False,
            downloader=pooch.HTTPDownloader(timeout=10),
        )  # fmt: skip
    except (OSError, ValueError) as error:
        reason = "wrong checksum" if isinstance(error, ValueError) else type(error).__name__
        raise DataUnavailableError(
            f"{url}: cannot be downloaded ({reason}); put {FILE} into a folder and set "
            "MIHO_DATA_DIR to it"
        ) from None
    return Path(downloaded)


def _verified(path: Path) -> Path:
    if hashlib.sha256(path.read_bytes()).hexdigest() != SHA256:
        raise DataUnavailableError(
            f"{path}: not the published file (its SHA-256 differs); replace it, or read your own "
            "data with dataset=csv"
        )
    return path
