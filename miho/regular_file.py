"""Reading of regular files; paths of pipes and devices are refused, because reads could block."""

from __future__ import annotations

import os
import stat
from pathlib import Path

CHUNK = 1 << 20
NO_WAITING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


class NotAFileError(ValueError):
    """Error for a path that is not a regular file with an end, in one line."""


def check_regular(path: str | os.PathLike[str]) -> None:
    """Raise NotAFileError unless a path is a regular file, and FileNotFoundError if missing."""
    _check_mode(path, Path(path).stat().st_mode)


def read_regular(path: str | os.PathLike[str], limit: int | None = None) -> bytes:
    """Return the bytes of a file, at most `limit`; links are followed.

    The call never blocks. Pipes and devices are refused without opening them. A file without an
    end, for example /proc/kmsg, has the mode of a regular file and is refused by a read that would
    block. Raises NotAFileError in these cases, and OSError of opening or reading.
    """
    check_regular(path)  # opening a device may have side effects
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
