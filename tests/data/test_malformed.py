"""Malformed and mutated files: one line with the place and a remedy, and never a wrong number."""

import csv
import io
import re
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from miho.data import CSVError, Dataset, load_csv
from miho.vehicle.data import sample_tir
from miho.vehicle.data.tir_sampling import embedded_tire
from miho.vehicle.models.tir import load_tir
from miho.vehicle.models.tir_reader import TirError, read_tir

COLUMNS = ["alpha", "Fy", "Fz"]
TIRE = sample_tir("lf", n=40)
ROWS = [
    ",".join(f"{TIRE[name][row]:.6g}" for name in COLUMNS) + ",run 1" for row in range(len(TIRE))
]
HEADER = "alpha,Fy,Fz,note"
GOOD = "\n".join([HEADER, *ROWS, ""])
LF = embedded_tire("lf").read_bytes()


def load(path: Path) -> Dataset:
    return load_csv(str(path), COLUMNS, ["rad", "N", "N"], "Fy")


def first(row: str) -> str:
    """The good file with another first row of data, line 2."""
    return "\n".join([HEADER, row, *ROWS])


def head(header: str) -> str:
    return "\n".join([header, *ROWS])


def column(name: str, change: Callable[[float], object]) -> str:
    """The good file with another column."""
    position = COLUMNS.index(name)
    lines = [HEADER]
    for row in ROWS:
        cells = row.split(",")
        cells[position] = str(change(float(cells[position])))
        lines.append(",".join(cells))
    return "\n".join(lines)


def worst(name: str) -> int:
    """The line of the largest magnitude."""
    return int(np.argmax(np.abs(TIRE[name]))) + 2


