"""The identity of a run: request, code, data and packages, whose hash names its folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

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
