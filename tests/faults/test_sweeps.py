"""The rows about sweeps that judge no time: each starts the real command."""

from dataclasses import replace

import pytest

from experiments.faults.outcome import run_rows
from experiments.faults.registry import ENTRIES

TIMES = {
    "kills": 40, "isolation": None, "signals": 5, "sharing": None, "identical_sweeps": None,
    "changes": None, "determinism": 12, "neighbours": None, "own_models": None,
    "silence": None, "received_files": None, "other_machines": None,
}  # fmt: skip
"""By row, how often its fault is done here, if less often than the table asks."""


@pytest.mark.slow
@pytest.mark.parametrize("name", TIMES)
def test_row_is_met(name: str) -> None:
    (entry,) = (entry for entry in ENTRIES if entry.name == name)
    (outcome,) = run_rows([replace(entry, times=TIMES[name])])
    assert outcome.fine, outcome.row.measured
