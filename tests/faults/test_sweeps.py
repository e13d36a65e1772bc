"""The rows about sweeps that judge no time: each starts the real command."""

import pytest

from experiments.faults.outcome import run_rows
from experiments.faults.registry import ENTRIES

ROWS = (
    "kills", "isolation", "signals", "sharing", "identical_sweeps", "changes",
    "determinism",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", ROWS)
def test_row_is_met(name: str) -> None:
    (outcome,) = run_rows([entry for entry in ENTRIES if entry.name == name])
    assert outcome.fine, outcome.row.measured
