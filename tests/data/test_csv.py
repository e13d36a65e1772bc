"""The strict reader: what it takes, where it says what it does not, and what becomes of it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from miho import Budget, CurveFit, Dataset, Parameter, Space, minimize
from miho.data import CSVError, load_csv
from miho.data.csv import BLOCK, TextFormat, read_numbers
from miho.data.measurements import PLAUSIBLE
from miho.data.preview import preview
from miho.methods.least_squares import LeastSquares
from miho.vehicle.data import embedded_tire, sample_tir
from miho.vehicle.models import Pacejka, load_tir


def file(tmp_path: Path, data: str | bytes) -> Path:
    path = tmp_path / "data.csv"
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def test_columns_by_name(tmp_path: Path) -> None:
    path = file(tmp_path, "\ufefftime,Fy,alpha\r\n0,1e3,0.1\r\n1,-2.5, -0.2 \r\n\r\n")
    columns = read_numbers(path, ["alpha", "Fy"], header=True)
    assert columns["alpha"].tolist() == [0.1, -0.2]
    assert columns["Fy"].tolist() == [1000.0, -2.5]


BAD = {
    "a text cell": ("a,b\n1,2\n3,four\n", "3:3", "'four' in column 'b'"),
    "an empty cell": ("a,b\n1,\n", "2:3", "'' in column 'b'"),
    "NaN": ("a,b\nnan,1\n", "2:1", "not a finite number"),
    "infinity": ("a,b\n1,-inf\n", "2:3", "not a finite number"),
    "overflow": ("a,b\n1,1e999\n", "2:3", "not a finite number"),
    "an underscore": ("a,b\n1_0,1\n", "2:1", "'1_0'"),
    "a decimal comma": ("a,b\n1,5,2\n", "2:1", "3 cells; every row must have 2"),
    "a short row": ("a,b\n1,2\n3\n", "3:1", "1 cells"),
    "a blank line inside": ("a,b\n1,2\n\n3,4\n", "3:1", "1 cells"),
    "a missing column": ("a,c\n1,2\n", "1:1", "no column 'b' in the header 'a,c'"),
    "a column twice": ("a,b,b\n1,2,3\n", "1:5", "'b' appears twice"),
    "no rows": ("a,b\n", "1:1", "no rows of data"),
    "nothing": ("", "1:1", "empty"),
    "other digits": ("a,b\n1,٣\n", "2:3", "not a finite number"),
    "not UTF-8": (b"a,b\n1,\xff\n", "2:3", "not UTF-8"),
    "a long line": ("a,b\n" + "1" * 10_001, "2:10000", "longer than"),
    "blanks": ("a b\n1 2\n", "1:1", "separate columns with commas"),
    "a comment above": ("# A\na;b\n1;2\n", "1:1", "line 2 names the columns: set skip_rows=1"),
    "two delimiters": ("a;b\n1,2\n", "2:1", "1 cells; every row must have 2; add or remove"),
    "a time": ("a,b\n10:00:01,2\n", "2:1", "write times as seconds since the first row"),
    "a date": ("a,b\n1,2024-05-03T10\n", "2:3", "write times as seconds since the first row"),
    "decimal commas": ("a;b\n1,5;2\n", "2:1", "write decimals with '.', or set decimal=comma"),
    "both commas": ('a,b\n"1,5",2\n', "2:1", "write decimals with '.', or set decimal=comma"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_name_line_and_column(tmp_path: Path, case: str) -> None:
    data, place, message = BAD[case]
    path = file(tmp_path, data)
    with pytest.raises(CSVError) as error:
        read_numbers(path, ["a", "b"], header=True)
    assert str(error.value).startswith(f"{path}:{place}: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_another_delimiter_is_seen_from_the_header(tmp_path: Path, delimiter: str) -> None:
    rows = [["a", '"b, c"', "d"], ["1", "2.5", "x"], ["3", "4", '"x"']]
    path = file(tmp_path, "\n".join(delimiter.join(row) for row in rows))
    columns = read_numbers(path, ["b, c", "a"], header=True)
    assert [column.tolist() for column in columns.values()] == [[2.5, 4.0], [1.0, 3.0]]


@pytest.mark.parametrize("quote", ["", '"'])
@pytest.mark.parametrize("rows", [3, BLOCK + 1])
def test_a_spreadsheet_of_central_europe(tmp_path: Path, quote: str, rows: int) -> None:
    """Semicolons, decimal commas, a title, a line of units and remarks; places stay the file's."""
    values = np.random.default_rng(1).standard_normal((rows, 2))
    cells = [[f"{quote}{x!r}{quote}".replace(".", ",") for x in row] for row in values.tolist()]
    head = ["Prüfstand 3", "a;b;Bemerkung", "deg;kN;", "# Lauf 1"]
    lines = [*head, *(";".join([*row, "gut, soweit"]) for row in cells)]
    path = file(tmp_path, "\n".join(lines))
    text = TextFormat(decimal="comma", skip_rows=1, drop_rows=[3], comment="#")
    columns = read_numbers(path, ["b", "a"], header=True, text=text)
    assert np.array_equal(columns["a"], values[:, 0])
    assert np.array_equal(columns["b"], values[:, 1])
    lines[6] = "1,5;1.5;"
    path = file(tmp_path, "\n".join(lines))
    with pytest.raises(CSVError, match=r":7:5: '1\.5' in column 'b' .* write decimals with ','"):
        read_numbers(path, ["b", "a"], header=True, text=text)


