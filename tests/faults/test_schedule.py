"""R18: tables of brackets and what runs of them cost."""

from pathlib import Path

import pytest

from experiments.faults import schedule as row
from experiments.faults.schedule import published, schedule
from miho.optim.schedule import Rung


def test_the_reference_gives_the_published_table() -> None:
    """Li et al. (2018), Table 1: R = 81, eta = 3."""
    brackets = {
        4: [(81, 1), (27, 3), (9, 9), (3, 27), (1, 81)],
        3: [(34, 3), (11, 9), (3, 27), (1, 81)],
        2: [(15, 9), (5, 27), (1, 81)],
        1: [(8, 27), (2, 81)],
        0: [(5, 81)],
    }
    for s, expected in brackets.items():
        found = [(n, r) for bracket, _, n, r in published(81, 3, "floor") if bracket == s]
        assert found == expected


@pytest.mark.slow
def test_it_is_met(tmp_path: Path) -> None:
    assert schedule(tmp_path).met


def test_a_lost_bracket_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def one_short(R: int, eta: int, rounding: str = "ceil") -> tuple[Rung, ...]:
        rows = published(R, eta, rounding)
        return tuple(Rung(*size) for size in rows if size[0] or len(rows) == 1)

    monkeypatch.setattr(row, "hyperband_table", one_short)
    monkeypatch.setattr(row, "RUNS", 1)
    assert not schedule(tmp_path).met
