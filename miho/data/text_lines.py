"""The lines of a text file, within limits of size."""

from __future__ import annotations

import re
from pathlib import Path

from miho.regular_file import NotAFileError, read_regular

MAX_BYTES = 64 * 2**20
MAX_LINE = 10_000
MAX_ROWS = 4_000_000
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")


class CSVError(ValueError):
    """A fault in a CSV file: file, line, column, problem and remedy in one line.

    Parameters
    ----------
    path : Path
        The file.
    line, column : int
        Position of the fault, from 1.
    problem : str
        The problem and the remedy.
    """

    def __init__(self, path: Path, line: int, column: int, problem: str) -> None:
        name = str(path) if str(path).isprintable() else repr(str(path))
        super().__init__(f"{name}:{line}:{column}: {problem}")


def lines_of(path: Path) -> list[str]:
    """Lines of a text file without empty lines at its end; raises CSVError for other files."""
    # Read a regular file within the size limit.
    try:
        large = path.stat().st_size > MAX_BYTES
        data = b"" if large else read_regular(path, MAX_BYTES + 1)
    except NotAFileError:
        raise CSVError(path, 1, 1, "is not a file; give one") from None
    except PermissionError:
        raise CSVError(path, 1, 1, "cannot be read; check its permissions") from None
    if large or len(data) > MAX_BYTES:
        raise CSVError(path, 1, 1, f"larger than {MAX_BYTES >> 20} MiB; split the file")
    # Decode UTF-8 text, with or without a byte order mark.
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise CSVError(path, 1, 1, "UTF-16 text; save the file as UTF-8")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        column = error.start - data.rfind(b"\n", 0, error.start)
        remedy = "save the file as UTF-8, or convert it, for example by iconv -f latin1 -t utf-8"
        raise CSVError(path, line, column, f"not UTF-8 text; {remedy}") from None
    del data

    # Check the number and length of lines, and refuse control characters.
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if text.count("\n") > MAX_ROWS:
        raise CSVError(path, MAX_ROWS, 1, f"more than {MAX_ROWS} lines; split the file")
    lines = text.split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise CSVError(path, 1, 1, "the file is empty; give rows of numbers")
    control = _CONTROL.search(text)
    for number, row in enumerate(lines, start=1):
        if len(row) > MAX_LINE:
            problem = f"line longer than {MAX_LINE} characters; split it"
            raise CSVError(path, number, MAX_LINE, problem)
        if control and (match := _CONTROL.search(row)):
            problem = f"control character {match[0]!r}; save the file as plain UTF-8 text"
            raise CSVError(path, number, match.start() + 1, problem)
    return lines