@pytest.mark.parametrize("delimiter", [None, "comma"])
def test_quoted_decimal_commas_between_commas(tmp_path: Path, delimiter: str | None) -> None:
    """As pandas writes them: `to_csv(decimal=",")`."""
    path = file(tmp_path, 'a,b\n"0,5",2\n1,"2,5"\n3,4\n')
    columns = read_numbers(path, ["b"], header=True, text=TextFormat(delimiter, "comma"))
    assert columns["b"].tolist() == [2.0, 2.5, 4.0]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"delimiter": "x"}, "delimiter is 'x'; choose from comma, semicolon, tab"),
        ({"decimal": "x"}, "decimal is 'x'; choose from point, comma"),
        ({"skip_rows": -1}, "skip_rows is -1; expected a number of lines"),
        ({"drop_rows": [0]}, r"drop_rows is \[0\]; list the numbers of lines, counted from 1"),
        ({"drop_rows": "2"}, "drop_rows is '2'; list"),
        ({"comment": ""}, "comment is ''; give the prefix of such lines"),
        ({"drop_rows": [9]}, "data.csv:2:1: this is the last line, but line 9 is to be ignored"),
        ({"skip_rows": 2}, "data.csv:1:1: all lines are ignored"),
        ({"every": 0}, "every is 0; expected a whole number of at least 1"),
        ({"where": {"a": 5}}, "where a is 5; give two finite numbers"),
        ({"where": {3: [1, 2]}}, "where names 3; name columns of the file, each once"),
        ({"where": {"a": [1, 2], " a": [1, 2]}}, "where names ' a'; name columns"),
        ({"where": {"q": [1, 2]}}, "data.csv:1:1: no column 'q' in the header"),
        ({"where": {"a": [5, 6]}}, r"no row has where=\{'a': \[5, 6\]\}; in .* a from 1 to 1; "),
    ],
)
def test_settings_that_cannot_be(tmp_path: Path, settings: dict[str, Any], message: str) -> None:
    path = file(tmp_path, "a,b\n1,2\n")
    with pytest.raises(ValueError, match=message):
        load_csv(str(path), ["a", "b"], ["-", "-"], "b", **settings)


def test_huge_files_are_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.csv"
    with path.open("wb") as stream:
        stream.truncate(2**30)
    with pytest.raises(CSVError, match="larger than 64 MiB"):
        read_numbers(path, ["a"], header=True)


def test_numbers_survive_a_round_trip(tmp_path: Path) -> None:
    values = np.random.default_rng(0).standard_normal(200)
    path = file(tmp_path, "\n".join(repr(v) for v in values.tolist()))
    assert np.array_equal(read_numbers(path, ["x"], header=False)["x"], values)


def test_quoted_cells(tmp_path: Path) -> None:
    path = file(tmp_path, '"a","the ""b"", in kN",note\n"1", "2" ,"x, y"\n3,4,\n')
    columns = read_numbers(path, ["a", 'the "b", in kN'], header=True)
    assert [column.tolist() for column in columns.values()] == [[1.0, 3.0], [2.0, 4.0]]


