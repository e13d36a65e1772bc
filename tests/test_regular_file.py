"""Paths that a user names by mistake or a stranger on purpose: nothing waits or has no end."""

import os
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from miho.data import load_csv, load_mat
from miho.models import FmuModel, load_function, load_trajectory
from miho.models.identified import read_parameters
from miho.parallel import Journal, calls_of
from miho.regular_file import NotAFileError, check_regular, read_regular
from miho.vehicle.models import Pacejka
from miho.vehicle.models.tir import load_tir

READERS: dict[str, Callable[[str], object]] = {
    "csv": lambda path: load_csv(path, ["alpha", "Fy"], ["rad", "N"], "Fy"),
    "mat": lambda path: load_mat(path, ["alpha", "Fy"], ["rad", "N"], "Fy"),
    "tir": load_tir,
    "function": load_function,
    "trajectory": lambda path: load_trajectory(path, "rhs", {"x": 0.0}, ["x"]),
    "fmu": lambda path: FmuModel(path, ["k"], ["x"]),
    "parameters": lambda path: read_parameters(path, Pacejka()),
    "journal": lambda path: Journal(path, SimpleNamespace(description="", called_as=())),
    "calls of a journal": calls_of,
}


def test_a_file_is_read_whole_or_to_the_limit(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"12345")
    link = tmp_path / "link"
    link.symlink_to(path)
    for place in (path, str(link)):
        check_regular(place)
        assert read_regular(place) == b"12345"
        assert read_regular(place, 3) == b"123"
        assert read_regular(place, 9) == b"12345"
    with pytest.raises(FileNotFoundError):
        read_regular(tmp_path / "none")


@pytest.fixture(params=["pipe", "device", "socket", "folder", "link to a pipe"])
def irregular(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    path = tmp_path / "x"
    if request.param == "device":
        path = Path("/dev/zero")
    elif request.param == "folder":
        path.mkdir()
    elif request.param == "socket":
        with socket.socket(socket.AF_UNIX) as server:
            folder = Path.cwd()
            os.chdir(tmp_path)  # the name of a socket is at most 108 bytes long
            server.bind("x")
            os.chdir(folder)
            yield str(path)
        return
    else:
        os.mkfifo(tmp_path / "pipe")
        path.symlink_to(tmp_path / "pipe")
        path = path if "link" in request.param else tmp_path / "pipe"
    yield str(path)


def ends(job: Callable[[], object]) -> BaseException | None:
    """What a job raises, which would otherwise hold the test up for ever."""
    raised: list[BaseException] = []

    def run() -> None:
        try:
            job()
        except BaseException as error:  # noqa: BLE001 -- handed to the test
            raised.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(timeout=20.0)
    assert not thread.is_alive(), "it waits"
    return raised[0] if raised else None


@pytest.mark.parametrize("reader", READERS)
def test_no_reader_waits_for_what_is_no_file(irregular: str, reader: str) -> None:
    error = ends(lambda: READERS[reader](irregular))
    assert isinstance(error, ValueError)
    assert irregular in str(error)
    assert "not a file" in str(error)


def test_a_file_that_is_never_ready(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As /proc/kmsg, a file by its mode whose reader waits for the kernel's next message."""
    reader, writer = os.pipe()
    os.set_blocking(reader, False)
    path = tmp_path / "x"
    path.touch()
    regular = path.stat()
    monkeypatch.setattr("miho.regular_file.os.open", lambda *_: reader)
    monkeypatch.setattr("miho.regular_file.os.fstat", lambda _: regular)
    with pytest.raises(NotAFileError, match="not a file with an end"):
        read_regular(path)
    os.close(writer)


@pytest.mark.skipif(not os.access("/proc/kmsg", os.R_OK), reason="/proc/kmsg cannot be read")
def test_messages_of_the_kernel() -> None:
    assert isinstance(ends(lambda: read_regular("/proc/kmsg", 1 << 20)), ValueError | OSError)
