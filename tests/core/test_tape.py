"""Tapes of formulas: the machine against NumPy's machine, and what it refuses."""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import miho.core.tape
from baselines.problems.published_model import FORMS, PublishedModel
from miho.core import OPERATIONS, Instruction, Tape, TapeError, machine
from miho.core.tape import WITH_SCALAR, checksum
from miho.models.expression import Expression
from miho.models.formula_tape import tape_of
from miho.models.symbolic import argument, gradient, trace
from miho.vehicle.models import Pacejka

Array = NDArray[np.float64]
needs_machine = pytest.mark.skipif(machine() is None, reason="the machine was not built")


def traced(function: Callable[..., Any], p: int, d: int) -> tuple[Tape, Tape]:
    """The tapes of a function of p inputs and d parameters, and of its derivatives."""
    columns = [argument(f"x{k}") for k in range(p)]
    parameters = [argument(f"p{k}") for k in range(d)]
    graph = trace(function, *columns, *parameters)
    slopes = gradient(graph, parameters)
    return tape_of([graph], columns, parameters), tape_of(slopes, columns, parameters)


def assert_alike(tape: Tape, thetas: Array, X: Array, close: float) -> None:
    """The machine gives what NumPy's does, to a share of the largest value of a result."""
    with np.errstate(all="ignore"):
        for theta, results in zip(thetas, tape.evaluate(thetas, X), strict=True):
            for values, expected in zip(results, tape.by_numpy(theta, X), strict=True):
                expected = np.broadcast_to(expected, values.shape)
                finite = np.isfinite(expected)
                assert (np.isfinite(values) == finite).all()
                scale = np.abs(expected[finite]).max(initial=0.0)
                assert (np.abs(values - expected)[finite] <= close * scale).all()


@needs_machine
@pytest.mark.parametrize("name", FORMS)
def test_the_machine_is_numpys_on_all_published_formulas(name: str) -> None:
    """To some hundred roundings of the largest value: terms of a formula may cancel."""
    model = PublishedModel(name)
    rng = np.random.default_rng(1)
    X = rng.uniform(0.1, 2, (len(model.inputs), 300))
    thetas = rng.uniform(0.2, 2, (3, len(model.parameters)))
    tapes = model.tapes
    assert tapes is not None
    for tape in tapes:
        assert_alike(tape, thetas, X, 1e-12)
        found = set()
        for level in range(len(machine().levels())):
            out = np.empty((3, tape.results, 300))
            machine().evaluate(tape.at_level(level), thetas, X, out)
            found.add(out.tobytes())
        assert len(found) == 1, "levels differ"
    np.testing.assert_allclose(
        tapes[0].evaluate(thetas, X)[:, 0], model.predict(thetas, *X), rtol=1e-9, atol=1e-9
    )


def everything(x: Any, z: Any, a: Any, b: Any, c: Any) -> Any:
    """A formula of every operation that a graph can hold."""
    inside = a / (1 + x * x)
    smooth = np.sinh(inside) + np.cosh(inside) * np.tanh(b * x) - np.arcsinh(c * z) + np.hypot(x, a)
    smooth = smooth + np.arcsin(inside / 4) + np.arccos(inside / 4) + np.arctanh(inside / 4)
    smooth = smooth + np.arccosh(1 + a * x * x) + np.arctan2(x, z + 3) + np.tan(x / 2)
    logs = np.log(a + x * x) + np.log1p(x * x) + np.log10(a + z * z) + np.log2(b + z * z)
    powers = (1 + x * x) ** b + z**3 + (2 + z) ** -2 + 2.0**z + a**b + np.abs(x) ** 0.5 + a**80.0
    waves = np.sin(b * x) * np.cos(b * x) + np.cos(c * z) + np.sin(a) * np.cos(a) + np.exp(-a * x)
    bent = np.where((x > 0) & (z < 1) | ~(x >= z), np.minimum(x, a), np.maximum(z, b))
    bent = (
        bent + np.where(x == z, a, b) * np.where(x != 0, 1.0, c) + np.where(x <= 1, np.sign(x), z)
    )
    return smooth + logs + powers / a**80.0 + waves + bent + np.expm1(c * x) - np.sqrt(b)


