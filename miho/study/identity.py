"""What makes two runs the same run."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from miho.optim.validate import whole
from miho.study.places import check_name

UNHEEDED = ("kind", "type_comment", "type_ignores")
"""Of a syntax tree: how a text is spelt, and comments."""
REQUEST = 10
"""Hexadecimal digits of each half of a run's id."""
LARGEST_SEED = 2**63 - 1
"""Tables of runs hold seeds as integers of 64 bits."""


def canonical(value: Any) -> str:
    """One JSON text per value: sorted keys, no spaces, no NaN."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def sha256(text: str | bytes) -> str:
    """Hexadecimal SHA-256."""
    return hashlib.sha256(text.encode() if isinstance(text, str) else text).hexdigest()


def code_digest(places: Iterable[Path]) -> str:
    """SHA-256 over the names and the meaning of these Python files and all below these folders.

    What Python makes of the text counts: comments, docstrings and layout do not.
    """
    digest = hashlib.sha256()
    for place in places:
        for path in [place] if place.is_file() else sorted(place.rglob("*.py")):
            name = path.relative_to(place.parent).as_posix()
            digest.update(f"\0{name}\0{meaning(path.read_bytes())}".encode())
    return digest.hexdigest()


def meaning(source: bytes) -> str:
    """The syntax tree of a program as text, without docstrings; raises SyntaxError.

    Every Python that can read the program gives the same: fields that hold nothing are left out,
    since versions differ in which there are, and so is what is not ASCII, since they differ in what
    can be printed. `ast.dump` heeds neither.
    """
    return _normal(ast.parse(source))


def _normal(node: Any) -> str:
    if isinstance(node, ast.AST):
        fields = {name: value for name, value in ast.iter_fields(node) if name not in UNHEEDED}
        if isinstance(fields.get("body"), list):
            fields["body"] = [line for line in fields["body"] if not _is_text(line)]
        if isinstance(node, ast.JoinedStr):  # 3.12 has empty texts between its parts
            fields["values"] = [part for part in node.values if not _is_empty_text(part)]
        named = (f"{name}={_normal(value)}" for name, value in fields.items() if not _empty(value))
        return f"{type(node).__name__}({','.join(named)})"
    if isinstance(node, list):
        return f"[{','.join(map(_normal, node))}]"
    return ascii(node)


def _is_empty_text(part: ast.expr) -> bool:
    return isinstance(part, ast.Constant) and part.value == ""


def _empty(value: Any) -> bool:
    return value is None or value == []


def _is_text(line: ast.AST) -> bool:
    """Whether a line is a string alone, which does nothing."""
    alone = isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant)
    return alone and isinstance(line.value.value, str)  # type: ignore[attr-defined]


@dataclass(frozen=True)
class Identity:
    """The content that keys a run.

    Names, seed and resolved configuration say what was asked; digests of code and data and versions
    of packages say what of. The same request of something else is another run.
    `problem` and `optimizer` become folder names and must be plain words.
    """

    problem: str
    optimizer: str
    seed: int
    config: Mapping[str, Any]
    code: str
    data: str
    packages: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for what in ("problem", "optimizer"):
            check_name(what, getattr(self, what))
        whole("seed", self.seed, 0, LARGEST_SEED)

    @cached_property
    def request(self) -> str:
        """Ten hexadecimal digits of the hash of what was asked."""
        asked = (self.problem, self.optimizer, self.seed, dict(self.config))
        return sha256(canonical(asked))[:REQUEST]

    @cached_property
    def id(self) -> str:
        """The request, and ten hexadecimal digits of the hash of what it was asked of."""
        asked_of = sha256(canonical([self.code, self.data, dict(self.packages)]))
        return self.request + asked_of[:REQUEST]