@pytest.mark.parametrize("row", [0, BLOCK - 1, BLOCK, 2 * BLOCK + 3])
def test_a_fault_is_found_anywhere_in_a_long_file(tmp_path: Path, row: int) -> None:
    rows = [f"{i},{i / 7!r},run_{i}" for i in range(2 * BLOCK + 4)]
    text = "\n".join(["a,b,note", *rows])
    columns = read_numbers(file(tmp_path, text), ["b", "a"], header=True)
    assert np.array_equal(columns["b"], np.arange(2 * BLOCK + 4) / 7)
    assert np.array_equal(columns["a"], np.arange(2 * BLOCK + 4))
    rows[row] = f"{row},1e,run"
    path = file(tmp_path, "\n".join(["a,b,note", *rows]))
    with pytest.raises(CSVError, match=f":{row + 2}:{len(str(row)) + 2}: '1e' in column 'b'"):
        read_numbers(path, ["b", "a"], header=True)


def written(tmp_path: Path, columns: dict[str, Any], name: str = "mine") -> str:
    path = tmp_path / f"{name}.csv"
    rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines))
    return str(path)


TIRE = sample_tir("lf", n=400)
alpha, Fy, Fz, gamma = (TIRE[name] for name in ("alpha", "Fy", "Fz", "gamma"))
COLUMNS = ["alpha", "Fy", "Fz", "gamma"]
UNITS = ["rad", "N", "N", "rad"]


def load(tmp_path: Path, file: dict[str, Any], **settings: Any) -> Dataset:
    defaults: dict[str, Any] = {"columns": COLUMNS, "units": UNITS, "output": "Fy"}
    return load_csv(written(tmp_path, file), **defaults | settings)


def tire_columns(**changes: Any) -> dict[str, Any]:
    return {"alpha": alpha, "Fy": Fy, "Fz": Fz, "gamma": gamma} | changes


def test_units_names_and_conditions(tmp_path: Path) -> None:
    file = {"t": np.arange(400.0), "IA": np.degrees(gamma), "FZ": Fz / 4.4482216152605}
    file |= {"SA": np.degrees(alpha), "FY": Fy / 1e3}
    units = ["deg", "kN", "lbf", "deg"]
    read = load(tmp_path, file, units=units, headers=["SA", " FY ", "FZ", "IA"])
    assert (read.name, read.output, read.held_out) == ("mine", "Fy", None)
    assert dict(read.units) == dict(zip(COLUMNS, UNITS, strict=True))
    for name in COLUMNS:
        np.testing.assert_allclose(read[name], TIRE[name], rtol=1e-15)
    assert load(tmp_path, tire_columns(), name="other").name == "other"


def test_rows_are_chosen_by_the_file_s_own_columns(tmp_path: Path) -> None:
    """In its names, units and signs, whether the column is used or not; faults keep their place."""
    run = np.repeat([1.0, 2.0], 200)
    file = {"SA": np.degrees(alpha), "FY": Fy, "FZ": -Fz / 1e3, "run": run}
    settings: dict[str, Any] = {
        "columns": ["alpha", "Fy"], "units": ["deg", "N"], "headers": ["SA", "FY"],
        "where": {"FZ": [-4.0, -3.0], "run": [2, 2]},
    }  # fmt: skip
    chosen = np.flatnonzero((Fz >= 3000) & (Fz <= 4000) & (run == 2))
    assert 20 < chosen.size < 200
    read = load(tmp_path, file, **settings)
    np.testing.assert_array_equal(read["Fy"], Fy[chosen])
    thinner = load(tmp_path, file, **settings, every=7, held_out={"alpha": [0.09, 1]})
    assert thinner.held_out is not None
    rows = chosen[::7]
    np.testing.assert_array_equal(thinner["Fy"], Fy[rows][alpha[rows] < 0.09])
    np.testing.assert_array_equal(thinner.held_out["Fy"], Fy[rows][alpha[rows] >= 0.09])
    file["FY"] = np.where(np.arange(400) == chosen[5], 1e7, Fy)
    with pytest.raises(CSVError, match=rf"mine\.csv:{chosen[5] + 2}:\d+: largest"):
        load(tmp_path, file, **settings)