@needs_machine
@pytest.mark.parametrize("rows", [*range(1, 26), 255, 257, 300])
def test_any_number_of_rows_gives_the_bits_of_more_rows(rows: int) -> None:
    """Registers are computed as a whole; beyond the rows nothing is read or written."""
    rng = np.random.default_rng(0)
    X, thetas = rng.uniform(0.2, 0.8, (2, 320)), rng.uniform(0.2, 0.8, (2, 3))
    for tape in traced(everything, 2, 3):
        for level in range(len(machine().levels())):
            held = tape.at_level(level)
            more, out = np.empty((2, tape.results, 320)), np.empty((2, tape.results, rows))
            machine().evaluate(held, thetas, X, more)
            machine().evaluate(held, thetas, np.ascontiguousarray(X[:, :rows]), out)
            np.testing.assert_array_equal(out, more[:, :, :rows])


@needs_machine
@pytest.mark.parametrize("rows", [1, 7, 127, 128, 129, 255, 256, 257, 1000])
def test_the_machine_is_numpys_on_every_operation(rows: int) -> None:
    rng = np.random.default_rng(rows)
    X, thetas = rng.uniform(-1, 1, (2, rows)), rng.uniform(0.3, 1.5, (3, 3))
    for tape in traced(everything, 2, 3):
        assert_alike(tape, thetas, X, 1e-12)


def test_a_power_and_its_derivatives_share_a_logarithm() -> None:
    tape = tape_of(
        [(f := trace(lambda x, a, b: a * x**b, *(s := [argument(k) for k in ("x0", "p0", "p1")]))),
         *gradient(f, s[1:])], s[:1], s[1:],
    )  # fmt: skip
    names = [each.operation for each in (*tape.once, *tape.code)]
    assert names.count("LOG_PARTS") == 1
    assert "LOG" not in names


@needs_machine
@pytest.mark.parametrize("base", [0.0, 1e-120, -1e-120, 0.5, -0.5, 1e120, np.inf, np.nan])
@pytest.mark.parametrize("exponent", [-1.5, 0.5, 1.0, 2.5, 3.0])
def test_powers_at_the_ends_are_numpys(base: float, exponent: float) -> None:
    """Where the derivatives take the floor of a base, the value does not."""
    for tape in traced(lambda x, b: x**b, 1, 1):
        assert_alike(tape, np.array([[exponent]]), np.array([[base]]), 1e-13)


def test_a_long_formula_needs_few_registers() -> None:
    """Of the Magic Formula's hundreds of operations, and it can be stored."""
    x = np.linspace(-0.2, 0.2, 50)
    tapes = Pacejka().tapes
    assert tapes is not None
    value = tapes[0]
    assert value.registers < len(value.code)
    theta = np.array([[12.0, 1.4, 3000.0, 0.01, 80.0]])
    again = pickle.loads(pickle.dumps(value))
    np.testing.assert_array_equal(again.evaluate(theta, x[None]), value.evaluate(theta, x[None]))


@needs_machine
@pytest.mark.skipif(checksum() is None, reason="the sources in C are not installed")
@pytest.mark.parametrize("stale", [True, False])
def test_a_machine_from_other_sources_is_refused(stale: bool, tmp_path: Path) -> None:
    """The package is copied with its machine; a comment in its C code differs, or nothing."""
    ignore = shutil.ignore_patterns("*.pyc")
    shutil.copytree(Path(miho.__file__).parent, tmp_path / "miho", ignore=ignore)
    if stale:
        source = tmp_path / "miho/core/climb.c"
        source.chmod(0o644)  # a checkout may be read-only
        with source.open("a", encoding="utf-8") as file:
            file.write("/* changed */\n")
    program = "from miho.core import machine; print(machine() is None, machine() is None)"
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    process = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    assert process.stdout == f"{stale} {stale}\n"
    lines = process.stderr.splitlines()
    assert len(lines) == stale
    remedy = "build it again by python setup.py build_ext --inplace --force"
    assert all(line.endswith(f"miho/core was built from other sources; {remedy}") for line in lines)


