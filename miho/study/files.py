"""Files of a run: written atomically, and read with their checksums.

A signed JSON file has the key `sha256`, the checksum of the canonical text of all other keys. It
detects damage, not forgery.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
from collections.abc import Mapping
from hashlib import sha256 as digest_of
from pathlib import Path
from typing import Any

import orjson

from miho.study.identity import canonical, sha256

CONFIG, ENVIRONMENT, CURVE, RESULT = "config.json", "environment.json", "curve.json", "result.json"
PARTIAL = "partial.json"
JOURNAL = "journal"
LARGEST = 256 << 20
"""Largest file of a run [bytes]; larger files are not read."""
LARGEST_SETTINGS = 1 << 20
DEEPEST_SETTINGS = 50
"""Largest size [bytes] and nesting of a configuration or environment. Code that compares or shows
them recurses once per level."""
CHUNK = 32 << 10
FLAGS = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
MALFORMED = (ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""Exceptions of decoding or reading a file with unexpected contents."""


class DamagedRun(Exception):  # noqa: N818 -- a finding about a folder, reported and skipped
    """The files of a run folder do not match their checksums."""


class NoResult(DamagedRun):
    """The run folder has no result: the run is not finished."""


def read_checked(folder: str) -> tuple[dict[str, Any], dict[str, bytes]]:
    """The result of a run and the bytes of its other files, all verified by their checksums.

    Raises NoResult if the run is not finished, and DamagedRun with the reason for any mismatch.
    """
    try:
        result = read_signed(f"{folder}/{RESULT}")
    except FileNotFoundError:
        raise NoResult(f"{folder}: has no {RESULT}") from None
    except OSError as error:
        raise DamagedRun(f"{folder}/{RESULT}: {error.strerror}") from None
    try:
        files, digests = {}, result["files"]
        for name in (CONFIG, ENVIRONMENT, CURVE):
            limit = LARGEST if name == CURVE else LARGEST_SETTINGS
            data = files[name] = read_bytes(f"{folder}/{name}", limit)
            if digest_of(data).hexdigest() != digests[name]:
                raise DamagedRun(f"{folder}/{name}: checksum does not match")
            if name != CURVE and not data.startswith(b"{"):
                raise DamagedRun(f"{folder}/{name}: contains no settings")
            if name != CURVE and nesting(data) > DEEPEST_SETTINGS:
                deepest = f"nested deeper than {DEEPEST_SETTINGS} levels"
                raise DamagedRun(f"{folder}/{name}: {deepest}")
        place = f"{result['problem']}/{result['optimizer']}/{result['id']}"
    except OSError as error:
        raise DamagedRun(f"{error.filename or folder}: {error.strerror}") from None
    except MALFORMED as error:
        raise DamagedRun(f"{folder}: {type(error).__name__}: {error}") from None
    if not f"/{folder}".endswith(f"/{place}"):
        raise DamagedRun(f"{folder}: contains the run {place}")
    return result, files


def signed(contents: Mapping[str, Any]) -> str:
    """Text of a file with these contents and their checksum."""
    return canonical({**contents, "sha256": sha256(canonical(contents))})


def read_signed(path: str) -> dict[str, Any]:
    """Contents of a file that `signed` wrote; raises DamagedRun if its checksum does not match."""
    data = read_bytes(path, LARGEST)
    try:
        contents: dict[str, Any] = decoded(data)
        checksum = contents.pop("sha256")
        unsigned = data.replace(f',"sha256":"{checksum}"'.encode(), b"", 1)
        if digest_of(unsigned).hexdigest() == checksum:
            return contents
    except MALFORMED as error:
        raise DamagedRun(f"{path}: {type(error).__name__}: {error}") from None
    raise DamagedRun(f"{path}: checksum does not match")


def decoded(data: bytes) -> Any:
    """Value of a JSON text; raises ValueError or RecursionError.

    orjson is eight times as fast as Python's reader, which also accepts lone surrogates.
    """
    try:
        return orjson.loads(data)
    except ValueError:
        return json.loads(data)


TOKENS = re.compile(rb'"(?:[^"\\]|\\.)*"|[\[\]{}]')


def nesting(data: bytes) -> int:
    """Nesting depth of a JSON text, without decoding it; 0 if it cannot be too deep."""
    if data.count(b"{") + data.count(b"[") <= DEEPEST_SETTINGS:
        return 0
    depth = deepest = 0
    for token in TOKENS.findall(data):
        if token in b"[{":
            depth += 1
            deepest = max(deepest, depth)
        elif token in b"]}":
            depth -= 1
    return deepest


def read_bytes(path: str, limit: int) -> bytes:
    """Read a whole file; raises OSError for a symbolic link and for a file larger than the limit.

    A pipe gives nothing or an error, so that no reader blocks.
    """
    descriptor = os.open(path, FLAGS)
    try:
        first = os.read(descriptor, CHUNK)
        if len(first) < CHUNK:  # the whole file
            return first
        chunks, size = [first], len(first)
        while chunk := os.read(descriptor, CHUNK):
            chunks.append(chunk)
            size += len(chunk)
            if size > limit:
                raise OSError(errno.EFBIG, f"is larger than {limit >> 20} MiB", path)
    finally:
        os.close(descriptor)
    return b"".join(chunks)


def write_text(path: Path, text: str, *, last: bool = True) -> None:
    """Write a text in UTF-8 by `write_bytes`."""
    write_bytes(path, text.encode(), last=last)


def write_bytes(path: Path, data: bytes, *, last: bool = True) -> None:
    """Replace a file atomically: readers see the old file or the complete new one.

    An existing link is replaced, and nothing is written through it.

    Parameters
    ----------
    path : Path
        The file.
    data : bytes
        Its new contents.
    last : bool
        Whether to sync the folder, which makes the names of all its files permanent.

    Raises
    ------
    OSError
        If the file cannot be written; the error names it.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.unlink(missing_ok=True)
        with temporary.open("xb") as file:  # never through an existing link
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        if last:
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
