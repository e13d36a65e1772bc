"""Checks of the installed packages against pyproject.toml: Python, dependencies and extras."""

from __future__ import annotations

import platform
import tomllib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from experiments.diagnosis.machine import Check, Severity

PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"
NEEDED = "experiments"
"""The extra that all commands need; missing packages of other extras are no failure."""


def package_checks(pyproject: Path = PYPROJECT) -> Iterator[Check]:
    """Check Python, the dependencies, and each extra."""
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    supported, running = SpecifierSet(project["requires-python"]), platform.python_version()
    if running in supported:
        yield Check("python", Severity.OK, running)
    else:
        yield Check("python", Severity.FAILED, f"{running}; install one that is {supported}")
    yield _group("packages", project["dependencies"], needed=True)
    for extra, lines in project.get("optional-dependencies", {}).items():
        yield _group(f"extra {extra}", lines, needed=extra == NEEDED)


def _group(name: str, lines: list[str], *, needed: bool) -> Check:
    """Check which requirements are met, missing, or have a version out of range."""
    absent, out_of_range = [], []
    requirements = [Requirement(line) for line in lines]
    applicable = [r for r in requirements if r.marker is None or r.marker.evaluate()]
    for requirement in applicable:
        try:
            installed = version(requirement.name)
        except PackageNotFoundError:
            absent.append(str(requirement))
            continue
        if not requirement.specifier.contains(installed, prereleases=True):
            out_of_range.append(f"{requirement.name} {installed} is not {requirement.specifier}")
    message = f"{len(applicable) - len(absent)} of {len(applicable)} installed"
    if out_of_range or (absent and needed):
        faults = [*out_of_range, *(f"{line} is missing" for line in absent if needed)]
        return Check(name, Severity.FAILED, f"{message}: {', '.join(faults)}; run make install")
    if absent:
        return Check(name, Severity.OK, f"{message}; without {', '.join(absent)}")
    return Check(name, Severity.OK, f"{message}, in range")
