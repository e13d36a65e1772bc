"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(scope="session", autouse=True)
def one_blas_thread() -> Iterator[None]:
    """As a study runs: where all cores are busy, the threads of BLAS wait for each other."""
    with threadpool_limits(limits=1):
        yield


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """Third-party data, never part of the project; its tests skip where it is absent."""
    named = os.environ.get("MIHO_DATA_DIR")
    folder = Path(named) if named else Path(__file__).parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no reference data in {folder}; set MIHO_DATA_DIR")
    return folder
