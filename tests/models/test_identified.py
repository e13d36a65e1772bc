"""parameters.json: what is written is read back, and use beyond the data is told."""

import contextlib
import json
import math
from pathlib import Path

import numpy as np
import pytest

import miho
from miho.identification import identified as of_report
from miho.models import FunctionModel
from miho.models.identified import (
    Identified,
    OutsideDataWarning,
    ParametersError,
    UncheckedWarning,
    Value,
    _digest,
    parameters_text,
    read_parameters,
)
from miho.regular_file import NotAFileError
from miho.vehicle.models import Pacejka

UNITS = dict(Pacejka.parameters)
THETA = dict(zip(UNITS, [12.0, 1.7, 4000.0, -0.005, 150.0], strict=True))


def identified(**changes: object) -> Identified:
    settings: dict[str, object] = {
        "model": Pacejka(),
        "parameters": {
            name: Value(value, UNITS[name], abs(value) / 100, value - 1, value + 1)
            for name, value in THETA.items()
        },
        "correlation": np.eye(5),
        "ranges": {"alpha": (-0.2, 0.25)},
        "derived": {"peak": Value(4150.0, "N", math.inf, -math.inf, math.inf)},
        "provenance": {"problem": "p", "seed": 0},
    }
    return Identified(**settings | changes)  # type: ignore[arg-type]


def test_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "parameters.json"
    path.write_text(parameters_text(identified(), {"_target_": "miho.vehicle.models.Pacejka"}))
    read_back = read_parameters(path, Pacejka())
    assert read_back.parameters == identified().parameters
    np.testing.assert_array_equal(read_back.correlation, np.eye(5))
    assert read_back.ranges == {"alpha": (-0.2, 0.25)}
    assert math.isnan(read_back.derived["peak"].standard_error)
    assert read_back.provenance == {"problem": "p", "seed": 0}
    alpha = np.linspace(-0.2, 0.25, 7)
    expected = Pacejka().predict(np.array([list(THETA.values())]), alpha)[0]
    np.testing.assert_array_equal(read_back.predict(alpha), expected)


def line(x, *, a, b):  # type: ignore[no-untyped-def]
    return a + b * x


def test_a_function_without_units_is_read_back_with_the_units_of_its_space(tmp_path: Path) -> None:
    x = np.linspace(0, 1, 20)
    space = {"a": {"unit": "V", "low": -9, "high": 9}, "b": {"unit": "V/s", "low": -9, "high": 9}}
    noise = 0.1 * np.random.default_rng(0).standard_normal(20)
    fit = miho.fit(line, x, 1 + 2 * x + noise, space)
    path = tmp_path / "parameters.json"
    path.write_text(parameters_text(of_report(fit.report(profiles=False), {}), {}))
    model = FunctionModel(line, columns=("x",))
    read_back = read_parameters(path, model)
    assert read_back.parameters["b"].unit == "V/s"
    np.testing.assert_allclose(read_back.predict(x.tolist()), fit.predict(x).value, rtol=1e-12)


def test_use_beyond_the_data_is_told() -> None:
    with pytest.warns(OutsideDataWarning, match=r"alpha from 0 to 0.3 rad leaves the data"):
        identified().predict(np.array([0.0, 0.3]))
    assert identified().outside(np.array([-0.2, 0.25])) == []


def test_parameters_must_be_the_models() -> None:
    with pytest.raises(ValueError, match="model Pacejka needs"):
        identified(parameters={"B": Value(1.0, "1/rad")})
    with pytest.raises(ValueError, match="expected each input"):
        identified(ranges={})
    with pytest.raises(ValueError, match="finite"):
        Value(math.nan, "N")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(format=9), "format 9"),
        (lambda d: d.pop("parameters"), "not a parameters file"),
        (lambda d: d["parameters"]["B"].update(value=None), "not a parameters file"),
        (lambda d: d["parameters"]["B"].update(unit="N"), "not a parameters file"),
        (lambda d: d["model"].update(name="Other"), "holds a Other"),
        (lambda d: d.update(correlation=3), "not a parameters file"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path: Path, change: object, message: str) -> None:
    document = json.loads(parameters_text(identified(), {}))
    del document["sha256"]
    change(document)  # type: ignore[operator]
    document["sha256"] = _digest(document)
    path = tmp_path / "parameters.json"
    path.write_text(json.dumps(document))
    with pytest.raises(ParametersError, match=message) as caught:
        read_parameters(path, Pacejka())
    assert str(path) in str(caught.value)


def test_no_bit_can_change_unseen(tmp_path: Path) -> None:
    good = parameters_text(identified(), {}).encode()
    path = tmp_path / "parameters.json"
    rng = np.random.default_rng(0)
    for position in rng.integers(len(good), size=300).tolist():
        flipped = bytearray(good)
        flipped[position] ^= 1 << int(rng.integers(8))
        path.write_bytes(flipped)
        with contextlib.suppress(ParametersError, UncheckedWarning):
            assert read_parameters(path, Pacejka()).theta.tolist() == identified().theta.tolist()


def test_a_file_without_a_checksum_is_read_with_a_warning(tmp_path: Path) -> None:
    document = json.loads(parameters_text(identified(), {}))
    del document["sha256"]
    path = tmp_path / "parameters.json"
    path.write_text(json.dumps(document))
    with pytest.warns(UncheckedWarning, match="has no checksum"):
        read_back = read_parameters(path, Pacejka())
    assert read_back.theta.tolist() == identified().theta.tolist()


def test_a_device_is_no_parameters_file() -> None:
    with pytest.raises(NotAFileError, match="is not a file but a pipe, device or socket"):
        read_parameters("/dev/zero", Pacejka())


def test_something_else_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "parameters.json"
    for text in ("", "[]", "{", "\xff", "[" * 10_000):
        path.write_text(text, encoding="latin-1")
        with pytest.raises(ParametersError):
            read_parameters(path, Pacejka())
