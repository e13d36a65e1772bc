"""R2: every write, fsync, rename and new folder of a sweep fails once, then there is room again."""

from __future__ import annotations

import errno
import io
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from miho.optim import Budget, RandomSearch, RunRecord, minimize
from miho.study import Identity, Status, Store, execute, load_runs
from miho.testing import DecayFit
from tests.faults.conftest import Figures

ERRORS = (errno.ENOSPC, errno.EIO)
SEEDS = range(3)
CALLS = ("write", "fsync", "replace", "rename", "mkdir")
NAMING = ("replace", "rename", "mkdir")
"""Calls whose errors name a path; those on open files do not."""


@pytest.mark.slow
@pytest.mark.fault(
    row="R2",
    fault="no space or an input/output error at each call of a sweep",
    promise="0 committed files changed, path named, 0 partial files read, rerun completes",
)
def test_full_disk(tmp_path: Path, measured: Figures) -> None:
    """A sweep of three runs, the first one finished before, with its n-th call failing, n = 1 on.

    A full disk stays so until the sweep ends; an input/output error happens once. The
    sweep stops at the error, as the command does, and is started again.
    """
    points = changed = unnamed = unread = incomplete = 0
    prepared = tmp_path / "prepared"
    _run(prepared, SEEDS[0])
    for error in ERRORS:
        for n in range(1, 1000):
            root = tmp_path / f"{errno.errorcode[error]}-{n}"
            shutil.copytree(prepared, root)
            before = _committed(root)
            disk = Disk(n, error, lasting=error != errno.EIO)
            statuses: list[Status] = []
            failure = None
            with disk.failing():
                try:
                    statuses = [_run(root, seed) for seed in SEEDS]
                except OSError as caught:
                    failure = caught
            if not disk.failed:
                break
            points += 1
            committed = _committed(root)
            changed += any(committed.get(path) != data for path, data in before.items())
            unnamed += failure is not None and not _names_what_failed(failure, root, error)
            unread += len(load_runs(root).damaged) > 0
            if failure is not None:
                with Disk(0, error, lasting=False).failing():
                    statuses = [_run(root, seed) for seed in SEEDS]
            whole = load_runs(root)
            incomplete += (
                not set(statuses) <= {Status.RAN, Status.DONE_BEFORE}
                or sorted(whole.runs["seed"]) != list(SEEDS)
                or len(whole.damaged) > 0
                or any(_committed(root)[path] != data for path, data in committed.items())
            )
            shutil.rmtree(root)
    measured(
        f"at {points} calls: {changed} changed, {unnamed} without the path, {unread} partial, "
        f"{incomplete} reruns incomplete"
    )
    assert points >= 40
    assert not (changed or unnamed or unread or incomplete)


def _names_what_failed(failure: OSError, root: Path, error: int) -> bool:
    """Whether the command can say in one line where what happened."""
    return failure.errno == error and str(failure.filename or "").startswith(str(root))


class Disk:
    """Counts the calls that change files, and fails the n-th, or all from there on; 0: none.

    It is not waited for: what an fsync would keep through a power cut is not what is tested here.
    """

    def __init__(self, n: int, error: int, *, lasting: bool) -> None:
        self.n, self.error, self.lasting = n, error, lasting
        self.calls = 0
        self.failed = False

    @contextmanager
    def failing(self) -> Iterator[None]:
        """Within this, calls fail; Python's own files are made of parts that can."""
        calls: dict[str, Any] = {name: self._call(name) for name in CALLS}
        with mock.patch.multiple(os, **calls):
            opened = self._opened()
            with mock.patch("io.open", opened), mock.patch("builtins.open", opened):
                yield

    def _count(self, *named: Any) -> None:
        self.calls += 1
        if self.calls == self.n or (self.lasting and self.calls > self.n):
            self.failed = True
            raise OSError(self.error, os.strerror(self.error), *named)

    def _call(self, name: str) -> Callable[..., Any]:
        real = getattr(os, name)

        def call(*arguments: Any, **settings: Any) -> Any:
            self._count(*map(str, arguments[:1] if name in NAMING else ()))
            return None if name == "fsync" else real(*arguments, **settings)

        return call

    def _opened(self) -> Callable[..., Any]:
        real, count = io.open, self._count

        class File(io.FileIO):
            def write(self, data: Any) -> int:
                count()
                return super().write(data) or 0

        def opened(file: Any, mode: str = "r", *arguments: Any, **settings: Any) -> Any:
            if isinstance(file, int) or not set(mode) & set("wax+"):
                return real(file, mode, *arguments, **settings)
            raw = io.BufferedWriter(File(file, mode.replace("b", "").replace("t", "")))
            return raw if "b" in mode else io.TextIOWrapper(raw, encoding="utf-8")

        return opened


def _run(root: Path, seed: int) -> Status:
    def job() -> RunRecord:
        return minimize(RandomSearch(), DecayFit(), Budget(evaluations=20), seed)

    identity = Identity("decay", "random", seed, {}, "c0de", "da7a")
    return execute(Store(root), identity, job, DecayFit.space, {"unit": "V"}).status


def _committed(root: Path) -> dict[Path, bytes]:
    """The files of finished runs, with what they hold."""
    folders = [path.parent for path in root.rglob("result.json")]
    files = [path for folder in folders for path in folder.glob("*.json")]
    return {path: path.read_bytes() for path in files}
