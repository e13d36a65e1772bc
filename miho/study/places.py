"""Names that may become folders, and folders that stay below their root."""

from __future__ import annotations

import errno
import re
from pathlib import Path

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
