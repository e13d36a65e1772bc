"""Compacted curves: the same numbers faster, or as if they were not there."""

import io
import sys
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.compact import main
from miho import load_runs
from miho.study.compaction import FOLDER, NAME, Curve, compact, compacted, curve_of
from tests.faults.stored_runs import make_runs


@pytest.fixture
def root(tmp_path: Path) -> Path:
    make_runs(tmp_path / "root", 12, np.random.default_rng(0))
    return tmp_path / "root"


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """The curves that were read from their own files."""
    texts: list[bytes] = []

    def counted(text: bytes) -> Curve:
        texts.append(text)
        return curve_of(text)

    for module in ("compaction", "index"):
        monkeypatch.setattr(f"miho.study.{module}.curve_of", counted)
    return texts


def test_the_same_numbers_from_one_file(tmp_path: Path, parsed: list[bytes]) -> None:
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
    root: Path, tmp_path: Path, parsed: list[bytes]
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


def save(**arrays: object) -> bytes:
    archive = io.BytesIO()
    np.savez(archive, **arrays)  # type: ignore[arg-type]
    return archive.getvalue()


GOOD = {"digests": np.array([b"0" * 64]), "lengths": np.array([1]), "columns": np.zeros((4, 1))}
MISFITS = {
    "no archive": b"curves",
    "no digests": save(lengths=GOOD["lengths"], columns=GOOD["columns"]),
    "too long": save(**GOOD | {"lengths": np.array([10**9])}),
    "too short": save(**GOOD | {"lengths": np.array([0])}),
    "negative": save(**GOOD | {"lengths": np.array([2, -1])}),
    "a column missing": save(**GOOD | {"columns": np.zeros((3, 1))}),
    "texts": save(**GOOD | {"lengths": np.array(["a"])}),
    "pickled": save(**GOOD | {"columns": np.array([[None]] * 4, dtype=object)}),
}


@pytest.mark.parametrize("case", MISFITS)
def test_an_archive_that_does_not_fit_is_ignored_though_its_checksum_matches(
    root: Path, case: str
) -> None:
    expected = load_runs(root).curves
    compact(root)
    data = MISFITS[case]
    (root / FOLDER / NAME).write_bytes(sha256(data).hexdigest().encode() + b"\n" + data)
    assert not compacted(root)
    pd.testing.assert_frame_equal(load_runs(root).curves, expected, check_exact=True)


def test_damaged_runs_are_not_compacted(root: Path) -> None:
    path = root / "problem_3" / "optimizer_0" / f"{3:016x}" / "config.json"
    path.write_bytes(path.read_bytes()[:-1])
    assert compact(root) == 11


def test_several_compact_and_read_at_once(root: Path) -> None:
    compact(root)
    with ThreadPoolExecutor(4) as pool:
        jobs = [pool.submit(compact, root) for _ in range(8)]
        counts = [len(compacted(root)) for _ in range(50)]
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
    assert sorted(p.name for p in (root / FOLDER).iterdir() if p.name != "lock") == [NAME]


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
