"""The identity of a run: request, code, data and packages, whose hash names its folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from miho.study.meaning import meaning
from miho.study.places import check_name
from miho.validate import whole

REQUEST = 10
"""Hexadecimal digits of each half of a run's id."""
LARGEST_SEED = 2**63 - 1
"""Largest seed: tables of runs store seeds as integers of 64 bits."""


def canonical(value: Any) -> str:
    """A unique JSON text of a value: sorted keys, no spaces, no NaN."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def sha256(text: str | bytes) -> str:
    """Hexadecimal SHA-256."""
    return hashlib.sha256(text.encode() if isinstance(text, str) else text).hexdigest()


def code_digest(places: Iterable[Path]) -> str:
    """Digest of Python files and of all Python files in folders.

    Comments, docstrings and layout do not count. C files in the folders are included as bytes.

    Parameters
    ----------
    places : iterable of Path
        Files and folders.

    Returns
    -------
    str
        SHA-256 over the names and the meaning of the files.
    """
    digest = hashlib.sha256()
    for place in places:
        for path in [place] if place.is_file() else sorted(place.rglob("*.py")):
            name = path.relative_to(place.parent).as_posix()
            digest.update(f"\0{name}\0{meaning(path.read_bytes())}".encode())
        for path in [] if place.is_file() else sorted(place.rglob("*.[ch]")):
            digest.update(f"\0{path.name}\0".encode() + path.read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class Identity:
    """The contents that identify a run.

    Names, seed and configuration are the request. Digests of code and data and versions of packages
    are its origin. The same request with another origin is another run.

    Parameters
    ----------
    problem, optimizer : str
        Names, which become folders and must be plain words.
    seed : int
        Seed of the run.
    config : mapping
        Resolved configuration.
    code, data : str
        Digests of code and data.
    packages : mapping of str to str
        Versions of packages.

    Raises
    ------
    ValueError
        If a name cannot name a folder or the seed is not valid.
    """

    problem: str
    optimizer: str
    seed: int
    config: Mapping[str, Any]
    code: str
    data: str
    packages: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("problem", "optimizer"):
            check_name(name, getattr(self, name))
        whole("seed", self.seed, 0, LARGEST_SEED)

    @cached_property
    def request(self) -> str:
        """Ten hexadecimal digits of the hash of names, seed and configuration."""
        content = (self.problem, self.optimizer, self.seed, dict(self.config))
        return sha256(canonical(content))[:REQUEST]

    @cached_property
    def id(self) -> str:
        """The request, and ten hexadecimal digits of the hash of its origin."""
        origin = sha256(canonical([self.code, self.data, dict(self.packages)]))
        return self.request + origin[:REQUEST]
