"""What makes two runs the same run."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")


def canonical(value: Any) -> str:
    """One JSON text per value: sorted keys, no spaces, no NaN."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def sha256(text: str | bytes) -> str:
    """Hexadecimal SHA-256."""
    return hashlib.sha256(text.encode() if isinstance(text, str) else text).hexdigest()


def code_digest(places: Iterable[Path]) -> str:
    """SHA-256 over the names and texts of these Python files and all below these folders."""
    digest = hashlib.sha256()
    for place in places:
        for path in [place] if place.is_file() else sorted(place.rglob("*.py")):
            name = path.relative_to(place.parent).as_posix()
            digest.update(f"\0{name}\0".encode() + path.read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class Identity:
    """The content that keys a run: names, seed, resolved configuration, digests of code and data.

    `problem` and `optimizer` become folder names and must be plain words.
    """

    problem: str
    optimizer: str
    seed: int
    config: Mapping[str, Any]
    code: str
    data: str

    def __post_init__(self) -> None:
        for field in ("problem", "optimizer"):
            name = getattr(self, field)
            if not NAME.fullmatch(name):
                raise ValueError(
                    f"{field} name {name!r} cannot name a folder; use letters, digits, "
                    "'_', '-' and '.', at most 100"
                )

    @property
    def id(self) -> str:
        """The first 16 hexadecimal digits of the hash of everything above."""
        return sha256(canonical(vars(self)))[:16]