def test_the_preview_shows_the_file_and_what_is_used(tmp_path: Path) -> None:
    path = tmp_path / "run_7.csv"
    numbers = [(2.5, -1834.2), (-3.0, 2100.5), (9.0, -4.0)]
    rows = [f"{a};{F};x".replace(".", ",") for a, F in numbers]
    path.write_text("\n".join(["SA;FY;note", "deg;N;", *rows]))
    read = load_csv(
        str(path), ["alpha", "Fy"], ["deg", "N"], "Fy", ["SA", "FY"], decimal=",", drop_rows=[2],
        where={"SA": [-5, 5]},
    )  # fmt: skip
    assert preview(read) == "\n".join(
        [
            f"{path}: 3 rows (separated by semicolons; decimal commas; 1 line ignored; SA from "
            "-5 to 5); name, unit, range, first rows:",
            "  SA     deg        -3  to         9  |       2.5        -3   9",
            "  FY     N     -1834.2  to    2100.5  |   -1834.2    2100.5  -4",
            "used, in SI units and ISO signs: 2 rows",
            "  alpha  rad  -0.05236  to  0.043633  |  0.043633  -0.05236",
            "  Fy     N     -1834.2  to    2100.5  |   -1834.2    2100.5",
        ]
    )
    assert preview(TIRE) is None


def test_the_preview_shows_once_what_is_used_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "decay.csv"
    path.write_text("t,y\n0,2\n0.5,1.5\n")
    lines = (preview(load_csv(str(path), ["t", "y"], ["s", "V"], "y")) or "").splitlines()
    assert lines[-1] == "used as they are: 2 rows"
    assert len(lines) == 4


SIGNS = {
    "iso-w": (1, 1, 1),
    "sae": (-1, -1, -1),  # y and z the other way
    "adapted-sae": (1, -1, 1),  # the book: alpha, Fy and Fz are positive together
}


@pytest.mark.parametrize("convention", SIGNS)
def test_conventions(tmp_path: Path, convention: str) -> None:
    signs = SIGNS[convention]
    file = tire_columns(alpha=signs[0] * alpha, Fy=signs[1] * Fy, Fz=signs[2] * Fz)
    read = load(tmp_path, file, convention=convention)
    assert all(np.array_equal(read[name], TIRE[name]) for name in COLUMNS)
    flipped = load(tmp_path, file | {"Fy": -file["Fy"]}, convention=convention, flip=["Fy"])
    assert flipped.digest == read.digest


def test_the_book_s_tire_pushes_right_when_it_slips_left() -> None:
    """Its own axes: Fy = C alpha with C > 0, Mz = -t Fy, and gamma > 0 pushes to the right."""
    from miho.data.conventions import FLIPPED

    assert FLIPPED["adapted-sae"] == {"Fy", "My", "Mz"}
    assert FLIPPED["sae"] - FLIPPED["adapted-sae"] == {"alpha", "Fz"}


def test_the_unit_of_the_file_does_not_change_the_tire(tmp_path: Path) -> None:
    """Written in deg and kN, SAE, the same tire is found.

    To 1e-7: descents stop where the loss changes by 1e-10, and rounding decides which is best.
    """
    space = Space(
        (
            Parameter("B", "1/rad", 2.0, 40.0), Parameter("C", "-", 1.0, 2.5),
            Parameter("D", "N", 1e3, 8e3), Parameter("Sx", "rad", -0.05, 0.05),
            Parameter("Sy", "N", -500.0, 500.0),
        )
    )  # fmt: skip
    file = {"SA": -np.degrees(alpha), "FY": -Fy / 1e3}
    other = load(
        tmp_path, file, columns=["alpha", "Fy"], units=["deg", "kN"], headers=["SA", "FY"],
        convention="sae", name=TIRE.name,
    )  # fmt: skip
    assert other.digest != TIRE.digest
    thetas = [
        minimize(
            LeastSquares(), CurveFit(Pacejka(), data, space), Budget(evaluations=5000), seed=1
        ).theta
        for data in (TIRE, other)
    ]
    np.testing.assert_allclose(thetas[1], thetas[0], rtol=1e-7)


WRONG_UNITS = {
    "degrees as radians": ({"alpha": np.degrees(alpha)}, {}, "alpha", "deg or mrad"),
    "radians as degrees": ({}, {"alpha": "deg"}, "alpha", "rad"),
    "kN as N": ({"Fy": Fy / 1e3}, {}, "Fy", "kN, daN, lbf or kgf"),
    "N as kN": ({}, {"Fy": "kN"}, "Fy", "N, daN, lbf or kgf"),
    "camber in degrees as radians": ({"gamma": np.degrees(gamma)}, {}, "gamma", "deg or mrad"),
    "camber in radians as degrees": ({}, {"gamma": "deg"}, "gamma", "rad"),
    "load in kN as N": ({"Fz": Fz / 1e3}, {}, "Fz", "kN, daN or kgf"),
}


