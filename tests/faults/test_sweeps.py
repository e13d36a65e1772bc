"""The rows about sweeps that judge no time: each starts the real command."""

import importlib
from pathlib import Path

import pytest

ROWS = (
    "kills", "isolation", "signals", "sharing", "identical_sweeps", "changes",
    "determinism",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", ROWS)
def test_row_is_met(name: str, tmp_path: Path) -> None:
    row = getattr(importlib.import_module(f"experiments.faults.{name}"), name)(tmp_path)
    assert row.met, row.measured
