"""Signatures of compiled code: what is the same shares one, what differs has one of its own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from miho.compiled import signature
from miho.compiled.compressed import CompressedLoss
from miho.compiled.fused import FusedLoss
from miho.compiled.kernel import Formula
from miho.compiled.signature import signature_of, signed_formulas
from miho.models import Pacejka, TorqueCubic, Trajectory, single_track_response

CAR = {"mass": 800.0, "lf": 1.7, "lr": 1.3, "Izz": 850.0}
X = np.linspace(100, 700, 200)
PACKAGE = [path.stem for path in Path(signature.__file__).parent.glob("*.py")]


def fused() -> str:
    return FusedLoss(Pacejka(), X[None], X, np.arange(X.size))._compiled.losses.__qualname__


def compressed() -> str:
    return CompressedLoss(Pacejka(), X, X)._compiled.losses.__qualname__


def simulated() -> str:
    flat = cast(Trajectory, single_track_response(CAR)).equations.flat
    assert flat is not None
    return signature_of(flat.rates, flat.outputs)


@pytest.mark.parametrize(
    ("name_of", "files"),
    [
        (fused, [*PACKAGE, "tire"]),
        (compressed, [*PACKAGE, "tire"]),
        (simulated, PACKAGE),
    ],
)
def test_an_edit_of_any_file_that_is_compiled_in_gives_another_name(
    name_of: Callable[[], str], files: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = {name_of()}
    text = signature._text
    for file in files:

        def edited(path: str, name: str = f"{file}.py") -> bytes:
            return text(path) + b"#" * (Path(path).name == name)

        monkeypatch.setattr(signature, "_text", edited)
        signature._package.cache_clear()
        names.add(name_of())
    assert len(names) == 1 + len(files)
    monkeypatch.setattr(signature, "_text", text)
    signature._package.cache_clear()
    assert name_of() in names


def test_an_edit_elsewhere_gives_no_other_name(monkeypatch: pytest.MonkeyPatch) -> None:
    name = fused()
    text = signature._text
    monkeypatch.setattr(
        signature, "_text", lambda path: text(path) + b"#" * (Path(path).stem == "axle")
    )
    assert name == fused()


def formula(source: str, **named: object) -> Formula:
    """What a notebook cell defines as f, which stands in no file."""
    exec(source, named)
    return named["f"]  # type: ignore[return-value]


def of(f: Formula, shape: tuple[int, ...] = (1, 1)) -> str:
    return signed_formulas((f,), shape).signature


def test_formulas_count_by_their_code_and_the_numbers_they_use() -> None:
    line = "def f(x, t): return a * t[0] * x[0]"
    equal = [of(formula(line, a=2.0)) for _ in range(2)]
    different = [
        of(formula(line, a=3.0)),
        of(formula(line, a=2.0), (2, 1)),
        of(formula(line.replace("*", "+"), a=2.0)),
        of(TorqueCubic(2.0).value),
        of(TorqueCubic(3.0).value),
    ]
    assert equal[0] == equal[1]
    assert len({equal[0], *different}) == 6


def test_functions_that_a_formula_calls_count_by_their_code() -> None:
    line = "def f(x, t): return g(x[0])"
    first, second, other = (
        of(formula(line, g=formula(f"def f(x): return {body}"))) for body in ("x", "x", "-x")
    )
    assert first == second != other


def test_a_function_that_calls_itself_ends() -> None:
    assert of(formula("def f(x, t): return f(x, t)")) != of(formula("def f(x, t): return x"))


def test_formulas_are_equal_by_their_signature_alone() -> None:
    first, second, other = (
        signed_formulas((TorqueCubic(w).value,), (1, 4)) for w in (700.0, 700.0, 600.0)
    )
    assert first == second
    assert hash(first) == hash(second)
    assert first != other
    (copy,), (original,) = first.copies(), first.formulas
    assert copy.__qualname__ == f"{original.__qualname__}.{first.signature}"
    assert first.signature not in original.__qualname__
    assert copy((X,), (1.0, 2.0, 3.0, 4.0))[7] == original((X,), (1.0, 2.0, 3.0, 4.0))[7]