@pytest.mark.parametrize("case", WRONG_UNITS)
def test_wrong_units_are_caught(tmp_path: Path, case: str) -> None:
    changes, declared, column, meant = WRONG_UNITS[case]
    units = [declared.get(name, unit) for name, unit in zip(COLUMNS, UNITS, strict=True)]
    file = tire_columns(**changes)
    with pytest.raises(CSVError, match=rf"is the column in {meant}\?") as error:
        load(tmp_path, file, units=units)
    row = int(np.argmax(np.abs(file[column])))
    assert f"mine.csv:{row + 2}:" in str(error.value)
    assert f"largest |{column}| is" in str(error.value)
    limits = {column: [0.0, 1e9]}
    assert len(load(tmp_path, file, units=units, ranges=limits)) == 400
    assert len(load(tmp_path, file, units=units, ranges={column: None})) == 400


def test_all_units_that_fit_are_named(tmp_path: Path) -> None:
    file = tire_columns() | {"pressure": np.where(alpha > 0, 0.9, 1.6)}
    with pytest.raises(CSVError, match=r"\|pressure\| is 1.6 Pa, .* in MPa or bar\? Correct it"):
        load(tmp_path, file, columns=[*COLUMNS[:3], "pressure"], units=["rad", "N", "N", "Pa"])


def test_a_unit_is_judged_before_rows_are_chosen(tmp_path: Path) -> None:
    """Rows at zero camber have almost none; a wrong unit is seen though the rows chosen fit it."""
    degrees = np.degrees(gamma - gamma.mean())
    settings: dict[str, Any] = {
        "units": ["rad", "N", "N", "deg"],
        "where": {" gamma ": [-0.03, 0.03]},  # blanks are ignored, as in the header
    }
    read = load(tmp_path, tire_columns(gamma=degrees), **settings)
    assert 0 < np.abs(read["gamma"]).max() < PLAUSIBLE["gamma"][1]
    np.testing.assert_array_equal(read["Fy"], Fy[np.abs(degrees) <= 0.03])
    with pytest.raises(CSVError, match=r"csv:\d+:\d+: largest \|gamma\| .*is the column in rad\?"):
        load(tmp_path, tire_columns(gamma=degrees / 60), **settings)
    wild = np.where(np.abs(alpha) > 0.2, 1e3, alpha)  # in rows that are left out
    few = {"where": {"alpha": [-0.09, 0.09]}}
    assert len(load(tmp_path, tire_columns(alpha=wild), **few)) == np.sum(np.abs(alpha) <= 0.09)
    with pytest.raises(CSVError, match=r":1:1: median \|alpha\| .*is the column in deg\?"):
        load(tmp_path, tire_columns(alpha=np.degrees(alpha)), **few)


def test_inputs_kept_at_zero_are_no_wrong_unit(tmp_path: Path) -> None:
    assert len(load(tmp_path, tire_columns(gamma=gamma / 200))) == 400
    with pytest.raises(CSVError, match=r"expected 0\.002 to 1\.2; is this cell"):
        load(tmp_path, tire_columns(gamma=gamma / 200), ranges={"gamma": [0.002, 1.2]})


def test_a_force_that_no_load_gives(tmp_path: Path) -> None:
    with pytest.raises(CSVError, match=r":1:7: largest \|Fy\| is \d+\.?\d* times the largest \|Fz"):
        load(tmp_path, tire_columns(Fz=Fz / 9.81))


def test_a_single_wild_cell_is_caught(tmp_path: Path) -> None:
    wild = Fy.copy()
    wild[6] = -99999e3
    with pytest.raises(CSVError, match=r"mine.csv:8:\d+: largest \|Fy\| is 1e\+08 N.*this cell"):
        load(tmp_path, tire_columns(Fy=wild))


def test_ranges_that_are_given_bind(tmp_path: Path) -> None:
    with pytest.raises(CSVError, match=r"expected 1 to 2000; is this cell right\?"):
        load(tmp_path, tire_columns(), ranges={"Fz": [1, 2000]})
    assert all(low < high for _, low, high in PLAUSIBLE.values())