def test_hidden_files_and_line_endings_do_not_change_the_checksum(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An editor's lock is a hidden link to nothing; a source that cannot be read gives None."""
    monkeypatch.setattr(miho.core.tape, "__file__", str(tmp_path / "tape.py"))
    assert checksum() is None
    source = tmp_path / "climb.c"
    source.write_bytes(b"int a;\nint b;\n")
    expected = checksum()
    source.write_bytes(b"int a;\r\nint b;\r\n")
    (tmp_path / ".climb.c").write_bytes(b"int c;\n")
    (tmp_path / ".#climb.c").mkdir()
    assert checksum() == expected == zlib.crc32(b"int a;\nint b;\n")
    (tmp_path / "other.h").mkdir()
    assert checksum() is None


def test_without_the_machine_numpy_runs_tapes(monkeypatch: pytest.MonkeyPatch) -> None:
    theta, X = np.array([[12.0, 1.4, 3000.0, 0.01, 80.0]]), np.linspace(-0.2, 0.2, 400)[None]
    y = np.ones(400)
    built = Pacejka().tapes
    monkeypatch.setattr(miho.core.tape, "machine", lambda: None)
    assert built is not None
    own = pickle.loads(pickle.dumps(built))
    assert own[0].in_machine is None
    values = own[0].evaluate(theta, X)[0, 0]
    np.testing.assert_allclose(values, Pacejka().predict(theta, X[0])[0], rtol=1e-13)
    np.testing.assert_allclose(own[0].mean_squares(theta, X, y, 64), np.mean((values - y) ** 2))
    np.testing.assert_allclose(own[1].evaluate(theta, X)[0].T, Pacejka().jacobian(theta[0], X[0]))


class Asking(Expression):
    """An expression that asks for values, so that it cannot be traced."""

    inputs = {"x": "1"}  # noqa: RUF012
    parameters = {"a": "1"}  # noqa: RUF012
    output = "1"
    value = property(lambda self: lambda i, t: t[0] * np.asarray(i[0]))
    derivatives = property(lambda self: lambda i, t: (np.asarray(i[0]),))


def test_what_cannot_be_traced_has_no_tape() -> None:
    assert Asking().tapes is None
    np.testing.assert_array_equal(Asking().predict(np.array([[2.0]]), np.ones(2)), [[2.0, 2.0]])


GOOD: dict[str, Any] = {
    "inputs": 1, "results": 1, "registers": 3, "parameters": 1, "scalars": 3, "constants": (2.0,),
    "once": (Instruction("MUL", (0, 1), (2,)),),
    "code": (Instruction("ADD_S", (0, 2), (2,)), Instruction("EXP", (2,), (1,))), "fills": (),
}  # fmt: skip
BAD: dict[str, dict[str, Any]] = {
    "a register that is not there": {"code": (Instruction("EXP", (3,), (1,)),)},
    "a negative one": {"code": (Instruction("EXP", (-1,), (1,)),)},
    "an input is written": {"code": (Instruction("EXP", (0,), (0,)),)},
    "a result beyond": {"code": (Instruction("EXP", (0,), (3,)),)},
    "a scalar beyond": {"code": (Instruction("ADD_S", (0, 3), (1,)),)},
    "a constant is written": {"once": (Instruction("EXP", (0,), (0,)),)},
    "a parameter is written": {"once": (Instruction("EXP", (0,), (1,)),)},
    "an unknown operation": {"code": (Instruction("NOTHING", (0,), (1,)),)},
    "one with a scalar, once": {"once": (Instruction("ADD_S", (0, 1), (2,)),)},
    "a pair in one place": {"code": (Instruction("SINCOS", (0,), (1, 1)),)},
    "a pair over what it reads": {"code": (Instruction("SINCOS", (2,), (2, 1)),)},
    "a fill of a result": {"fills": ((1, 0),)},
    "a fill beyond": {"fills": ((3, 0),)},
    "a fill of no scalar": {"fills": ((2, 3),)},
    "too few registers": {"registers": 1},
    "no result": {"results": 0},
    "a negative count": {"parameters": -1},
    "too many registers": {"registers": 10**6},
    "more than a number holds": {"registers": 10**12},
    "too few scalars": {"scalars": 1},
    "too long": {"code": (Instruction("EXP", (0,), (1,)),) * 70_000},
}


@needs_machine
@pytest.mark.parametrize("fault", BAD)
def test_bad_tapes_are_refused(fault: str) -> None:
    theta, X = np.array([[3.0]]), np.zeros((1, 5))
    np.testing.assert_allclose(Tape(**GOOD).evaluate(theta, X), np.exp(np.full((1, 1, 5), 6.0)))
    with pytest.raises(TapeError):
        Tape(**GOOD | BAD[fault]).evaluate(theta, X)


@needs_machine
@pytest.mark.parametrize("first", sorted(WITH_SCALAR))
def test_two_operations_with_scalars_round_as_two(first: str) -> None:
    """Where the second takes the place of the first, and where the first is read again."""
    x = np.random.default_rng(9).standard_normal((1, 300))
    x[0, :4] = 0.0, -0.0, np.inf, np.nan
    theta = np.array([[0.3, -1.7]])
    for second in (*WITH_SCALAR, "EXP"):
        for place in (2, 3):
            code = (
                Instruction(first, (0, 0), (2,)),
                Instruction(second, (2, 1)[: 1 + (second != "EXP")], (place,)),
                Instruction("COPY", (2,), (1,)),
            )
            tape = Tape(1, 1, 4, 2, 2, (), (), code, ())
            for rows in (1, 7, 300):
                columns = np.ascontiguousarray(x[:, :rows])
                values, expected = (
                    tape.evaluate(theta, columns)[0],
                    tape.by_numpy(theta[0], columns),
                )
                exact = 1e-15 if second == "EXP" else 0.0
                np.testing.assert_allclose(values, expected, rtol=exact)


@needs_machine
def test_random_tapes_are_refused_or_run() -> None:
    """Whatever the numbers, nothing is read or written beyond the registers."""
    rng = np.random.default_rng(7)
    X, names = rng.standard_normal((2, 300)), list(OPERATIONS)
    ran = 0
    for _ in range(3000):
        code = tuple(
            Instruction(names[rng.integers(len(names))], tuple(rng.integers(-1, 7, 4).tolist()),
                        tuple(rng.integers(-1, 7, 2).tolist()))
            for _ in range(rng.integers(1, 3))
        )  # fmt: skip
        tape = Tape(2, 1, 6, 1, 4, (1.0,), code[:1], code[1:], ((4, 3),))
        try:
            tape.evaluate(np.array([[0.5]]), X)
            ran += 1
        except TapeError:
            pass
    assert ran > 10


@needs_machine
def test_arrays_that_do_not_fit_are_refused() -> None:
    tape = Tape(**GOOD)
    theta, X, out = np.ones((1, 1)), np.ones((1, 5)), np.empty((1, 1, 5))
    held = tape.in_machine
    frozen = out.copy()
    frozen.flags.writeable = False
    for arguments in [
        (theta, X, out[..., :4].copy()), (theta[:, :0], X, out), (theta, X.astype(np.float32), out),
        (theta, X[:, ::2], out), (np.ones((2, 1)), X, out), (theta, X, frozen), (theta, None, out),
        (theta, X[:, :2].copy(), out), (theta, X, np.empty((2, 1, 5))),
    ]:  # fmt: skip
        with pytest.raises((ValueError, TypeError, BufferError)):
            machine().evaluate(held, *arguments)
    with pytest.raises(ValueError, match="rows of X"):
        machine().mean_squares(held, theta, X, np.ones(6), 64, np.empty(1))
    with pytest.raises(ValueError, match="first block"):
        machine().mean_squares(held, theta, X, np.ones(5), 0, np.empty(1))
    with pytest.raises(ValueError, match="level"):
        tape.at_level(7)


@needs_machine
def test_sums_end_early_and_are_the_same_alone() -> None:
    tapes = Pacejka().tapes
    assert tapes is not None
    rng = np.random.default_rng(8)
    X, y = rng.uniform(-0.2, 0.2, (1, 5000)), rng.standard_normal(5000)
    thetas = rng.uniform(1, 2, (5, 5))
    together = tapes[0].mean_squares(thetas, X, y, 64)
    alone = [tapes[0].mean_squares(theta[None], X, y, 64)[0] for theta in thetas]
    assert together.tolist() == alone
    residuals = tapes[0].evaluate(thetas, X)[:, 0] - y
    np.testing.assert_allclose(together, np.mean(residuals**2, axis=1), rtol=1e-13)
