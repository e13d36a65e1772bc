"""R15: hostile names and links, and what is written outside of the folder of results."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from experiments.sync import connect
from miho.optim import Budget, RandomSearch, RunRecord, minimize
from miho.study import Identity, Store, execute
from miho.testing import DecayFit
from tests.faults.conftest import Figures

NAMES = [
    "..", ".", "", " ", "../outside", "../../outside/x", "a/../../outside", "/tmp/outside", "a/b",
    "a\\..\\..\\outside", "C:\\outside", "\\\\host\\share", "file:///tmp/outside", "~", "~root/x",
    "$HOME", "a\0b", "a\nb", "a" * 300, "CON", "nul.txt", "com1", "name.", "name ", ".hidden",
    "-rf", "\uff0e\uff0e", "\u2024\u2024", "\uff0fetc", "p\u0430cejka", "\u202egnp.x",
    "\ufb01t", "a|b", "*",
]  # fmt: skip
"""Among them full-width and one-dot-leader dots, a full-width slash, a Cyrillic a, a change of
direction and a ligature."""


MIRRORED = (".mlflow", ".mlflow/mlflow.db", ".mlflow/mlflow.db.lock", ".mlflow/artifacts")
LINKS = ("decay", "decay/random", "decay/random/ID", "decay/random/ID/lock", "decay/random/ID/F")


@pytest.mark.fault(
    row="R15",
    fault=f"{len(NAMES)} hostile names as problem and method, {len(LINKS) + len(MIRRORED)} links "
    "out of the root",
    promise="0 names accepted, 0 bytes outside of the root, each refused in one line",
    quick=True,
)
def test_names(tmp_path: Path, measured: Figures) -> None:
    """Each name as problem and as method, and each link that leads out of the root."""
    root, outside = tmp_path / "root", tmp_path / "outside"
    root.mkdir()
    outside.mkdir()
    outside.joinpath("kept").write_text("as it was", encoding="utf-8")
    accepted, unclear = [], 0
    for name in NAMES:
        for problem, optimizer in ((name, "random"), ("decay", name)):
            try:
                Identity(problem, optimizer, 0, {}, "c0de", "da7a")
                accepted.append(name)
            except ValueError as refusal:
                unclear += not str(refusal).isprintable() or len(str(refusal)) > 400
    before = _contents(tmp_path)
    through = sum(_written_through(tmp_path, where) for where in range(len(LINKS)))
    through += sum(
        _mirrored_through(tmp_path / "mirrored" / str(k), k) for k in range(len(MIRRORED))
    )
    changed = _contents(tmp_path) != before
    measured(
        f"{len(accepted)} accepted, {through} written through a link, "
        f"{'something' if changed else 'nothing'} changed outside, {unclear} not one line"
    )
    assert not accepted
    assert not unclear
    assert not through
    assert not changed


def _written_through(folder: Path, where: int) -> bool:
    """Whether a run writes through a link that someone left in a folder of results."""
    root, outside = folder / "root" / str(where), folder / "outside"
    identity = Identity("decay", "random", 0, {}, "c0de", "da7a")
    link = root / LINKS[where].replace("ID", identity.id).replace("/F", "/result.json")
    link.parent.mkdir(parents=True)
    link.symlink_to(outside / "kept" if link.name in ("lock", "result.json") else outside)

    def job() -> RunRecord:
        return minimize(RandomSearch(), DecayFit(), Budget(evaluations=20), 0)

    before = _contents(outside)
    try:
        execute(Store(root), identity, job, DecayFit.space, {})
    except OSError as refusal:
        return str(link) not in str(refusal) or _contents(outside) != before
    return _contents(outside) != before


def _contents(folder: Path) -> dict[str, bytes]:
    """Every file outside of the root, with what it holds."""
    return {str(path): path.read_bytes() for path in _files(folder)}


def _files(folder: Path) -> Iterator[Path]:
    for path in folder.rglob("*"):
        if path.is_file() and path.relative_to(folder).parts[0] != "root":
            yield path


def _mirrored_through(root: Path, which: int) -> bool:
    """Whether a tracker is opened through such a link."""
    link = root / MIRRORED[which]
    link.parent.mkdir(parents=True)
    link.symlink_to(root.parent.parent / "outside")
    try:
        connect(root)
    except PermissionError:
        return False
    return True
