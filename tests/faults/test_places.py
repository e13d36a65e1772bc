"""R21 is met."""

from pathlib import Path

import pytest

from experiments.faults.places import places


@pytest.mark.slow
def test_places(tmp_path: Path) -> None:
    row = places(tmp_path)
    assert row.number == "R21"
    assert row.met, row.measured
