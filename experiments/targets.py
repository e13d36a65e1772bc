"""Which classes and functions a configuration may name, decided before anything is imported."""

from __future__ import annotations

import ast
import importlib
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

import baselines
import miho.data
import miho.identification
import miho.methods
import miho.models
import miho.optim
from miho.data import Dataset
from miho.identification import Loss
from miho.models import Model
from miho.optim import AskTell, Optimizer

T = TypeVar("T")

HOMES: Mapping[type, tuple[ModuleType, ...]] = {
    Model: (miho.models,),
    Dataset: (miho.data,),
    Loss: (miho.identification,),
    Optimizer: (miho.optim, miho.methods),
}
"""Where targets of each kind come from: what `__all__` of these packages names."""

METHODS = Path(baselines.__file__).parent
OURS = miho.methods.__name__
BASES = {Optimizer.__name__, AskTell.__name__}
SHOWN = 80


class TargetError(ValueError):
    """What is wrong with a target and which are allowed, in one line."""


def find_target(path: object, kind: type[T]) -> Callable[..., T]:
    """The class or function at a dotted path that makes a `kind`.

    Allowed are the public names of our packages and the methods in `baselines`, those that it has
    from `miho.methods` included, found by reading their source; only what is allowed is imported.
    Raises TargetError for any other path, and ImportError where the library that a method wraps is
    missing.
    """
    home, _, name = path.rpartition(".") if isinstance(path, str) else ("", "", "")
    for package in HOMES[kind]:
        if home == package.__name__ and name in _public(package, kind):
            return cast(Callable[..., T], getattr(package, name))
    parent, _, module = home.rpartition(".")
    if kind is Optimizer and parent == baselines.__name__ and name in _methods(module):
        return cast(Callable[..., T], getattr(importlib.import_module(home), name))
    raise TargetError(
        f"{_shown(path)} is not a class or function that gives a {kind.__name__}; "
        f"allowed are {', '.join(allowed(kind))}"
    )


def allowed(kind: type) -> list[str]:
    """Every dotted path that a configuration may name for this kind."""
    names = [f"{home.__name__}.{name}" for home in HOMES[kind] for name in _public(home, kind)]
    if kind is Optimizer:
        for file in sorted(METHODS.glob("*.py")):
            names += [f"{baselines.__name__}.{file.stem}.{name}" for name in _methods(file.stem)]
    return names


def nested_target(value: Any, place: str) -> str | None:
    """The key path of a target inside of a setting, where none belongs; None if there is none."""
    if isinstance(value, Mapping):
        if "_target_" in value:
            return f"{place}._target_"
        inner = [(f"{place}.{key}", part) for key, part in value.items()]
    elif isinstance(value, list):
        inner = [(f"{place}[{index}]", part) for index, part in enumerate(value)]
    else:
        return None
    found = (nested_target(part, key) for key, part in inner)
    return next((key for key in found if key), None)


def _public(home: ModuleType, kind: type) -> list[str]:
    return [name for name in home.__all__ if _gives(getattr(home, name), kind)]


def _gives(found: Any, kind: type) -> bool:
    if inspect.isclass(found):
        return issubclass(found, kind) and not inspect.isabstract(found)
    return inspect.isfunction(found) and (
        inspect.get_annotations(found).get("return") == kind.__name__
    )


def _methods(module: str) -> list[str]:
    """The methods in one module of `baselines`, read from its source and not imported."""
    file = METHODS / f"{module}.py"
    if not (module.isascii() and module.isidentifier() and file.is_file()):
        return []
    names: list[str] = []
    for node in ast.parse(file.read_bytes()).body:
        if isinstance(node, ast.ClassDef) and BASES & {_base(base) for base in node.bases}:
            names.append(node.name)
        elif isinstance(node, ast.ImportFrom) and node.module == f"{OURS}.{module}":
            names += [alias.name for alias in node.names if alias.name in miho.methods.__all__]
    return [name for name in names if not name.startswith("_")]


def _base(node: ast.expr) -> str:
    """The bare name of a base class: `AskTell` of `AskTell[State]` or `miho.AskTell`."""
    if isinstance(node, ast.Subscript):
        return _base(node.value)
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def _shown(path: object) -> str:
    text = repr(path)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."