CSV: dict[str, tuple[str | bytes, str, str]] = {
    # (content, line:column, words of the message)
    "nothing": ("", "1:1", "the file is empty"),
    "blank lines only": ("\n \n\n", "1:1", "the file is empty"),
    "a byte order mark only": (b"\xef\xbb\xbf", "1:1", "the file is empty"),
    "a header only": (HEADER, "1:1", "no rows of data"),
    "no header": ("\n".join(ROWS).replace("run 1", "1"), "1:1", "begin the file with a line"),
    "another name": (head("SA,Fy,Fz,note"), "1:1", "no column 'alpha' in the header 'SA,Fy"),
    "another case": (head("Alpha,Fy,Fz,note"), "1:1", "set headers=[..., 'Alpha', ...]"),
    "a name twice": (head("alpha,Fy,Fz,Fy"), "1:13", "'Fy' appears twice; keep one"),
    "a short header": (head("alpha,Fy,Fz"), "2:1", "4 cells; every row must have 3"),
    "a row of units": (first("rad,N,N,-"), "2:1", "'rad' in column 'alpha' is not a finite"),
    "a title above": ("My tire\n" + GOOD, "1:1", "no column 'alpha' in the header 'My tire'"),
    "a blank first line": ("\n" + GOOD, "1:1", "no column 'alpha' in the header ''"),
    "bars": (GOOD.replace(",", "|"), "1:1", "separate columns with commas"),
    "semicolons in the header": (head(HEADER.replace(",", ";")), "2:1", "1 cells; every row must"),
    "spaces": (GOOD.replace(",", " "), "1:1", "separate columns with commas"),
    "decimal commas": (first("0,1,-3000,2600,x"), "2:1", "5 cells; every row must have 4; add or"),
    "a quoted decimal comma": (first('"0,1",-3000,2600,x'), "2:1", "'0,1' in column 'alpha'"),
    "a thousands separator": (first('0.1,"-3,000",2600,x'), "2:5", "'-3,000' in column 'Fy'"),
    "a blank line inside": (first(""), "2:1", "1 cells; every row must have 4; remove the empty"),
    "a row cut short": (first("0.1,-300"), "2:1", "2 cells; every row must have 4"),
    "a row too long": (first("0.1,-300,2600,x,"), "2:1", "5 cells"),
    "an empty cell": (first("0.1,,2600,x"), "2:5", "'' in column 'Fy' is not a finite number"),
    "a blank cell": (first("0.1,  ,2600,x"), "2:5", "'' in column 'Fy'"),
    "an empty quoted cell": (first('0.1,"",2600,x'), "2:5", "'' in column 'Fy'"),
    "text": (first("0.1,-3000 N,2600,x"), "2:5", "'-3000 N' in column 'Fy'"),
    "NaN": (first("0.1,NaN,2600,x"), "2:5", "'NaN' in column 'Fy'"),
    "a missing value": (first("0.1,N/A,2600,x"), "2:5", "'N/A' in column 'Fy'"),
    "infinity": (first("-inf,-3000,2600,x"), "2:1", "'-inf' in column 'alpha'"),
    "overflow": (first("0.1,-3e999,2600,x"), "2:5", "'-3e999' in column 'Fy'"),
    "hexadecimal": (first("0x1,-3000,2600,x"), "2:1", "'0x1'"),
    "an underscore": (first("0.1,-3_000,2600,x"), "2:5", "'-3_000'"),
    "a complex number": (first("0.1j,-3000,2600,x"), "2:1", "'0.1j'"),
    "a Fortran exponent": (first("1d-1,-3000,2600,x"), "2:1", "'1d-1'"),
    "a minus from a typesetter": (first("0.1,−3000,2600,x"), "2:5", "in column 'Fy'"),
    "digits of another script": (first("0.1,-3000,٣,x"), "2:11", "in column 'Fz'"),
    "a no-break space": (first("0.1,-3000\u00a0,2600,x"), "2:5", "in column 'Fy'"),
    "two signs": (first("0.1,--3000,2600,x"), "2:5", "'--3000'"),
    "two numbers": (first("0.1,-3000 5,2600,x"), "2:5", "'-3000 5'"),
    "a formula": (first("0.1,=B3,2600,x"), "2:5", "'=B3'"),
    "a date": (first("2026-01-01,-3000,2600,x"), "2:1", "'2026-01-01'"),
    "an open quote": (first('0.1,"-3000,2600,x'), "2:5", "never closed; quote whole cells"),
    "a quote inside": (first('0.1,-3"000,2600,x'), "2:7", "quote inside a cell"),
    "text after a quote": (first('0.1,"-3000"N,2600,x'), "2:5", "quote inside a cell"),
    "a line break in quotes": (first('0.1,-3000,2600,"a\nb"'), "2:16", "on one line"),
    "an open quote in the header": (head('alpha,"Fy,Fz,note'), "1:7", "never closed"),
    "NUL": (first("0.1,-30\x0000,2600,x"), "2:8", "control character '\\x00'"),
    "a form feed": (first("0.1,-3000\x0c,2600,x"), "2:10", "control character '\\x0c'"),
    "a separator of files": (first("0.1,-3000,2600\x1c,x"), "2:15", "control character '\\x1c'"),
    "UTF-16": (GOOD.encode("utf-16"), "1:1", "UTF-16 text; save the file as UTF-8"),
    "UTF-16 without a mark": (GOOD.encode("utf-16-le"), "1:2", "control character '\\x00'"),
    "Latin-1": (first("0.1,-3000,2600,läuft").encode("latin-1"), "2:17", "not UTF-8 text; save"),
    "a spreadsheet": (b"PK\x03\x04\x14\x00\x06\x00", "1:3", "control character"),
    "an image": (b"\x89PNG\r\n\x1a\n", "1:1", "not UTF-8"),
    "a long line": (first("0.1,-3000,2600," + "x" * 10_000), "2:10000", "longer than 10000"),
    "a web page": ("<!DOCTYPE html>\n<html>", "1:1", "no column 'alpha' in the header '<!DOC"),
    "degrees": (
        column("alpha", np.degrees),
        f"{worst('alpha')}:1: ",
        "is the column in deg or mrad?",
    ),
    "kilonewtons": (
        column("Fy", lambda F: F / 1e3),
        f"{worst('Fy')}:",
        "is the column in kN, daN, lbf or kgf?",
    ),
    "a load in kilonewtons": (
        column("Fz", lambda F: F / 1e3),
        f"{worst('Fz')}:",
        "is the column in kN, daN or kgf?",
    ),
    "a rising force": (
        column("Fy", lambda F: -F),
        "1:7",
        "; set convention=adapted-sae or flip=[alpha] or flip=[Fy]",
    ),
    "a negative load": (column("Fz", lambda F: -F), "1:10", "Fz is mostly negative"),
    "a constant force": (column("Fy", lambda _: -3000.0), "1:7", "the same value in every row"),
    "a wild cell": (first("0.1,-3e9,2600,x"), "2:5", "largest |Fy| is 3e+09 N"),
}


@pytest.mark.parametrize("case", CSV)
def test_malformed_csv(tmp_path: Path, case: str) -> None:
    content, place, words = CSV[case]
    path = tmp_path / "my.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(CSVError) as caught:
        load(path)
    check_line(caught.value, path)
    assert str(caught.value).startswith(f"{path}:{place}")
    assert words in str(caught.value)


def line(start: bytes, replacement: bytes) -> bytes:
    """The LF tire with another line in the place of the one that begins so."""
    changed, count = re.subn(rb"(?m)^" + re.escape(start) + rb"(?=\s|$).*$", replacement, LF)
    assert count == 1
    return changed


