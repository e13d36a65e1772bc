"""Docstrings of public names follow numpydoc and their signatures, and their examples run."""

from __future__ import annotations

import doctest
import inspect
import re
from enum import EnumType
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = [
    re.findall(r"^::: (.+)$", page.read_text(), re.MULTILINE)[0]
    for page in sorted((ROOT / "docs" / "api").glob("*.md"))
]
PUBLIC = {
    f"{value.__module__}.{value.__qualname__}": value
    for package in map(import_module, PACKAGES)
    for value in (getattr(package, name) for name in package.__all__)
    if inspect.isfunction(value) or inspect.isclass(value)
}
PENDING = {
    "miho.fitting": "Fit fit fit_many",
    "miho.models": "Axle Brake BrakeCommand EngineMap FmuModel FrontRear FunctionModel Identified "
    "LateralMagicFormula LoadSensitivity Longitudinal PublishedModel SimplifiedTire SingleTrack "
    "TireFormula TorqueCubic TorqueCurve Trajectory central_stiffness cornering_stiffness "
    "from_simplified load_function load_tir load_trajectory mf61_lateral play read_parameters "
    "simplify single_track_drive single_track_response write_tir",
    "miho.optim": "Agreement Arrivals AsynchronousMIHO AsynchronousMIHOGN Budget Checkpoint Clock "
    "Descent Descents MIHO MIHOGN MIHOQN Meter Minimum Oracle Parameter RandomSearch RunRecord "
    "Rung Space Starts Trace agreement hyperband_table in_optimum minimize",
}
"""Names whose docstrings do not list their parameters yet; take a name out with its rewrite."""
EXAMPLES = [
    path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
    for folder in ("miho", "baselines")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]


def section(text: str, title: str) -> list[str]:
    """The lines of a section; none if the docstring has no such section."""
    found = re.search(
        rf"^{title}\n-+\n(.*?)(?=\n\n\S[^\n]*\n-+\n|\Z)", text, re.DOTALL | re.MULTILINE
    )
    return found[1].splitlines() if found else []


def documented(text: str) -> list[str]:
    """The names in the section Parameters, or in Attributes of a record."""
    lines = section(text, "Parameters") or section(text, "Attributes")
    heads = [line.partition(" : ")[0] for line in lines if line and not line[0].isspace()]
    return [name.strip(" *") for head in heads for name in head.split(",")]


def parameters(value: Any) -> list[str]:
    """The parameters of a function or of a class of ours that is not an enumeration."""
    of_ours = inspect.isfunction(value) or inspect.isfunction(value.__init__)
    if not (of_ours or issubclass(value, tuple)) or isinstance(value, EnumType):
        return []
    return list(inspect.signature(value).parameters)


def faults(value: Any) -> list[str]:
    """The differences between a docstring and a signature."""
    text = inspect.getdoc(value) or ""
    summary = text.partition("\n\n")[0]
    found, wanted = documented(text), parameters(value)
    messages = [] if summary and "\n" not in summary else ["its summary is not one line"]
    if found != wanted:
        messages.append(f"it has the parameters {wanted}, its docstring {found}")
    returns = inspect.isfunction(value) and inspect.signature(value).return_annotation != "None"
    if returns and not section(text, "Returns"):
        messages.append("its docstring has no section Returns")
    return messages


def is_pending(name: str) -> bool:
    """Whether a name stands in `PENDING`."""
    package = ".".join(name.split(".")[:2])
    return name.rpartition(".")[2] in PENDING.get(package, "").split()


@pytest.mark.parametrize("name", PUBLIC)
def test_docstrings_match_signatures(name: str, request: pytest.FixtureRequest) -> None:
    if is_pending(name):
        request.applymarker(pytest.mark.xfail(reason="pending", strict=False))
    assert not faults(PUBLIC[name])


@pytest.mark.parametrize("name", [name for name, value in PUBLIC.items() if inspect.isclass(value)])
def test_sections_of_methods_match_signatures(name: str) -> None:
    for method in filter(inspect.isfunction, vars(PUBLIC[name]).values()):
        found = documented(inspect.getdoc(method) or "")
        assert found in ([], list(inspect.signature(method).parameters)[1:]), method.__qualname__


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_print_what_they_show(name: str) -> None:
    failed, attempted = doctest.testmod(import_module(name))
    assert attempted and not failed
