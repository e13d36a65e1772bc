"""Signatures of compiled code: what is the same shares one, what differs has one of its own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from miho.identification.compressed import CompressedLoss
from miho.identification.fused import FusedLoss
from miho.models import Pacejka, TorqueCubic, signature, single_track_response
from miho.models.expression import Formula
from miho.models.signature import signature_of, signed_formulas

X = np.linspace(100, 700, 200)
FUSED = ["elementary", "signature", "climb", "panels", "panel_sums", "fused"]


def fused() -> Callable[..., Any]:
    return FusedLoss(Pacejka(), X[None], X, np.arange(X.size))._compiled.losses


def compressed() -> Callable[..., Any]:
    return CompressedLoss(Pacejka(), X, X)._compiled.losses


@pytest.mark.parametrize(
    ("kernel", "files"),
    [
        (fused, [*FUSED, "tire"]),
        (compressed, [*FUSED, "compressed", "tire"]),
    ],
)
def test_an_edit_of_any_file_that_is_compiled_in_gives_another_name(
    kernel: Callable[[], Any], files: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = {kernel().__qualname__}
    text = signature._text
    for file in files:

        def edited(path: str, name: str = f"{file}.py") -> bytes:
            return text(path) + b"#" * (Path(path).name == name)

        monkeypatch.setattr(signature, "_text", edited)
        names.add(kernel().__qualname__)
    assert len(names) == 1 + len(files)
    monkeypatch.setattr(signature, "_text", text)
    assert kernel().__qualname__ in names


def test_a_simulated_model_is_named_after_its_elementary_functions() -> None:
    assert single_track_response._yaw_rates.__qualname__ == f"_yaw_rates.{signature_of()}"


def test_a_file_counts_by_its_content(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a.py", "b.py", "c.py")]
    for path, text in zip(paths, ("1", "1", "2"), strict=True):
        path.write_text(text, encoding="utf-8")
    a, b, c = (signature_of(str(path)) for path in paths)
    assert a == b
    assert len({a, c, signature_of()}) == 3


def formula(source: str, **named: object) -> Formula:
    """What a notebook cell defines as f, which stands in no file."""
    exec(source, named)
    return named["f"]  # type: ignore[return-value]


def of(f: Formula, shape: tuple[int, ...] = (1, 1)) -> str:
    return signed_formulas((f,), shape).signature


def test_formulas_count_by_their_code_and_the_numbers_they_use() -> None:
    line = "def f(x, t): return a * t[0] * x[0]"
    same = [of(formula(line, a=2.0)) for _ in range(2)]
    others = [
        of(formula(line, a=3.0)),
        of(formula(line, a=2.0), (2, 1)),
        of(formula(line.replace("*", "+"), a=2.0)),
        of(TorqueCubic(2.0).value),
        of(TorqueCubic(3.0).value),
    ]
    assert same[0] == same[1]
    assert len({same[0], *others}) == 6


def test_functions_that_a_formula_calls_count_by_their_code() -> None:
    line = "def f(x, t): return g(x[0])"
    once, again, other = (
        of(formula(line, g=formula(f"def f(x): return {body}"))) for body in ("x", "x", "-x")
    )
    assert once == again != other


def test_a_function_that_calls_itself_ends() -> None:
    assert of(formula("def f(x, t): return f(x, t)")) != of(formula("def f(x, t): return x"))


def test_formulas_are_equal_by_their_signature_alone() -> None:
    first, again, other = (
        signed_formulas((TorqueCubic(w).value,), (1, 4)) for w in (700.0, 700.0, 600.0)
    )
    assert first == again
    assert hash(first) == hash(again)
    assert first != other
    (copy,), (original,) = first.copies(), first.formulas
    assert copy.__qualname__ == f"{original.__qualname__}.{first.signature}"
    assert first.signature not in original.__qualname__
    assert copy((X,), (1.0, 2.0, 3.0, 4.0))[7] == original((X,), (1.0, 2.0, 3.0, 4.0))[7]
