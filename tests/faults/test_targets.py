"""R14 is met."""

from pathlib import Path

import pytest

from experiments.faults.targets import targets


@pytest.mark.slow
def test_targets(tmp_path: Path) -> None:
    row = targets(tmp_path)
    assert row.number == "R14"
    assert row.met, row.measured
