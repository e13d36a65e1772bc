"""R13: malformed, mutated and enormous files of data and results."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np
import pytest

from miho.data import CSVError, load_csv
from miho.vehicle.data.tir_sampling import embedded_tire
from miho.vehicle.models import TirError
from miho.vehicle.models.tir import load_tir
from miho.vehicle.models.tir_reader import read_tir
from tests.faults.conftest import Figures
from tests.faults.hostile_files import LARGE, RESULTS, refuse_large, survive_results

COLUMNS = ("alpha", "Fy")
HEADER = "alpha,Fy,note"
GOOD = "\n".join([HEADER, *(f"{0.01 * i:.2f},{-400 * i},run {i}" for i in range(-9, 10))]) + "\n"
TIRE = embedded_tire("lf").read_bytes()

ROWS = [
    "", " ", ",", ",,", ",,,", "0.1", "0.1,-300", "0.1,-300,x,", "0.1,,x", '0.1,"",x', "0.1,NaN,x",
    "0.1,N/A,x", "inf,-300,x", "0.1,-3e999,x", "0.1,-300 N,x", '"0,1",-300,x', "0,1,-300,x",
    "0.1;-300;x", "0.1\t-300\tx", '0.1,"-3,000",x', "0.1,-3_000,x", "0.1,0x10,x", "0.1,-3.0.0,x",
    "0.1,--300,x", "0.1,\u22123,x", "0.1,\uff13,x", '0.1,"-300,x', '0.1,-3"00",x', "0.1,\x00,x",
    "0.1,1+2j,x", "0.1,=1+1,x", "rad,N,-", HEADER,
]  # fmt: skip
"""Rows that each spoil a good table."""

LINES = [
    "PCY1 : 1.6", "PCY1 1.6", "PCY1 =", "PCY1 = x", "PCY1 = '1.6'", "PCY1 = 1,6", "PCY1 = 1.6.0",
    "PCY1 = 1.6 -", "PCY1 = 1.6D0", "PCY1 = nan", "PCY1 = inf", "PCY1 = 1e400", "PCY1 = 2*0.8",
    "PYC1 = 1.6", "A0 = 1.6", "$PCY1 = 1.6", "", "[LATERAL_COEFFICIENTS]", "[LATERAL", "LATERAL]",
    "[] ", "PCY1 = 1.6\nPCY1 = 1.6", "= 1.6", "PCY1 = \x1b[31m", "PCY1 = 0x1", "PCY1 = 1_6",
    "PCY1 = \uff11", "<html>",
]  # fmt: skip
"""Lines that each spoil a property file in the place of PCY1."""

MUTATIONS = 250
BYTES = b"0123456789.,;:-+eE=$!#'\"[]{}() \t\r\n\x00\x0c\x85\xa0\xff_*/abNn"
SECONDS, MEMORY = 1.0, 200e6
MESSAGE = re.compile(r":[1-9]\d*:[1-9]\d*: \S.*; \S.*")


@pytest.mark.slow
@pytest.mark.fault(
    row="R13",
    fault=f"{len(ROWS) + len(LINES)} malformed CSV and .tir files, {2 * MUTATIONS} mutations, "
    f"{len(LARGE)} enormous files, {len(RESULTS)} hostile results",
    promise="all refused with file:line:column and a remedy, 0 silently wrong; "
    f"< {SECONDS:g} s and < {MEMORY / 1e6:g} MB",
)
def test_malformed(tmp_path: Path, measured: Figures) -> None:
    """60 spoilt files and 500 mutated ones; then files that are large or say that they are."""
    rng = np.random.default_rng(13)
    table, tire = tmp_path / "my.csv", tmp_path / "my.tir"
    lines = GOOD.splitlines()
    spoilt = 0
    for row in ROWS:
        table.write_text("\n".join([*lines[:3], row, *lines[3:]]), encoding="utf-8")
        spoilt += _csv(table) == "refused"
    for line in LINES:
        text, count = re.subn(rb"(?m)^PCY1\b.*$", line.encode(), TIRE)
        tire.write_bytes(text)
        spoilt += count == 1 and _tir(tire) == "refused"
    mutated = {"refused": 0, "as it says": 0, "wrong": 0}
    for _ in range(MUTATIONS):
        table.write_bytes(_mutated(GOOD.encode(), rng))
        mutated[_csv(table)] += 1
        tire.write_bytes(_mutated(TIRE, rng))
        mutated[_tir(tire)] += 1
    seconds, memory, large = refuse_large(tmp_path)
    results = survive_results(tmp_path / "runs", SECONDS)
    cases = len(ROWS) + len(LINES)
    measured(
        f"{spoilt} of {cases} refused; of the mutations {mutated['refused']} refused, "
        f"{mutated['as it says']} read as they say, {mutated['wrong']} wrong; {large} of "
        f"{len(LARGE)} enormous ones refused in {seconds:.2f} s and {memory / 1e6:.0f} MB each; "
        f"{results} of {len(RESULTS)} results skipped or read"
    )
    assert spoilt == cases
    assert not mutated["wrong"]
    assert large == len(LARGE)
    assert seconds < SECONDS
    assert memory < MEMORY
    assert results == len(RESULTS)


def _csv(path: Path) -> str:
    try:
        read = load_csv(str(path), COLUMNS, ("rad", "N"), "Fy", ranges={"alpha": None, "Fy": None})
    except CSVError as error:
        return _judged(error, path)
    except ValueError:
        return "wrong"
    text = io.StringIO(path.read_bytes().decode("utf-8-sig"), newline=None)
    header, *rows = [row for row in csv.reader(text, skipinitialspace=True) if row]
    while rows and not "".join(rows[-1]).strip():
        rows.pop()
    names = [name.strip() for name in header]
    plain = {name: [float(row[names.index(name)]) for row in rows] for name in COLUMNS}
    return "as it says" if plain == {n: read[n].tolist() for n in COLUMNS} else "wrong"


def _tir(path: Path) -> str:
    try:
        load_tir(path)
    except TirError as error:
        return _judged(error, path)
    except ValueError:
        return "wrong"
    found = {
        (section, key): value
        for section, entries in read_tir(path).sections.items()
        for key, value in entries.items()
        if isinstance(value, float)
    }
    return "as it says" if found == _plain_tir(path.read_bytes().decode("latin-1")) else "wrong"


def _plain_tir(text: str) -> dict[tuple[str, str], float]:
    """Every KEY = number of a file in SI units, by section, read the simple way."""
    plain: dict[tuple[str, str], float] = {}
    section = ""
    for line in re.split(r"\r\n|\r|\n", text):
        entry = re.split("[$!#]", line)[0].strip()
        if entry.startswith("["):
            section = entry[1:-1].strip().upper()
        elif "=" in entry and not (section == "MDI_HEADER" and entry[0] in "({'\""):
            key, _, value = entry.partition("=")
            if "'" not in value and '"' not in value:
                plain[section, key.strip().upper()] = float(value)
    return plain


def _judged(error: Exception, path: Path) -> str:
    message = str(error)
    good = message.isprintable() and MESSAGE.fullmatch(message.removeprefix(str(path)))
    return "refused" if good else "wrong"


def _mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """`content` after one to three edits of bytes or lines."""
    for _ in range(rng.integers(1, 4)):
        lines = content.split(b"\n")
        at, row, other = (int(rng.integers(n)) for n in (len(content), len(lines), len(lines)))
        byte = bytes([BYTES[rng.integers(len(BYTES))]])
        flipped = bytes([content[at] ^ 1 << int(rng.integers(8))])
        edits = [
            content[:at] + byte + content[at + 1 :],
            content[:at] + byte + content[at:],
            content[:at] + content[at + 1 + int(rng.integers(4)) :],
            content[:at] + flipped + content[at + 1 :],
            content[: at + 1],
            b"\n".join([*lines[:row], lines[row], *lines[row:]]),
            b"\n".join([*lines[:row], *lines[row + 1 :]]),
            b"\n".join([*lines[:row], lines[other], *lines[row + 1 :]]),
        ]
        content = edits[rng.integers(len(edits))] or b"\n"
    return content
