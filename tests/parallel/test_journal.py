"""The journal of evaluations: what is damaged costs itself alone, and nobody else's is used."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from miho.parallel import Evaluations, Journal, JournalError, calls_of
from miho.parallel.remote import Raised

VALUES = [("task", bytes([k]) * 8) for k in range(5)]


@dataclass(frozen=True)
class Named:
    description: str = "problem"
    called_as: tuple[Any, ...] = ((False, True, False), ())


def written(path: Path) -> Journal:
    """A journal of five values, the last of them raised."""
    journal = Journal(path, Named())
    for k, key in enumerate(VALUES[:-1]):
        journal.add(key, np.array([[k, 0.1]]))
    journal.add(VALUES[-1], Raised("ValueError", "no value"))
    journal.close()
    return journal


def loaded(path: Path) -> int:
    """How many values a journal knows."""
    with closing(Journal(path, Named())) as journal:
        return journal.loaded


def test_values_come_back_to_the_last_bit(tmp_path: Path) -> None:
    written(tmp_path / "journal")
    journal = Journal(tmp_path / "journal", Named())
    assert journal.loaded == 5
    assert journal.status == "continues from 5 evaluations of an earlier call"
    value = journal[VALUES[3]]
    assert isinstance(value, np.ndarray)
    assert value.tolist() == [[3, 0.1]]
    assert value.shape == (1, 2)
    assert journal[VALUES[4]] == Raised("ValueError", "no value")
    assert [journal.place(key) for key in VALUES] == list(range(5))
    journal.close()


def test_the_file_comes_to_exist_with_its_first_value(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "folder" / "journal", Named())
    assert not journal.path.parent.exists()
    assert not journal.status
    journal.add(VALUES[0], np.zeros(1))
    assert journal.path.is_file()
    journal.close()


def test_the_first_line_says_how_functions_are_called(tmp_path: Path) -> None:
    assert calls_of(tmp_path / "journal") is None
    (tmp_path / "empty").touch()
    assert calls_of(tmp_path / "empty") is None
    written(tmp_path / "journal")
    assert calls_of(tmp_path / "journal") == [[False, True, False], []]
    (tmp_path / "notes").write_text("notes of mine\n")
    assert calls_of(tmp_path / "notes") == ()


def test_a_first_line_that_was_cut_short_says_nothing(tmp_path: Path) -> None:
    """Another process may have found out something else of how functions are called."""
    path = tmp_path / "journal"
    written(path)
    first = path.read_bytes().split(b"\n")[0]
    for length in (1, 9, 30, len(first)):
        path.write_bytes(first[:length])
        assert calls_of(path) is None
        journal = Journal(path, Named(called_as=()))
        journal.add(VALUES[0], np.ones(1))
        journal.close()
        assert loaded(path) == 1


def test_what_comes_after_the_end_is_not_kept(tmp_path: Path) -> None:
    journal = written(tmp_path / "journal")
    journal.add(("task", b"late"), np.ones(1))
    assert loaded(tmp_path / "journal") == 5


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked there")
def test_a_forked_process_does_not_hold_the_file(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal", Named())
    journal.add(VALUES[0], np.ones(1))
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            journal.add(VALUES[1], np.ones(1))
            os.read(read, 1)
        finally:
            os._exit(0)
    try:
        journal.close()
        wait_until_free(tmp_path / "journal")
        assert loaded(tmp_path / "journal") == 1
    finally:
        os.write(write, b"+")
        os.waitpid(child, 0)
        os.close(read)
        os.close(write)


def wait_until_free(path: Path) -> None:
    """Until a process that was just forked has let go of the file."""
    until = time.monotonic() + 60
    while True:
        try:
            loaded(path)
            return
        except JournalError:
            assert time.monotonic() < until
            time.sleep(0.01)


@pytest.mark.parametrize("cut", [1, 20, 60])
def test_a_torn_tail_costs_the_last_value(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "journal"
    written(path)
    path.write_bytes(path.read_bytes()[:-cut])
    journal = Journal(path, Named())
    assert journal.loaded == 4
    journal.add(VALUES[4], np.ones(1))
    journal.close()
    assert loaded(path) == 5


def test_a_torn_first_line_is_an_empty_journal(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    written(path)
    path.write_bytes(path.read_bytes()[:15])
    journal = Journal(path, Named())
    assert journal.loaded == 0
    journal.add(VALUES[0], np.ones(1))
    journal.close()
    assert loaded(path) == 1


def test_a_flipped_bit_costs_its_own_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "journal"
    written(path)
    lines = path.read_bytes().split(b"\n")
    lines[2] = lines[2][:-20] + bytes([lines[2][-20] ^ 1]) + lines[2][-19:]
    path.write_bytes(b"\n".join(lines))
    journal = Journal(path, Named())
    assert [key in journal for key in VALUES] == [True, False, True, True, True]
    assert "1 damaged lines were ignored" in capsys.readouterr().err
    journal.close()


def test_a_journal_of_another_problem_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    written(path)
    with pytest.raises(
        JournalError, match="belongs to another problem, model or data; name another"
    ):
        Journal(path, Named("another"))
    assert loaded(path) == 5


@pytest.mark.parametrize("content", [b"notes", b"notes\nof mine\n", b"\x00\n" * 10])
def test_a_file_that_is_none_is_refused_and_kept(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "journal"
    path.write_bytes(content)
    with pytest.raises(JournalError, match="not a journal; name another file"):
        Journal(path, Named())
    assert path.read_bytes() == content


def test_a_journal_of_another_version_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "journal"
    written(path)
    monkeypatch.setattr("miho.parallel.journal.FORMAT", 0)
    with pytest.raises(JournalError, match="written by another version of MIHO; name another file"):
        Journal(path, Named())


@pytest.mark.parametrize("name", ["\ud800.journal", "x\0.journal"])
def test_a_name_that_no_file_can_have_is_refused(tmp_path: Path, name: str) -> None:
    for use in (lambda path: Journal(path, Named()), calls_of):
        with pytest.raises(JournalError, match="name another file") as error:
            use(tmp_path / name)
        assert str(error.value).isascii()


@pytest.mark.skipif(sys.platform == "win32", reason="names of files are Unicode there")
def test_a_name_that_the_locale_lacks_is_refused(tmp_path: Path) -> None:
    code = (
        "from miho.parallel import Journal, JournalError\n"
        "try: Journal('\\xf6.journal', None)\n"
        "except JournalError as error: print(error)"
    )
    poor = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    ended = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **poor}, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert ended.stdout == (
        "journal '\\xf6.journal': the file system's encoding, ascii, has no '\\xf6'; set "
        "PYTHONUTF8=1, or name another file\n"
    )


@pytest.mark.skipif(sys.platform == "win32", reason="files are not locked there")
def test_two_processes_do_not_write_one_journal(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    written(path)
    code = (
        "import sys; from miho.parallel import Journal\n"
        "class Named: description, called_as = 'problem', ()\n"
        f"journal = Journal({str(path)!r}, Named()); print('open', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"open\n"
        with pytest.raises(JournalError, match="another process is writing it"):
            Journal(path, Named())
        process.communicate()
    assert loaded(path) == 5


def test_where_it_cannot_be_written_the_run_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    journal = Journal(tmp_path / "file" / "journal", Named())
    journal.add(VALUES[0], np.zeros(1))
    journal.add(VALUES[1], np.zeros(1))
    assert capsys.readouterr().err.count("evaluations are not kept from now on") == 1
    journal.close()


def test_only_what_is_expensive_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Expensive is what takes longer than nothing, or nothing at all."""
    rows = np.arange(6.0).reshape(3, 2)
    for expensive, count in ((0.0, 3), (np.inf, 0)):
        monkeypatch.setattr("miho.parallel.worth.EXPENSIVE", expensive)
        journal = Journal(tmp_path / f"journal-{expensive}", Named())
        evaluated = Evaluations(None, journal).function("sum", lambda thetas: thetas.sum(axis=1))
        assert evaluated(rows).tolist() == [1.0, 5.0, 9.0]
        assert len(journal) == count
        journal.close()