def test_signs_that_no_tire_has(tmp_path: Path) -> None:
    with pytest.raises(CSVError, match=r"mine.csv:1:7: Fy rises with alpha, but it falls in ISO-W"):
        load(tmp_path, tire_columns(Fy=-Fy))
    with pytest.raises(CSVError, match=r"mine.csv:1:10: Fz is mostly negative"):
        load(tmp_path, tire_columns(Fz=-Fz))
    tire, kappa = load_tir(embedded_tire("lf")), np.linspace(-0.2, 0.2, 400)
    pure, driven = tire.forces(Fz, 0, alpha, gamma), tire.forces(Fz, kappa, 0.05, gamma)
    moments: dict[str, Any] = {"columns": ["alpha", "Mz", "Fz"], "units": ["rad", "Nm", "N"]}
    moments["output"] = "Mz"
    driving: dict[str, Any] = {"columns": ["kappa", "Fx", "Fz"], "units": ["-", "N", "N"]}
    driving["output"] = "Fx"
    load(tmp_path, {"alpha": alpha, "Mz": pure.Mz, "Fz": Fz}, **moments)
    load(tmp_path, {"kappa": kappa, "Fx": driven.Fx, "Fz": Fz}, **driving)
    with pytest.raises(CSVError, match=":1:7: Mz falls with alpha, but it rises in ISO-W"):
        load(tmp_path, {"alpha": alpha, "Mz": -pure.Mz, "Fz": Fz}, **moments)
    percent = {"kappa": 100 * kappa, "Fx": driven.Fx, "Fz": Fz}
    with pytest.raises(CSVError, match=r"largest \|kappa\| is 20, expected 0.003 to 2; is .* in %"):
        load(tmp_path, percent, **driving)
    with pytest.raises(CSVError, match=":1:7: Fx falls with kappa, but it rises in ISO-W"):
        load(tmp_path, {"kappa": -kappa, "Fx": driven.Fx, "Fz": Fz}, **driving)
    sliding = tire_columns(alpha=np.linspace(0.3, 0.9, 400), Fy=-4000 + np.linspace(0, 500, 400))
    assert len(load(tmp_path, sliding)) == 400  # beyond its peak the force does fall off


@pytest.mark.parametrize(
    ("reversed_", "settings", "remedies"),
    [
        (["Fy"], {}, ["convention=adapted-sae", "flip=[alpha]", "flip=[Fy]"]),
        (["alpha", "Fy", "Fz"], {}, ["convention=sae", "flip=[Fz]"]),
        ([], {"flip": ["Fy"]}, ["convention=adapted-sae", "flip=[Fy, alpha]", "flip=[]"]),
        ([], {"convention": "adapted-sae"}, ["convention=iso-w", "flip=[alpha]", "flip=[Fy]"]),
    ],
)
def test_each_remedy_of_a_sign_works(
    tmp_path: Path, reversed_: list[str], settings: dict[str, Any], remedies: list[str]
) -> None:
    signs = {name: -1 if name in reversed_ else 1 for name in ("alpha", "Fy", "Fz")}
    columns = tire_columns(alpha=signs["alpha"] * alpha, Fy=signs["Fy"] * Fy, Fz=signs["Fz"] * Fz)
    with pytest.raises(CSVError, match="in ISO-W; set ") as caught:
        load(tmp_path, columns, **settings)
    assert str(caught.value).split("; set ")[1] == " or ".join(remedies)
    for name, value in (remedy.split("=") for remedy in remedies):
        names = [each for each in value.strip("[]").split(", ") if each]
        own = {name: names if name == "flip" else value}
        assert len(load(tmp_path, columns, **(settings | own))) == Fy.size


def test_columns_that_tell_nothing(tmp_path: Path) -> None:
    load(tmp_path, tire_columns(Fz=0 * Fz + 3000.0, gamma=0 * gamma))  # conditions may stay
    with pytest.raises(CSVError, match=r":1:7: column 'Fy' has the same value in every row"):
        load(tmp_path, tire_columns(Fy=0 * Fy - 300.0))
    two = {"columns": ["alpha", "Fy"], "units": ["rad", "N"]}
    with pytest.raises(CSVError, match=r":1:1: column 'alpha' has the same value in every row"):
        load(tmp_path, tire_columns(alpha=0 * alpha + 0.1), **two)


