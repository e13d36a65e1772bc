"""R7: files of runs that were cut, altered, overwritten with zeros or exchanged.

Small when quick tests run, whole among the slow ones.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from miho.study import DamagedRun, Runs, load_runs
from miho.study.compaction import FOLDER, NAME, compact, compacted
from miho.study.files import CONFIG, CURVE, ENVIRONMENT, RESULT
from tests.faults.conftest import Figures
from tests.faults.stored_runs import make_runs

TIMES, FEWER_TIMES = 300, 20
WHOLE = 10
COMPACTED_RUNS, EVERY = 5, 20
TAIL = 64
KINDS = (RESULT, CURVE, CONFIG, ENVIRONMENT)


@pytest.mark.slow
@pytest.mark.fault(
    row="R7",
    fault=f"5 kinds of file: cut at {TIMES} places, {TIMES} bits flipped, tail zeroed, exchanged",
    promise="all detected, all other runs read, no wrong number",
)
def test_damage(tmp_path: Path, measured: Figures) -> None:
    detected, tried, right = damage(tmp_path, TIMES)
    others = "right" if right == len(KINDS) else f"wrong in {len(KINDS) - right} of {len(KINDS)}"
    measured(f"{detected:,} of {tried:,} detected, the others read {others}")
    assert detected == tried
    assert right == len(KINDS)


def test_less_damage(tmp_path: Path) -> None:
    assert damage(tmp_path, FEWER_TIMES) == (210, 210, len(KINDS))


def test_a_reader_that_checks_nothing_fails_the_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unchecked(folder: str) -> tuple[Any, dict[str, bytes]]:
        try:
            result = json.loads((Path(folder) / "result.json").read_bytes())
        except ValueError as error:
            raise DamagedRun(str(error)) from None
        return result, {name: (Path(folder) / name).read_bytes() for name in result["files"]}

    monkeypatch.setattr("miho.study.scan.read_checked", unchecked)
    detected, tried, right = damage(tmp_path, times=5)
    assert detected < tried or right < len(KINDS)


def damage(folder: Path, times: int) -> tuple[int, int, int]:
    """Spoil each kind of file in many ways, each in a run of its own, and read them all.

    How many damages are detected, of how many, and after how many of `KINDS` the others are read
    right. The file of compacted curves is one for all runs: whatever is done to it, all runs must
    be read as before.
    """
    rng = np.random.default_rng(0)
    ways = 2 * times + 2
    folders = make_runs(folder / "runs", ways + WHOLE, rng)
    expected = load_runs(folder / "runs")
    detected, right = 0, 0
    for name in KINDS:
        other = (folders[-1] / name).read_bytes()
        good = [(run / name).read_bytes() for run in folders[:ways]]
        for way, data in enumerate(good):
            (folders[way] / name).write_bytes(_spoilt(data, other, way, times, rng))
        stored = load_runs(folder / "runs")
        listed = stored.damaged[stored.damaged["reason"] != ""]["folder"]
        detected += len({str(run) for run in folders[:ways]} & set(listed))
        right += len(stored.runs) == WHOLE and _agrees(stored, expected)
        for run, data in zip(folders, good, strict=False):
            (run / name).write_bytes(data)
    ignored = _compacted(folder, ways, times, rng)
    return detected + ignored, 5 * ways, right


def _compacted(folder: Path, ways: int, times: int, rng: np.random.Generator) -> int:
    """How many of the damages to the compacted curves change nothing that is read."""
    root, other = folder / "compacted", folder / "other"
    make_runs(root, COMPACTED_RUNS, rng)
    make_runs(other, COMPACTED_RUNS, rng)
    expected = load_runs(root)
    expected.curves  # noqa: B018 -- read now, from the runs' own files
    path = root / FOLDER / NAME
    compact(root)
    compact(other)
    good, foreign = path.read_bytes(), (other / FOLDER / NAME).read_bytes()
    harmless = 0
    for way in range(ways):
        path.write_bytes(_spoilt(good, foreign, way, times, rng))
        exchanged = way == ways - 1
        unused = exchanged or not compacted(root)
        if exchanged or way % EVERY == 0:
            stored = load_runs(root)
            unused &= len(stored.runs) == COMPACTED_RUNS and _agrees(stored, expected)
        harmless += unused
    shutil.rmtree(other)
    return harmless


def _spoilt(good: bytes, other: bytes, way: int, times: int, rng: np.random.Generator) -> bytes:
    if way < times:
        return good[: len(good) * way // times]
    if way < 2 * times:
        position, bit = int(rng.integers(len(good))), int(rng.integers(8))
        return good[:position] + bytes([good[position] ^ 1 << bit]) + good[position + 1 :]
    return good[:-TAIL] + bytes(TAIL) if way == 2 * times else other


def _agrees(found: Runs, expected: Runs) -> bool:
    """Whether the runs that were found have the numbers that are expected of them."""
    return all(
        after.equals(before[before["id"].isin(found.runs["id"])].reset_index(drop=True))
        for after, before in ((found.runs, expected.runs), (found.curves, expected.curves))
    )
