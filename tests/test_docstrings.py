"""Docstrings of public names follow numpydoc and their signatures, and their examples run."""

from __future__ import annotations

import doctest
import inspect
import re
from enum import EnumType
from importlib import import_module
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import pytest

ROOT = Path(__file__).parent.parent
PAGES = [page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs" / "api").glob("*.md"))]
PUBLIC = [
    (re.findall(r"^::: (.+)$", page, re.MULTILINE)[0], name)
    for page in PAGES
    for name in re.findall(r"^        - (\w+)$", page, re.MULTILINE)
]
PUBLIC += [
    (package, name)
    for package in ("baselines.online", "miho.vehicle.driving")  # without a page of the manual
    for name in import_module(package).__all__
]
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
    if found != wanted and (wanted or section(text, "Parameters")):
        messages.append(f"it has the parameters {wanted}, its docstring {found}")
    returns = inspect.isfunction(value) and inspect.signature(value).return_annotation != "None"
    if returns and not section(text, "Returns"):
        messages.append("its docstring has no section Returns")
    return messages


@pytest.mark.parametrize(("package", "name"), PUBLIC)
def test_docstrings_match_signatures(package: str, name: str) -> None:
    value = getattr(import_module(package), name)
    if inspect.isclass(value) or inspect.isfunction(value):
        assert not faults(value)


@pytest.mark.parametrize(("package", "name"), PUBLIC)
def test_sections_of_methods_match_signatures(package: str, name: str) -> None:
    value = getattr(import_module(package), name)
    methods = vars(value).values() if inspect.isclass(value) else ()
    for method in filter(inspect.isfunction, methods):
        found = documented(inspect.getdoc(method) or "")
        assert found in ([], list(inspect.signature(method).parameters)[1:]), method.__qualname__


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_print_what_they_show(name: str) -> None:
    assert not doctest.testmod(import_module(name)).failed


def test_pages_keep_parameters_that_share_a_description_together() -> None:
    griffe = SimpleNamespace(Extension=object, Object=object)
    with patch.dict("sys.modules", griffe=griffe):
        extension = run_path(str(ROOT / "docs" / "templates" / "docstrings.py"))["Markdown"]()
    text = (
        "Draw.\n\nParameters\n----------\nlow, high : float\n    Bounds.\nkind : {'a', 'b'}\n    A."
    )
    value = SimpleNamespace(docstring=SimpleNamespace(value=text))
    extension.on_object(obj=value)
    assert value.docstring.value.split("\n")[4::2] == [
        "low,\u2009high : float",
        'kind : "a",\u2009"b"',
    ]
