"""Reading files that a user names: the path of a pipe or a device must not hold the program up."""

from __future__ import annotations

import os
import stat
from pathlib import Path

CHUNK = 1 << 20
NO_WAITING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


class NotAFileError(ValueError):
    """A path that names something else than a file with an end; one line with the path."""


def check_regular(path: str | os.PathLike[str]) -> None:
    """Raise NotAFileError for a folder, pipe, device or socket, FileNotFoundError for nothing."""
    _check_mode(path, Path(path).stat().st_mode)


def read_regular(path: str | os.PathLike[str], limit: int | None = None) -> bytes:
    """The bytes of a file, at most `limit` of them; links are followed.

    Nothing is waited for: a pipe or device is refused unopened, and so is a file without an end
    that is ready to be read, such as /proc/kmsg, which its mode does not tell. Raises
    NotAFileError for these, and the OSError of opening or reading.
    """
    check_regular(path)  # opening a device can do something to it already
    chunks: list[bytes] = []
    size = 0
    with os.fdopen(os.open(path, NO_WAITING), "rb", buffering=0) as stream:
        _check_mode(path, os.fstat(stream.fileno()).st_mode)
        while limit is None or size < limit:
            chunk = stream.read(CHUNK if limit is None else min(CHUNK, limit - size))
            if chunk is None:
                raise NotAFileError(f"{_printable(path)}: is not a file with an end; name a file")
            if not chunk:
                break
            chunks.append(chunk)
            size += len(chunk)
    return b"".join(chunks)


def _check_mode(path: str | os.PathLike[str], mode: int) -> None:
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a pipe, device or socket"
        raise NotAFileError(f"{_printable(path)}: is not a file but {kind}; name a file")


def _printable(path: str | os.PathLike[str]) -> str:
    text = os.fspath(path)
    return text if text.isprintable() else repr(text)
