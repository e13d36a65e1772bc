"""The posterior of a stored run, as a file that ArviZ and xarray read."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from experiments.app.instantiation import MissingLibraryError
from miho.identification import Report, sample_posterior
from miho.study import StoredRun, write_bytes
from miho.study.provenance import provenance

FILE = "posterior.nc"


def save_posterior(report: Report, stored: StoredRun, folder: Path) -> str:
    """Sample and write the posterior next to the report; return its path and its limitations."""
    seed = int(stored.result["seed"])
    try:
        posterior = sample_posterior(report.problem, report.at.theta, seed=seed)
    except ImportError as error:
        raise MissingLibraryError(f"--posterior: {error}") from None
    posterior.attrs["provenance"] = json.dumps(provenance(stored))
    with tempfile.TemporaryDirectory(prefix="miho-") as temporary:
        posterior.to_netcdf(Path(temporary, FILE))
        write_bytes(folder / FILE, Path(temporary, FILE).read_bytes())
    return "\n".join([f"posterior {folder / FILE}", *posterior.attrs["notes"].splitlines()])