TIR: dict[str, tuple[bytes, str]] = {
    "a CSV": (GOOD.encode(), ":1:1: 'alpha,Fy,Fz,note' before the first section; begin with"),
    "UTF-16": (LF.decode("latin-1").encode("utf-16"), ":1:4: control character '\\x00'"),
    "cut in a number's line": (
        LF[: LF.index(b"PKY1") + 6],
        "'PKY1' is not of the form KEY = value",
    ),
    "cut in a section's name": (LF[: LF.index(b"[LATERAL") + 5], "is not a section header"),
    "cut in half": (LF[: len(LF) // 2], "; add"),
    "a mirrored section": (LF + b"[lateral_coefficients]\n", "is already in line"),
    "a colon for an equals sign": (line(b"PCY1", b"PCY1 : 1.6"), "add the '='"),
    "a unit behind a number": (line(b"FNOMIN", b"FNOMIN = 3114 N"), "'3114 N' is not a number"),
    "a quoted number": (
        line(b"FNOMIN", b"FNOMIN = '3114'"),
        "for FNOMIN, got the text '3114'; write",
    ),
    "a Fortran exponent": (line(b"FNOMIN", b"FNOMIN = 3.1D3"), "'3.1D3' is not a number"),
    "a thousands separator": (line(b"FNOMIN", b"FNOMIN = 3,114"), "'3,114' is not a number"),
    "two dots": (line(b"FNOMIN", b"FNOMIN = 3.11.4"), "'3.11.4' is not a number"),
    "a formula": (line(b"FNOMIN", b"FNOMIN = 2*1557"), "'2*1557' is not a number"),
    "a negative load": (line(b"FNOMIN", b"FNOMIN = -3114"), "correct the value"),
    "a huge number": (line(b"FNOMIN", b"FNOMIN = 1e400"), "not a finite number; write a smaller"),
    "a load that overflows": (
        line(b"FORCE", b"FORCE = 'kN'").replace(b"= 3114.0", b"= 1e307"),
        "is not finite in SI units",
    ),
    "no unit of force": (line(b"FORCE", b"! FORCE"), "[UNITS] lacks FORCE; add FORCE = 'newton'"),
    "another unit of force": (line(b"FORCE", b"FORCE = 'pond'"), "use one of newton"),
    "a misspelt coefficient": (line(b"PCY1", b"PYC1 = 1.6"), "key PYC1 is unknown"),
    "a coefficient of another model": (line(b"PCY1", b"A0 = 1.6"), "key A0 is unknown in [LAT"),
    "a coefficient in a comment": (line(b"PCY1", b"$PCY1 = 1.6"), "lacks PCY1, which MF 6.1"),
    "an unknown fit type": (line(b"FITTYP", b"FITTYP = 70"), "use one of 5, 6, 21"),
    "a fit type of an older model": (line(b"FITTYP", b"FITTYP = 6"), "; "),
    "a table without rows of two": (LF + b"[SHAPE]\n{radial width}\n1 2 3\n", "write 2 numbers"),
    "a table with a word": (LF + b"[SHAPE]\n{radial width}\n1 wide\n", "'wide' is not a number"),
    "a table named twice": (LF + b"[SHAPE]\n{a b}\n{a b}\n", "column names after the first"),
    "text behind a section": (line(b"[VERTICAL]", b"[VERTICAL] = 3"), "is not a section header"),
    "an open section": (LF.replace(b"[VERTICAL]", b"[VERTICAL"), "write [NAME] alone"),
    "an escape character": (LF.replace(b"[VERTICAL]", b"\x1b[VERTICAL]"), "control character"),
    "a web page": (b"<!DOCTYPE html>\n<html>", "before the first section; begin with"),
}


@pytest.mark.parametrize("case", TIR)
def test_malformed_tir(tmp_path: Path, case: str) -> None:
    content, words = TIR[case]
    path = tmp_path / "my.tir"
    path.write_bytes(content)
    with pytest.raises(TirError) as caught:
        load_tir(path)
    check_line(caught.value, path)
    assert words in str(caught.value)


def check_line(error: Exception, path: Path) -> None:
    """`path:line:column: problem; remedy` on one line."""
    assert str(error).isprintable()
    assert re.fullmatch(r":[1-9]\d*:[1-9]\d*: \S.*; \S.*", str(error).removeprefix(str(path)))


def test_there_are_enough_cases() -> None:
    assert len(CSV) + len(TIR) >= 60
    assert len({str(content) for content, *_ in (*CSV.values(), *TIR.values())}) == (
        len(CSV) + len(TIR)
    )


BYTES = b"0123456789.,;:-+eE=$!#'\"[]{}() \t\r\n\x00\x0c\x1c\x85\xa0\xff\xc2_*/abNn"
EDITS = st.lists(
    st.tuples(
        st.sampled_from(["replace", "insert", "delete", "flip", "cut", "repeat", "drop", "swap"]),
        st.floats(0, 1, exclude_max=True),
        st.integers(0, 2**16),
    ),
    min_size=1,
    max_size=3,
)
MUTATIONS = settings(
    max_examples=500,
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def mutated(content: bytes, edits: list[tuple[str, float, int]]) -> bytes:
    """`content` after edits of bytes and lines: what, where (a fraction of it), and a choice."""
    for what, place, choice in edits:
        lines = content.split(b"\n")
        at, row = int(place * len(content)), int(place * len(lines))
        match what:
            case "replace" | "insert":
                byte = BYTES[choice % len(BYTES)]
                content = content[:at] + bytes([byte]) + content[at + (what == "replace") :]
            case "delete":
                content = content[:at] + content[at + 1 + choice % 4 :]
            case "flip":
                flipped = bytes([content[at] ^ 1 << choice % 8]) if content else b""
                content = content[:at] + flipped + content[at + 1 :]
            case "cut":
                content = content[:at]
            case "repeat":
                content = b"\n".join([*lines[:row], lines[row], *lines[row:]])
            case "drop":
                content = b"\n".join([*lines[:row], *lines[row + 1 :]])
            case _:
                other = choice % len(lines)
                lines[row], lines[other] = lines[other], lines[row]
                content = b"\n".join(lines)
    return content


def plainly_read_csv(content: bytes) -> dict[str, list[float]]:
    """What Python's own reader makes of the text: the meaning of a file that is accepted."""
    text = io.StringIO(content.decode("utf-8-sig"), newline=None)
    header, *rows = [row for row in csv.reader(text, skipinitialspace=True) if row]
    while rows and not "".join(rows[-1]).strip():
        rows.pop()
    names = [name.strip() for name in header]
    return {name: [float(row[names.index(name)]) for row in rows] for name in COLUMNS}


@pytest.mark.slow
@MUTATIONS
@given(edits=EDITS)
def test_mutated_csv(tmp_path: Path, edits: list[tuple[str, float, int]]) -> None:
    """Refused with a place, or exactly the numbers that stand in the text, such as a new digit."""
    content = mutated(GOOD.encode(), edits)
    path = tmp_path / "my.csv"
    path.write_bytes(content)
    try:
        read = load(path)
    except CSVError as error:
        check_line(error, path)
    else:
        assert {name: read[name].tolist() for name in COLUMNS} == plainly_read_csv(content)


def plainly_read_tir(content: bytes) -> dict[tuple[str, str], float]:
    """Every KEY = number of a file in SI units, by section, read the simple way."""
    numbers: dict[tuple[str, str], float] = {}
    section = ""
    for text in re.split(r"\r\n|\r|\n", content.decode("latin-1")):
        text = re.split("[$!#]", text)[0].strip()
        if text.startswith("["):
            section = text[1:-1].strip().upper()
        elif "=" in text and not (section == "MDI_HEADER" and text[0] in "({'\""):
            key, _, value = text.partition("=")
            if "'" not in value and '"' not in value:
                numbers[section, key.strip().upper()] = float(value)
    return numbers


@pytest.mark.slow
@MUTATIONS
@given(edits=EDITS)
def test_mutated_tir(tmp_path: Path, edits: list[tuple[str, float, int]]) -> None:
    content = mutated(LF, edits)
    path = tmp_path / "my.tir"
    path.write_bytes(content)
    try:
        tire = load_tir(path)
    except TirError as error:
        check_line(error, path)
        return
    plain = plainly_read_tir(content)
    read = read_tir(path).sections
    numbers: dict[tuple[str, str], Any] = {
        (section, key): value
        for section, entries in read.items()
        for key, value in entries.items()
        if isinstance(value, float)
    }
    assert numbers == plain
    for (_, key), value in plain.items():  # what is asked of the tire is what was read
        assert getattr(tire.parameters, key, value) == value


@pytest.mark.parametrize("kind", ["sparse", "one line"])
def test_a_gigabyte_is_refused_unread(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "huge"
    with path.open("wb") as stream:
        stream.write(b"alpha,Fy,Fz\n" if kind == "sparse" else b"1" * 2**20)
        stream.truncate(10**9 + 20 if kind == "one line" else 2**30)
    tracemalloc.start()
    started = time.perf_counter()
    with pytest.raises(CSVError, match="huge:1:1: larger than 64 MiB; split the file"):
        load(path)
    with pytest.raises(TirError, match="huge:1:1: is larger than 4194304 bytes; "):
        load_tir(path)
    seconds = time.perf_counter() - started
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert seconds < 1.0
    assert peak < 200e6
