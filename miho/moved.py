"""Former names: an import of one raises an error of one line with the new name."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec

MODULES = {"miho.driving": "miho.vehicle.driving"}
"""New names of modules."""
PACKAGES = {"miho.data": "miho.vehicle.data", "miho.models": "miho.vehicle.models"}
"""Packages of which some names and modules moved to another package."""


def new_name(name: str) -> str | None:
    """Return the new dotted name of a former module or public name, None for other names."""
    package, _, member = name.rpartition(".")
    if package in PACKAGES:
        home = PACKAGES[package]
        if member in import_module(home).__all__ or find_spec(f"{home}.{member}"):
            return f"{home}.{member}"
    return MODULES.get(name)


class FormerNames:
    """The last finder of imports, which names the successor of a former name."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: object = None) -> None:
        """Raise ModuleNotFoundError for a former name."""
        new = new_name(name)
        if new is not None:
            raise ModuleNotFoundError(f"{name} is now {new}")


sys.meta_path.append(FormerNames)
