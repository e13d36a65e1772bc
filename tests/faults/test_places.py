"""R21: surroundings that are not what a program expects."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from miho.study import load_runs
from tests.faults.commands import Call, Ended, called
from tests.faults.conftest import Figures

QUICK = ["dataset.n=40", "optimizer=random", "optimizer.batch=10", "budget.evaluations=40"]
GOOD, BAD_INPUT, STORAGE = 0, 2, 4
Cases = dict[str, tuple[str, int, Call]]
"""Root, exit code and call by name."""

CASES: Cases = {
    "a read-only root": ("read only/runs", STORAGE, Call(QUICK, plain=True)),
    "a root that is a file": ("file", STORAGE, Call(QUICK)),
    "a root below a file": ("file/runs", STORAGE, Call(QUICK)),
    "a link to nowhere": ("dangling", STORAGE, Call(QUICK)),
    "a name of 300 letters": ("x" * 300, STORAGE, Call(QUICK)),
    "a quota": ("quota", STORAGE, Call(QUICK, fsync=errno.EDQUOT)),
    "a read-only file system": ("mounted", STORAGE, Call(QUICK, fsync=errno.EROFS)),
    "no name": (" ", BAD_INPUT, Call(QUICK)),
    "a clock at 1970": ("1970", GOOD, Call(QUICK, now=1.0)),
    "spaces and another script": ("my \u7d50\u679c (1) \u00e9\U0001f3ce", GOOD, Call(QUICK)),
}
POOR: Cases = {
    "no home, no UTF-8": ("no home", GOOD, Call(QUICK)),
    "a name that the locale lacks": ("\u00fcber", BAD_INPUT, Call(QUICK)),
}
"""In surroundings without a home or a locale."""


@pytest.mark.slow
@pytest.mark.fault(
    row="R21",
    fault=f"{len(CASES) + len(POOR)} places: {', '.join([*CASES, *POOR])}",
    promise="stored, or one line and exit 2 or 4",
)
def test_places(tmp_path: Path, measured: Figures) -> None:
    """Each place or surrounding once: the run is stored, or one line says why it is not."""
    (tmp_path / "read only").mkdir(mode=0o555)
    (tmp_path / "file").touch()
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere" / "at all")
    judged = _judge(tmp_path, CASES, None)
    bare = {name: value for name, value in os.environ.items() if name in ("PATH", "SYSTEMROOT")}
    judged |= _judge(
        tmp_path, POOR, {**bare, "LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    )
    wrong = [name for name, good in judged.items() if not good]
    measured(
        f"{len(judged) - len(wrong)} of {len(judged)}"
        + (f"; not {', '.join(wrong)}" if wrong else "")
    )
    assert not wrong


def _judge(folder: Path, cases: Cases, environment: dict[str, str] | None) -> dict[str, bool]:
    calls = [
        Call([*call.arguments, _root(folder, name)], call.command, {}, call.plain, call.now,
             call.fsync)
        for name, _, call in cases.values()
    ]  # fmt: skip
    ended = called(calls, environment)
    return {
        name: _good(end, code, folder / root)
        for (name, (root, code, _)), end in zip(cases.items(), ended, strict=True)
    }


def _root(folder: Path, name: str) -> str:
    return f"root={name}" if not name.strip() else f'root="{folder / name}"'


def _good(end: Ended, code: int, root: Path) -> bool:
    """Whether a run was stored, or is not and one line names the place."""
    if end.code != code:
        return False
    if code == GOOD:
        return "error:" not in end.err and len(load_runs(root).runs) == 1
    one_line = end.complaint.count("\n") == 0 and end.complaint.startswith("error: ")
    return one_line and (code == BAD_INPUT or str(root) in end.complaint)
