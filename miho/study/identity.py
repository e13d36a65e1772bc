"""The identity of a run: request, code, data and packages, whose hash names its folder.

Also the names that may become folders, and folders that stay below their root.
"""

from __future__ import annotations

import errno
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from miho.validate import whole

NAME = re.compile(r"[A-Za-z0-9_](?:[A-Za-z0-9_.-]{0,98}[A-Za-z0-9_-])?")
DEVICES = re.compile(r"(?:con|prn|aux|nul|com[0-9]|lpt[0-9])(?:\..*)?", re.IGNORECASE)
"""Names under which Windows opens a device, with any extension; see "Naming Files, Paths, and
Namespaces" in the documentation of the Win32 API."""


def check_name(field: str, name: object) -> str:
    """Return the name if it can name a folder on every system; else raise ValueError.

    Only ASCII letters, digits and punctuation are allowed, so that names that look alike are equal.
    """
    if isinstance(name, str) and NAME.fullmatch(name) and not DEVICES.fullmatch(name):
        return name
    quoted = repr(name)
    quoted = quoted if len(quoted) <= 110 else f"{quoted[:110]}..."
    raise ValueError(
        f"{field} name {quoted} cannot name a folder; use letters, digits, '_', '-' and '.', "
        "at most 100, no '.' at either end and no name of a device like CON"
    )


def inside(root: Path, *names: str) -> Path:
    """Path root/names[0]/names[1]/...; raises PermissionError if it is not below the root.

    The root may be reached through links. Below it, a link in a received folder must not lead
    elsewhere: nothing is written through it.
    """
    place = root
    for name in names:
        place = place / name
        if len(Path(name).parts) != 1 or name == ".." or not below(place, root):
            problem = "leads out of the folder of results; remove it, or choose another root"
            raise PermissionError(errno.EPERM, problem, str(place))
    return place


def below(place: Path, root: Path) -> bool:
    """Return whether a path, with all links resolved, is below the root.

    False for a link to itself or to nothing, whose later target is unknown.
    """
    if not place.is_symlink():
        return True
    try:
        return place.resolve(strict=True).is_relative_to(root.resolve())
    except (OSError, RuntimeError):  # a loop raises RuntimeError until Python 3.13
        return False


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
