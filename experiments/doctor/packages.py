"""Checks of the installation: the versions that are there against those that pyproject asks for."""

from __future__ import annotations

import platform
import tomllib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from experiments.doctor.check import Check, State

PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"
NEEDED = "experiments"
"""The extra without which no command runs; what others lack is told, and no fault."""


def package_checks(pyproject: Path = PYPROJECT) -> Iterator[Check]:
    """Python, the dependencies, and each extra."""
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    wanted, found = SpecifierSet(project["requires-python"]), platform.python_version()
    if found in wanted:
        yield Check("python", State.OK, found)
    else:
        yield Check("python", State.FAILED, f"{found}; install one that is {wanted}")
    yield _group("packages", project["dependencies"], needed=True)
    for extra, lines in project.get("optional-dependencies", {}).items():
        yield _group(f"extra {extra}", lines, needed=extra == NEEDED)


def _group(name: str, lines: list[str], *, needed: bool) -> Check:
    """Requirements that are met, missing or met by a version out of range."""
    absent, wrong = [], []
    requirements = [Requirement(line) for line in lines]
    here = [one for one in requirements if one.marker is None or one.marker.evaluate()]
    for requirement in here:
        try:
            found = version(requirement.name)
        except PackageNotFoundError:
            absent.append(str(requirement))
            continue
        if not requirement.specifier.contains(found, prereleases=True):
            wrong.append(f"{requirement.name} {found} is not {requirement.specifier}")
    there = len(here) - len(absent)
    told = f"{there} of {len(here)} there"
    if wrong or (absent and needed):
        found_wrong = [*wrong, *(f"{one} is missing" for one in absent if needed)]
        return Check(name, State.FAILED, f"{told}: {', '.join(found_wrong)}; run make install")
    if absent:
        return Check(name, State.OK, f"{told}; without {', '.join(absent)}")
    return Check(name, State.OK, f"{told}, in range")
