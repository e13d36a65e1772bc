"""Which of our code a run uses: the modules of its parts, what they import, and so on.

A name that a package passes on, as in `from miho.models import Pacejka`, leads to the module that
defines it and not to all that the package imports: its __init__ is a table of contents, and decides
nothing that a run finds. Imports inside of functions count; those by name at run time are not seen.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path

from miho.study.meaning import meaning_of

INIT = "__init__.py"


class Sources:
    """The modules of some packages, as they were when they were first read.

    `roots` maps the name of a top-level package to its folder; packages in `without` count for
    nothing, like those of others.
    """

    def __init__(self, roots: Mapping[str, Path], without: Collection[str] = ()) -> None:
        self._roots, self._without = dict(roots), tuple(f"{name}." for name in without)
        self._modules: dict[str, Module | None] = {}

    def digest(self, modules: Iterable[str]) -> str:
        """SHA-256 over the names and the meaning of these modules and of all that they use."""
        digest = hashlib.sha256()
        for name, module in sorted(self._reached(modules).items()):
            digest.update(f"\0{name}\0{module.meaning}".encode())
        return digest.hexdigest()

    def closure(self, modules: Iterable[str]) -> list[str]:
        """The names of these modules and of all that they use, sorted; those of others are not."""
        return sorted(self._reached(modules))

    def _reached(self, modules: Iterable[str]) -> dict[str, Module]:
        waiting, reached = set(modules), dict[str, Module]()
        while waiting:
            name = waiting.pop()
            module = self._module(name)
            if module is not None and name not in reached:
                reached[name] = module
                waiting |= {self._defining(*source) for source in module.imports}
        return reached

    def _defining(self, module: str, name: str | None) -> str:
        """The module that defines what is imported from a module, or the module that it is."""
        if name is None:
            return module
        if self._module(f"{module}.{name}") is not None:
            return f"{module}.{name}"
        package = self._module(module)
        if package is None or name not in package.passed_on:
            return module
        return self._defining(*package.passed_on[name])

    def _module(self, name: str) -> Module | None:
        if name not in self._modules:
            self._modules[name] = self._read(name)
        return self._modules[name]

    def _read(self, name: str) -> Module | None:
        top, *rest = name.split(".")
        if top not in self._roots or f"{name}.".startswith(self._without):
            return None
        place = self._roots[top].joinpath(*rest)
        for path in (place / INIT, place.with_name(f"{place.name}.py")):
            if path.is_file():
                return Module(name, path)
        return None


class Module:
    """One file: what it imports, as (module, name in it or None for the module itself)."""

    def __init__(self, name: str, path: Path) -> None:
        self.name, self.is_package = name, path.name == INIT
        self._tree = ast.parse(path.read_bytes())

    @cached_property
    def meaning(self) -> str:
        """What Python makes of the text."""
        return meaning_of(self._tree)

    @cached_property
    def imports(self) -> frozenset[tuple[str, str | None]]:
        """All that it imports, wherever in the file."""
        return frozenset(source for _, source in self._bound())

    @cached_property
    def passed_on(self) -> dict[str, tuple[str, str | None]]:
        """What a package imports only to pass it on, by the name under which it does."""
        return dict(self._bound()) if self.is_package else {}

    def _bound(self) -> Iterator[tuple[str, tuple[str, str | None]]]:
        for node in ast.walk(self._tree):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    yield alias.asname or alias.name, (alias.name, None)
            elif isinstance(node, ast.ImportFrom):
                module = self._absolute(node)
                for alias in node.names:
                    yield alias.asname or alias.name, (module, alias.name)

    def _absolute(self, node: ast.ImportFrom) -> str:
        if not node.level:
            return node.module or ""
        parts = self.name.split(".")
        folder = parts[: len(parts) - node.level + self.is_package]
        return ".".join([*folder, *([node.module] if node.module else [])])
