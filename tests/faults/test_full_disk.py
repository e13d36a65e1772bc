"""R2 is met."""

from pathlib import Path

import pytest

from experiments.faults.full_disk import full_disk


@pytest.mark.slow
def test_full_disk(tmp_path: Path) -> None:
    row = full_disk(tmp_path)
    assert row.number == "R2"
    assert row.met, row.measured
