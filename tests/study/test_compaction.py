"""Compacted curves: the same numbers faster, or as if they were not there."""

import json
import sys
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.compact import main
from miho import load_runs
from miho.study.compaction import FOLDER, NAME, Curves, compact, compacted
from tests.faults.stored_runs import make_runs


@pytest.fixture
def root(tmp_path: Path) -> Path:
    make_runs(tmp_path / "root", 12, np.random.default_rng(0))
    return tmp_path / "root"


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The curves that were read from their own files."""
    digests: list[str] = []
    add = Curves.add

    def counted(curves: Curves, digest: str, text: bytes) -> None:
        digests.append(digest)
        add(curves, digest, text)

    monkeypatch.setattr(Curves, "add", counted)
    return digests


def test_the_same_numbers_from_one_file(tmp_path: Path, parsed: list[str]) -> None:
    make_runs(tmp_path, 300, np.random.default_rng(0))
    before = load_runs(tmp_path)
    assert len(before.curves) == len(parsed) * 50 == 300 * 50
    assert compact(tmp_path) == 300
    parsed.clear()
    after = load_runs(tmp_path)
    pd.testing.assert_frame_equal(after.curves, before.curves, check_exact=True)
    pd.testing.assert_frame_equal(after.runs, before.runs, check_exact=True)
    assert parsed == [], "no curve was read from its own file"


def test_what_came_later_is_read_from_its_own_file(
    root: Path, tmp_path: Path, parsed: list[str]
) -> None:
    compact(root)
    replaced = root / "problem_3" / "optimizer_0" / f"{3:016x}"
    removed = root / "problem_4" / "optimizer_0" / f"{4:016x}"
    others = make_runs(tmp_path / "others", 14, np.random.default_rng(1))
    replaced.rename(tmp_path / "replaced")
    for number in (3, 12, 13):
        target = root / others[number].relative_to(tmp_path / "others")
        target.parent.mkdir(parents=True, exist_ok=True)
        others[number].rename(target)
    removed.rename(tmp_path / "removed")
    parsed.clear()
    joined = load_runs(root)
    assert sorted(set(joined.curves["seed"])) == [0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12, 13]
    assert len(parsed) == 3
    (root / FOLDER / NAME).unlink()
    pd.testing.assert_frame_equal(joined.curves, load_runs(root).curves, check_exact=True)


def test_damage_of_a_compacted_run_is_found_all_the_same(root: Path) -> None:
    compact(root)
    path = root / "problem_3" / "optimizer_0" / f"{3:016x}" / "curve.json"
    path.write_bytes(path.read_bytes().replace(b"0.1", b"0.2", 1))
    runs = load_runs(root)
    assert runs.damaged["folder"].tolist() == [str(path.parent)]
    assert 3 not in set(runs.curves["seed"])


@pytest.mark.parametrize(
    "change",
    [
        {"format": 2},
        {"byteorder": "big" if sys.byteorder == "little" else "little"},
        {"rows": 10**12},
        {"rows": -1},
        {"rows": "many"},
        {"spans": {"0": [0, 10**9]}},
        {"spans": {"0": [-2, 1]}},
        {"spans": {"0": ["a", "b"]}},
        {"spans": [1]},
    ],
)
def test_a_header_that_does_not_fit_is_ignored_though_its_checksum_matches(
    root: Path, change: dict[str, object]
) -> None:
    expected = load_runs(root).curves
    compact(root)
    path = root / FOLDER / NAME
    _, header, columns = path.read_bytes().split(b"\n", 2)
    rest = json.dumps(json.loads(header) | change).encode() + b"\n" + columns
    path.write_bytes(sha256(rest).hexdigest().encode() + b"\n" + rest)
    assert not compacted(root).spans
    pd.testing.assert_frame_equal(load_runs(root).curves, expected, check_exact=True)


def test_damaged_runs_are_not_compacted(root: Path) -> None:
    path = root / "problem_3" / "optimizer_0" / f"{3:016x}" / "config.json"
    path.write_bytes(path.read_bytes()[:-1])
    assert compact(root) == 11


def test_several_compact_and_read_at_once(root: Path) -> None:
    compact(root)
    with ThreadPoolExecutor(4) as pool:
        jobs = [pool.submit(compact, root) for _ in range(8)]
        counts = [len(compacted(root).spans) for _ in range(50)]
        assert [job.result() for job in jobs] == [12] * 8
    assert set(counts) == {12}, "readers see a whole file at any time"
    assert sorted(p.name for p in (root / FOLDER).iterdir() if p.name != "lock") == [NAME]


def test_a_full_disk_leaves_the_last_file(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compact(root)
    before = (root / FOLDER / NAME).read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        compact(root)
    assert (root / FOLDER / NAME).read_bytes() == before
    assert not (root / FOLDER / f".{NAME}").exists()


def test_nothing_is_written_through_a_link(root: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (root / FOLDER).symlink_to(outside)
    with pytest.raises(PermissionError, match="leads out"):
        compact(root)
    assert not list(outside.iterdir())


def test_the_command(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for place, code in ((root, 0), (root / "absent", 2)):
        monkeypatch.setattr(sys, "argv", ["compact", str(place)])
        with pytest.raises(SystemExit) as end:
            main()
        assert end.value.code == code
    out, err = capsys.readouterr()
    assert out == "12 curves compacted\n"
    assert err.startswith("error: ")
    assert "no such folder of runs" in err
