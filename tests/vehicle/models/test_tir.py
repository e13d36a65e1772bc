from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from miho.vehicle.data.tir_sampling import EMBEDDED_RANGES, embedded_tire
from miho.vehicle.models.tir import load_tir, write_tir
from miho.vehicle.models.tir_format import KEYS
from miho.vehicle.models.tir_reader import MAX_BYTES, MAX_LINE, PropertyFile, TirError, read_tir

LF = embedded_tire("lf").read_text(encoding="latin-1")


def saved(tmp_path: Path, content: str | bytes) -> Path:
    path = tmp_path / "tire.tir"
    path.write_bytes(content if isinstance(content, bytes) else content.encode("latin-1"))
    return path


def edited(pattern: str, replacement: str) -> str:
    text, count = re.subn(pattern, replacement, LF, count=1, flags=re.MULTILINE)
    assert count == 1, pattern
    return text


def line_of(start: str) -> int:
    lines = LF.split("\n")
    return next(i for i, line in enumerate(lines, start=1) if line.startswith(start))


VALUE_COLUMN = 23  # of the embedded files

# (edit of the LF tire, line start or line number, column, words in the message)
MALFORMED = {
    "text for a number": (edited(r"^PDY1 .*", "PDY1 = 'x'"), "PDY1", 8, "text"),
    "decimal comma": (edited(r"1\.68", "1,68"), "PDY1", VALUE_COLUMN, "'1,68' is not a number"),
    "two numbers": (edited(r"1\.68", "1.68 1.7"), "PDY1", VALUE_COLUMN, "not a number"),
    "bare word": (edited(r"'LEFT'", "LEFT"), "TYRESIDE", VALUE_COLUMN, "'LEFT' is not a number"),
    "nan": (edited(r"1\.68", "nan"), "PDY1", VALUE_COLUMN, "'nan'"),
    "infinity": (edited(r"1\.68", "-inf"), "PDY1", VALUE_COLUMN, "'-inf'"),
    "overflow": (edited(r"1\.68", "1e999"), "PDY1", VALUE_COLUMN, "not a finite number"),
    "underscore": (edited(r"1\.68", "1_6"), "PDY1", VALUE_COLUMN, "'1_6'"),
    "superscript": (edited(r"1\.68", "1\u00b2"), "PDY1", VALUE_COLUMN, "not a number"),
    "hexadecimal": (edited(r"1\.68", "0x1F"), "PDY1", VALUE_COLUMN, "'0x1F'"),
    "no value": (edited(r"^PDY1 .*", "PDY1 ="), "PDY1", 7, "PDY1 has no value"),
    "value is a comment": (edited(r"^PDY1 .*", "PDY1 = $ 1.68"), "PDY1", 8, "no value"),
    "no equals sign": (edited(r"^PDY1 .*", "PDY1 1.68"), "PDY1", 1, "KEY = value"),
    "two equals signs": (edited(r"1\.68", "= 1.68"), "PDY1", VALUE_COLUMN, "'= 1.68'"),
    "open quote": (edited(r"'LEFT'", "'LEFT"), "TYRESIDE", VALUE_COLUMN, "never closed"),
    "two texts": (edited(r"'LEFT'", "'LEFT' 'X'"), "TYRESIDE", VALUE_COLUMN, "more than one"),
    "key with a dash": (edited(r"^PDY1 ", "PD-1 "), "PDY1", 1, "'PD-1' is not a key"),
    "missing key name": (edited(r"^PDY1 ", "     "), "PDY1", 21, "is not a key"),
    "unknown key": (edited(r"^PDY1 ", "PDYX "), "PDY1", VALUE_COLUMN, "PDYX is unknown"),
    "key in the wrong section": (edited(r"^FNOMIN ", "PCX1 "), "FNOMIN", None, "PCX1 is unknown"),
    "5.2 key in a 6.1 file": (edited(r"^LMUY ", "LGAY "), "LMUY", VALUE_COLUMN, "LGAY does not"),
    "unknown section": (edited(r"^\[VERTICAL\]", "[VERTIGO]"), "[VERTICAL]", 1, "unknown"),
    "open section": (edited(r"^\[VERTICAL\]", "[VERTICAL"), "[VERTICAL]", 1, "section header"),
    "empty section": (edited(r"^\[VERTICAL\]", "[]"), "[VERTICAL]", 1, "section header"),
    "words after a section": (edited(r"^(\[VERTICAL\])", r"\1 x"), "[VERTICAL]", 1, "header"),
    "section twice": (edited(r"^\[VERTICAL\]", "[MODEL]"), "[VERTICAL]", 1, "already in line"),
    "key twice": (edited(r"^PDY2 ", "pdy1 "), "PDY2", 1, "PDY1 is already given in line"),
    "missing coefficient": (edited(r"^PKY4 .*\n", ""), "[LATERAL", 1, "lacks PKY4"),
    "missing pressure term": (edited(r"^PPY1 .*\n", ""), "[LATERAL", 1, "lacks PPY1"),
    "missing nominal load": (edited(r"^FNOMIN .*\n", ""), "[VERTICAL]", 1, "lacks FNOMIN"),
    "missing nominal pressure": (edited(r"^NOMPRES.*\n", ""), "[OPERATING", 1, "lacks NOMPRES"),
    "no aligning section": (LF[: LF.index("[ALIGNING")], None, 1, "[ALIGNING_COEFFICIENTS] lacks"),
    "no units": (edited(r"^\[UNITS\]\n(.+\n)+", ""), None, 1, "no [UNITS]"),
    "no length unit": (edited(r"^LENGTH .*\n", ""), "[UNITS]", 1, "lacks LENGTH"),
    "unknown unit": (edited(r"'meter'", "'furlong'"), "LENGTH", VALUE_COLUMN, "'furlong'"),
    "number for a unit": (edited(r"'meter'", "1.0"), "LENGTH", VALUE_COLUMN, "not a unit"),
    "unknown version": (edited(r"= 61$", "= 89"), "FITTYP", VALUE_COLUMN, "FITTYP = 89"),
    "fractional version": (edited(r"= 61$", "= 61.5"), "FITTYP", VALUE_COLUMN, "FITTYP = 61.5"),
    "version in quotes": (edited(r"= 61$", "= '61'"), "FITTYP", VALUE_COLUMN, "FITTYP = '61'"),
    "zero nominal load": (edited(r"3114\.0", "0"), "FNOMIN", VALUE_COLUMN, "not a positive"),
    "zero radius": (edited(r"0\.304$", "-0.304"), "UNLOADED", VALUE_COLUMN, "not a positive"),
    "range reversed": (edited(r"9500\.0", "-9500.0"), "FZMAX", VALUE_COLUMN, "below FZMIN"),
    "NUL": (edited(r"1\.68", "1.\x0068"), "PDY1", VALUE_COLUMN + 2, "control character"),
    "long line": (edited(r"1\.68", "1.68" + " " * MAX_LINE), "PDY1", MAX_LINE + 1, "longer"),
    "content before a section": ("PDY1 = 1\n" + LF, 1, 1, "before the first section"),
    "table too narrow": (
        LF + "[SHAPE]\n1 0\n 1\n",
        None,
        2,
        "2 numbers in a row of [SHAPE], got 1",
    ),
    "table with a word": (LF + "[SHAPE]\n1.0 wide\n", None, 5, "'wide' is not a number"),
    "two turn-slip sections": (
        LF + "[TURNSLIP_COEFFICIENTS]\n[TURNSLIP]\n",
        None,
        1,
        "is another name of the section",
    ),
    "empty": ("", 1, 1, "no [UNITS]"),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_malformed_files_give_one_line_with_the_place(tmp_path: Path, case: str) -> None:
    content, where, column, words = MALFORMED[case]
    path = saved(tmp_path, content)
    with pytest.raises(TirError) as caught:
        load_tir(path)
    message = str(caught.value)
    last = max(1, content.count("\n"))
    line = line_of(where) if isinstance(where, str) else where or last
    place = message.removeprefix(f"{path}:")
    assert place.startswith(f"{line}:" if column is None else f"{line}:{column}: "), message
    assert words in message
    assert message.isprintable(), "one line"
    assert re.search(r"; \w", message), "says what to do"


@pytest.mark.parametrize("content", [b"\x00" * 100, b"\xff\xfe[\x00U\x00", b"PK\x03\x04"])
def test_binary_files_are_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(TirError, match=r":1:\d+: control character"):
        load_tir(saved(tmp_path, content))


def test_a_huge_file_is_refused_without_reading_it(tmp_path: Path) -> None:
    path = tmp_path / "huge.tir"
    with path.open("wb") as stream:
        stream.truncate(2**40)
    with pytest.raises(TirError, match=f"larger than {MAX_BYTES} bytes"):
        read_tir(path)


@pytest.mark.parametrize(
    ("name", "problem"), [("absent.tir", "there is no such file"), (".", "is not a file")]
)
def test_what_is_not_a_file_is_an_input_error(tmp_path: Path, name: str, problem: str) -> None:
    with pytest.raises(TirError, match=problem):
        load_tir(tmp_path / name)


def test_an_unprintable_path_stays_on_one_line() -> None:
    with pytest.raises(TirError) as caught:
        load_tir("a\nb.tir")
    assert str(caught.value).isprintable()


def test_mutated_files_load_or_raise_tir_error(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    source = np.frombuffer(LF.encode("latin-1"), dtype=np.uint8)
    outcomes = set()
    for _ in range(400):
        damaged = source.copy()
        damaged[rng.integers(source.size, size=rng.integers(1, 6))] = rng.integers(256)
        cut = rng.integers(source.size, size=2) if rng.random() < 0.3 else (0, 0)
        path = saved(tmp_path, np.delete(damaged, slice(*sorted(cut))).tobytes())
        try:
            load_tir(path)
            outcomes.add("loaded")
        except TirError as error:
            assert re.fullmatch(rf"{re.escape(str(path))}:\d+:\d+: .+; .+", str(error))
            outcomes.add("refused")
    assert outcomes == {"loaded", "refused"}


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_all_line_ends_read_the_same(tmp_path: Path, end: str) -> None:
    path = saved(tmp_path, LF.replace("\n", end))
    assert read_tir(path) == read_tir(embedded_tire("lf"))
    with pytest.raises(TirError, match=f":{line_of('PDY1')}:{VALUE_COLUMN}:"):
        read_tir(saved(tmp_path, edited(r"1\.68", "x").replace("\n", end)))


@pytest.mark.parametrize("sign", ["$", "!", "#"])
def test_comments_end_a_line_but_not_a_quoted_text(tmp_path: Path, sign: str) -> None:
    text = edited(r"1\.68", f"1.68 {sign} it's = [a] comment \u00e9")
    text = text.replace("'LEFT'", f"'LE{sign}FT'")
    file = read_tir(saved(tmp_path, f"{sign} first line\n" + text))
    assert file.sections["LATERAL_COEFFICIENTS"]["PDY1"] == 1.68
    assert file.sections["MODEL"]["TYRESIDE"] == f"LE{sign}FT"


def test_byte_order_mark_and_latin_1_are_read(tmp_path: Path) -> None:
    text = edited(r"'LEFT'", "'Stra\u00dfe'").encode("latin-1")
    file = read_tir(saved(tmp_path, b"\xef\xbb\xbf" + text))
    assert file.sections["MODEL"]["TYRESIDE"] == "Stra\u00dfe"


def test_shape_rows_need_no_equals_sign(tmp_path: Path) -> None:
    text = LF + "[SHAPE]\n{radial width}\n 1.0 0.0\n 0.9 1.0 $ edge\n"
    path = saved(tmp_path, text)
    load_tir(path)
    shape = read_tir(path).tables["SHAPE"]
    assert shape.columns == ("radial", "width")
    assert shape.rows == ((1.0, 0.0), (0.9, 1.0))


def test_units_are_converted(tmp_path: Path) -> None:
    text = LF
    for old, new in (
        ("'meter'", "'mm'"),
        ("'newton'", "'kilonewton'"),
        ("'radians'", "'degree'"),
        ("'second'", "'minute'"),
        ("0.304", "304"),
        ("3114.0", "3.114"),
        ("9500.0", "9.5"),
        ("ALPMIN              = -0.6", f"ALPMIN = {math.degrees(-0.6)!r}"),
        ("ALPMAX              = 0.6", f"ALPMAX = {math.degrees(0.6)!r}"),
        ("145000.0", "145e-6"),
        ("40.0", "2.4e6"),
        ("CAMMIN              = -0.14", f"CAMMIN = {math.degrees(-0.14)!r}"),
        ("CAMMAX              = 0.14", f"CAMMAX = {math.degrees(0.14)!r}"),
        ("90000.0", "90e-6"),
        ("260000.0", "260e-6"),
    ):
        assert old in text
        text = text.replace(old, new)
    converted, original = load_tir(saved(tmp_path, text)), load_tir(embedded_tire("lf"))
    for name, value in vars(original.parameters).items():
        expected = value if isinstance(value, str) else pytest.approx(value, rel=1e-12)
        assert getattr(converted.parameters, name) == expected, name


def test_degrees_do_not_touch_the_coefficients(tmp_path: Path) -> None:
    tire = load_tir(saved(tmp_path, LF.replace("'radians'", "'degree'")))
    original = load_tir(embedded_tire("lf"))
    assert math.isclose(tire.parameters.ALPMAX, math.radians(0.6))
    assert tire.parameters.PHY1 == original.parameters.PHY1


@pytest.mark.parametrize("tire", EMBEDDED_RANGES)
def test_round_trip_keeps_every_number(tmp_path: Path, tire: str) -> None:
    first = read_tir(embedded_tire(tire))
    write_tir(first, tmp_path / "copy.tir")
    assert re.search(r"(?m)^FITTYP += 61$", (tmp_path / "copy.tir").read_text())
    assert read_tir(tmp_path / "copy.tir") == first
    assert load_tir(tmp_path / "copy.tir") == load_tir(embedded_tire(tire))


def test_round_trip_after_a_conversion_keeps_every_bit(tmp_path: Path) -> None:
    text = LF.replace("'meter'", "'inch'").replace("'newton'", "'pound_force'")
    text = text.replace("1.68", "1.6800000000000001e-17") + "[DEFLECTION_LOAD_CURVE]\n0.1 0.3\n"
    first = read_tir(saved(tmp_path, text))
    assert first.tables["DEFLECTION_LOAD_CURVE"].rows[0][0] == 0.1 * 0.0254
    write_tir(first, tmp_path / "copy.tir")
    assert read_tir(tmp_path / "copy.tir") == first


def test_text_that_cannot_be_quoted_is_not_written(tmp_path: Path) -> None:
    file = PropertyFile({"MODEL": {"TYRESIDE": "driver's"}})
    with pytest.raises(ValueError, match="TYRESIDE"):
        write_tir(file, tmp_path / "x.tir")


def test_reference_files_load_strictly_and_survive_a_round_trip(
    reference_data: Path, tmp_path: Path
) -> None:
    paths = sorted((reference_data / "mf_reference").glob("*.tir"))
    assert len(paths) == 2
    versions = set()
    for path in paths:
        tire = load_tir(path, strict=True)
        write_tir(read_tir(path), tmp_path / path.name)
        assert load_tir(tmp_path / path.name) == tire
        versions.add(tire.parameters.version)
    assert versions == {"5.2", "6.1"}


def as_52(fittyp: str) -> str:
    """The LF tire with what MF 5.2 does not have left out."""
    text = LF.replace("FITTYP              = 61", fittyp)
    names = r"PP[XYZ]\d|RBX3|PEY5|PKY[4-7]|RBY4|QDZ1[01]"
    text = re.sub(rf"^({names}) .*\n", "", text, flags=re.MULTILINE)
    return text.replace("[LATERAL_COEFFICIENTS]\n", "[LATERAL_COEFFICIENTS]\nPHY3 = 0.02\n")


@pytest.mark.parametrize(
    ("fittyp", "version"),
    [
        *((f"FITTYP = {number}", "5.2") for number in (5, 6, 21, 52)),
        ("", "5.2"),
        ("FITTYP = 61", "6.1"),
        ("FITTYP = 62", "6.2"),
    ],
)
def test_fittyp_selects_the_version(tmp_path: Path, fittyp: str, version: str) -> None:
    text = as_52(fittyp) if version == "5.2" else LF.replace("FITTYP              = 61", fittyp)
    assert load_tir(saved(tmp_path, text)).parameters.version == version


def test_camber_is_scaled_by_lgay_in_52_and_lkyc_in_61(tmp_path: Path) -> None:
    for text, key in ((as_52("FITTYP = 6"), "LGAY"), (LF, "LKYC")):
        one, none = (
            load_tir(saved(tmp_path, text.replace("LMUY  ", f"{key} = {scale}\nLMUY  ")))
            for scale in (1, 0)
        )
        upright = one.forces(3000, 0, 0).Fy
        # Camber also lowers the cornering stiffness a little (PKY3), whatever LKYC.
        assert abs(none.forces(3000, 0, 0, 0.05).Fy - upright) < 25, key
        assert abs(one.forces(3000, 0, 0, 0.05).Fy - upright) > 80, key


def test_without_strict_unknown_names_are_kept_and_ignored(tmp_path: Path) -> None:
    text = LF + "[SUPPLIER]\nBATCH = 7\n"
    path = saved(tmp_path, text.replace("LMUY  ", "LGAY = 0.5\nLMUY  "))
    with pytest.raises(TirError, match="LGAY"):
        load_tir(path)
    assert load_tir(path, strict=False) == load_tir(embedded_tire("lf"))
    assert read_tir(path).sections["SUPPLIER"]["BATCH"] == 7.0


VENDOR = "[SUPPLIER]\n" + "".join(f"BLANK_{i} =\nBARE_{i} = not, quoted\n" for i in range(20))
VENDOR += "free text\nnot a key = 3\n"


def test_without_strict_what_no_force_needs_may_be_malformed(tmp_path: Path) -> None:
    """All at once: one warning lists them, and in strict mode one error."""
    path = saved(tmp_path, LF.replace("[VERTICAL]", "[VERTICAL]\nBREFF =") + VENDOR)
    with pytest.warns(UserWarning, match=r"43 unreadable lines that no .*: BREFF in line ") as one:
        assert load_tir(path, strict=False) == load_tir(embedded_tire("lf"))
    assert len(one) == 1
    message = str(one[0].message)
    assert "BARE_19 in line" in message
    assert message.count("a line in line") == 2
    with pytest.raises(TirError, match=r"BREFF has no value; .*; likewise 42 more: BLANK_0 in l"):
        load_tir(path)


LIMITS = [end + side for end in ("PRES", "FZ", "KPU", "ALP", "CAM") for side in ("MIN", "MAX")]


def test_blank_limits_do_not_limit_and_a_blank_mass_is_no_unit(tmp_path: Path) -> None:
    """As files from public libraries have them; a unit or a limit that says something is read."""
    text, without = LF.replace("[MODEL]", "[INERTIA]\nMASS =\n[MODEL]"), LF
    for key in LIMITS:
        text = re.sub(rf"(?m)^{key}\b.*$", f"{key} = $ not known", text)
        without = re.sub(rf"(?m)^{key}\b.*\n", "", without)
    path = saved(tmp_path, text)
    with pytest.warns(UserWarning, match="11 unreadable lines that no force depends on: .*MASS in"):
        blank = load_tir(path, strict=False)
    other = tmp_path / "without.tir"
    other.write_text(without)
    assert blank == load_tir(other) != load_tir(embedded_tire("lf"))
    with pytest.raises(TirError, match=r"MASS has no value; .*; likewise 10 more: "):
        load_tir(path)
    for line, problem in (
        ("FZMAX = 10k", "'10k' is not a number"), ("MASS =", r"\[UNITS\] lacks MASS"),
        ("PRESSURE =", "PRESSURE has no value"), ("LMUY =", "LMUY has no value"),
    ):  # fmt: skip
        key = line.split()[0]
        bad = re.sub(rf"(?m)^{key}\b.*$", line, LF)
        if key == "PRESSURE":
            bad = LF.replace("[UNITS]", f"[UNITS]\n{line}")
        with pytest.raises(TirError, match=problem):
            load_tir(saved(tmp_path, bad), strict=False)


def test_what_forces_need_must_be_well_formed_and_is_listed_at_once(tmp_path: Path) -> None:
    text = LF + VENDOR
    for key in ("PCY1", "PKY1", "LMUY"):
        text = re.sub(rf"(?m)^{key}\b.*$", f"{key} = ?", text)
    path = saved(tmp_path, text)
    expected = r"'\?' is not a number; .*; likewise 2 more: P[CK]Y1 in line \d+, PKY1 in line \d+$"
    with pytest.raises(TirError, match=expected):
        load_tir(path, strict=False)


def test_unknown_keys_are_listed_at_once(tmp_path: Path) -> None:
    path = saved(tmp_path, LF + "[SUPPLIER]\nBATCH = 7\n[ODD]\n")
    with pytest.raises(TirError, match=r"\[SUPPLIER\] is .*; likewise 2 more: .* BATCH, \[ODD\]$"):
        load_tir(path)


def test_files_of_adams_load_strictly(tmp_path: Path) -> None:
    """Keys of files that Adams/Tire comes with (PAC2002, MF_05), as public libraries hold them."""
    keys = "MESSAGES = 'YES'\nCONTACT_MODEL = '3D_ENVELOPING'\nFE_METHOD = 'YES'\nMFSAFE1 = -7128\n"
    text = LF.replace("[MODEL]\n", f"[MODEL]\n{keys}")
    assert load_tir(saved(tmp_path, text)) == load_tir(embedded_tire("lf"))


@pytest.mark.parametrize(("unit", "factor"), [("pascal", 1.0), ("kPa", 1e3), ("bar", 1e5)])
def test_pressures_may_have_a_unit_of_their_own(tmp_path: Path, unit: str, factor: float) -> None:
    """Else they are in that of force over length squared, here kN/m^2."""
    text = re.sub(r"(?m)^FORCE.*$", f"FORCE = 'kilonewton'\nPRESSURE = '{unit}'", LF)
    file = read_tir(saved(tmp_path, text))
    raw = float(re.search(r"(?m)^NOMPRES\s*=\s*([\d.e+]+)", LF)[1])  # type: ignore[index]
    assert file.sections["OPERATING_CONDITIONS"]["NOMPRES"] == pytest.approx(raw * factor)
    again = tmp_path / "again.tir"
    write_tir(file, again)
    assert read_tir(again) == file
    wrong = saved(tmp_path, text.replace(f"'{unit}'", "'torr'"))
    with pytest.raises(TirError, match="'torr' is not a unit of PRESSURE; use one of pascal"):
        read_tir(wrong)


@pytest.mark.parametrize("name", ["TURNSLIP", "TURNSLIP_COEFFICIENTS"])
def test_both_names_of_the_turn_slip_section_are_known(tmp_path: Path, name: str) -> None:
    assert "PHYP4" in KEYS[name]
    load_tir(saved(tmp_path, LF + f"[{name}]\nPECP1 = 0.5\n"))


def test_scaling_factors_default_to_one_and_absent_ranges_do_not_limit(tmp_path: Path) -> None:
    text = re.sub(r"^\[\w+_RANGE\]\n(.+\n)+|^\[SCALING\w+\]\n(.+\n)+", "", LF, flags=re.MULTILINE)
    p = load_tir(saved(tmp_path, text)).parameters
    assert (p.LMUY, p.LFZO, p.LMUV) == (1.0, 1.0, 0.0)
    assert math.isinf(p.ALPMAX)