def test_rows_are_held_out(tmp_path: Path) -> None:
    low, high = 2500.0, 2700.0
    read = load(tmp_path, tire_columns(), held_out={"Fz": [low, high]})
    inside = (Fz >= low) & (Fz <= high)
    assert read.held_out is not None
    assert np.array_equal(read["Fy"], Fy[~inside])
    assert np.array_equal(read.held_out["Fy"], Fy[inside])
    with pytest.raises(ValueError, match="no row has Fz"):
        load(tmp_path, tire_columns(), held_out={"Fz": [1, 2]})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"units": ["rad"]}, "4 columns, 1 units and 4 headers; give one unit per column"),
        ({"headers": ["SA"]}, "1 headers"),
        ({"columns": [], "units": []}, "0 columns"),
        ({"columns": ["alpha", "Fy", "Fz", "Fy"]}, "name each once"),
        ({"columns": "alpha"}, "columns is 'alpha'; give a list of names"),
        ({"units": ["rad", "N", "N", 1]}, "give a list of names"),
        ({"output": "Mz"}, "output names 'Mz'; columns are alpha, Fy, Fz, gamma; choose one"),
        ({"units": ["rad", "kn", "N", "rad"]}, "did you mean 'kN'"),
        ({"convention": "ISO"}, "convention is 'ISO'; expected one of iso-w, sae, adapted-sae"),
        ({"flip": ["Mz"]}, "flip names 'Mz'"),
        ({"ranges": {"SA": [1, 2]}}, "ranges names 'SA'"),
        ({"ranges": {"alpha": [2, 1]}}, r"the range of alpha is \[2, 1\]"),
        ({"ranges": 5}, "ranges is 5; map columns to their bounds"),
        ({"held_out": ["Fz", 1]}, "held_out is .* map columns to their bounds"),
        ({"held_out": {"Fz": 4000}}, "held_out of Fz is 4000; give two finite numbers"),
        ({"held_out": {"speed": [1, 2]}}, "held_out names 'speed'"),
    ],
)
def test_bad_settings(tmp_path: Path, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        load(tmp_path, tire_columns(), **settings)
    assert type(error.value) is ValueError
    assert "\n" not in str(error.value)


def test_a_model_of_your_own_has_its_own_units(tmp_path: Path) -> None:
    columns = {"t": np.arange(5.0), "y": np.arange(5.0) / 7}
    settings: dict[str, Any] = {"columns": ["t", "y"], "output": "y"}
    read = load(tmp_path, columns, units=["ms", "own:kmol"], **settings)
    assert dict(read.units) == {"t": "s", "y": "kmol"}
    assert read["y"].tolist() == columns["y"].tolist()


def test_an_unprintable_path_stays_on_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a\nb.csv"
    path.write_text("a\n")
    with pytest.raises(CSVError) as error:
        read_numbers(path, ["a"], header=True)
    assert str(error.value).isprintable()


def test_rows_without_a_number_are_left_out_and_counted(tmp_path: Path) -> None:
    """Places in messages stay those of the file."""
    rows = ["SA,FY,note", "0.1,10,", "0.2,,x", "0.3,NaN,", "0.4,40,", "n/a,50,", "0.6,-60,"]
    path = str(file(tmp_path, "\n".join(rows)))
    arguments: tuple[Any, ...] = (path, ["a", "F"], ["own:u", "N"], "F", ["SA", "FY"])
    missing = r":3:5: '' in column 'FY' .* missing in 3 of 6 rows; correct .* with missing=drop$"
    with pytest.raises(CSVError, match=missing):
        load_csv(*arguments)
    dataset = load_csv(*arguments, missing="drop")
    assert dataset["a"].tolist() == [0.1, 0.4, 0.6]
    assert dataset.reading is not None
    assert dataset.reading.notes == ("3 rows with a missing number ignored",)
    with pytest.raises(CSVError, match=r":7:5: largest \|F\| is 60 N"):
        load_csv(*arguments, missing="drop", ranges={"F": [1, 50]})
    with pytest.raises(ValueError, match="missing is 'omit'; expected one of raise, drop"):
        load_csv(*arguments, missing="omit")
    with pytest.raises(CSVError, match=r":2:3: '' in .* in 2 of 2 rows; correct the cells$"):
        load_csv(str(file(tmp_path, "SA,FY\n1,\n,2")), *arguments[1:], missing="drop")
