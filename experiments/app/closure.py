"""The import closure of a run: the modules of its parts and, recursively, their imports.

A name that a package re-exports, as in `from miho.models import Pacejka`, leads to the module that
defines it, not to all imports of the package: the package's __init__ is a table of contents on
which no result depends. Imports inside functions count. Imports by name at run time are not
detected.

The contents of a file can be cached for other processes, under the digest of the file's bytes.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import json
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from experiments.app.meaning import meaning_of
from miho.core.tape import c_sources
from miho.study.files import write_bytes

INIT = "__init__.py"


class Sources:
    """The modules of some packages, as they were when first read.

    Parameters
    ----------
    roots : mapping of str to Path
        Folders of top-level packages. Imports of other packages are not followed.
    excluded : collection of str
        Packages whose imports are not followed.
    cache : Path, optional
        Cache file. If it cannot be written, or if Python writes no bytecode, all files are read
        again.
    """

    def __init__(
        self, roots: Mapping[str, Path], excluded: Collection[str] = (), cache: Path | None = None
    ) -> None:
        self._roots, self._excluded = dict(roots), tuple(f"{name}." for name in excluded)
        self._modules: dict[str, Module | None] = {}
        self._cache = cache

    def digest(self, modules: Iterable[str]) -> str:
        """SHA-256 over the names and the meaning of these modules and their import closure.

        C files in the same folders are included, without hidden files and whatever their line
        endings.
        """
        digest, closure = hashlib.sha256(), self._closure(modules)
        for name, module in sorted(closure.items()):
            digest.update(f"\0{name}\0{module.meaning}".encode())
        folders = {module.folder for module in closure.values()}
        for folder in sorted(folders):
            for name, text in c_sources(folder).items():
                digest.update(f"\0{name}\0".encode() + text)
        return digest.hexdigest()

    def closure(self, modules: Iterable[str]) -> list[str]:
        """Sorted names of these modules and their import closure within `roots`."""
        return sorted(self._closure(modules))

    def _closure(self, modules: Iterable[str]) -> dict[str, Module]:
        waiting, reached = set(modules), dict[str, Module]()
        while waiting:
            name = waiting.pop()
            module = self._module(name)
            if module is not None and name not in reached:
                reached[name] = module
                waiting |= {self._defining_module(*source) for source in module.imports}
        self._write_records()
        return reached

    def _defining_module(self, module: str, name: str | None) -> str:
        """The module that defines an imported name, or the module that is imported."""
        if name is None:
            return module
        if self._module(f"{module}.{name}") is not None:
            return f"{module}.{name}"
        package = self._module(module)
        if package is None or name not in package.reexports:
            return module
        return self._defining_module(*package.reexports[name])

    def _module(self, name: str) -> Module | None:
        if name not in self._modules:
            self._modules[name] = self._read(name)
        return self._modules[name]

    def _read(self, name: str) -> Module | None:
        top, *rest = name.split(".")
        if top not in self._roots or f"{name}.".startswith(self._excluded):
            return None
        place = self._roots[top].joinpath(*rest)
        for path in (place / INIT, place.with_name(f"{place.name}.py")):
            if path.is_file():
                return Module(name, path, self._records.get(name))
        return None

    @cached_property
    def _records(self) -> dict[str, Any]:
        """Cached records by module; empty if the file is damaged or was written by other code."""
        if self._cache is None:
            return {}
        try:
            head, _, body = self._cache.read_bytes().partition(b"\n")
        except OSError:
            return {}
        return dict(json.loads(body)) if head == _header(body) else {}

    def _write_records(self) -> None:
        """Write the cache if there are new records."""
        if self._cache is None or sys.dont_write_bytecode:
            return
        records = {name: module.record for name, module in self._modules.items() if module}
        if records.items() <= self._records.items():
            return
        body = json.dumps(self._records | records, sort_keys=True).encode()
        with contextlib.suppress(OSError):
            self._cache.parent.mkdir(exist_ok=True)
            write_bytes(self._cache, _header(body) + b"\n" + body)


def _header(body: bytes) -> bytes:
    """The cache's first line: a digest of its records and of the code that made them."""
    reader = Path(__file__)
    code = reader.read_bytes() + reader.with_name("meaning.py").read_bytes()
    return hashlib.sha256(code + body).hexdigest().encode()


class Module:
    """A file and its imports, as (module, name in it or None for the module itself).

    `record` is the cached record of a module with this name.
    """

    def __init__(self, name: str, path: Path, record: dict[str, Any] | None = None) -> None:
        self.name, self.folder, self.is_package = name, path.parent, path.name == INIT
        source = path.read_bytes()
        digest = hashlib.sha256(source).hexdigest()
        if record is None or record["file"] != [self.is_package, digest]:
            tree = ast.parse(source)
            record = {
                "file": [self.is_package, digest],
                "meaning": hashlib.sha256(meaning_of(tree).encode()).hexdigest(),
                "bound": [list(binding) for binding in self._bindings(tree)],
            }
        self.record = record

    @property
    def meaning(self) -> str:
        """Digest of the program's meaning."""
        return str(self.record["meaning"])

    @cached_property
    def imports(self) -> frozenset[tuple[str, str | None]]:
        """All imports, anywhere in the file."""
        return frozenset((module, name) for _, module, name in self.record["bound"])

    @cached_property
    def reexports(self) -> dict[str, tuple[str, str | None]]:
        """Names that a package imports so that others can import them from it."""
        if not self.is_package:
            return {}
        return {alias: (module, name) for alias, module, name in self.record["bound"]}

    def _bindings(self, tree: ast.AST) -> Iterator[tuple[str, str, str | None]]:
        """Each name that an import binds, with its module and its name in that module."""
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    yield alias.asname or alias.name, alias.name, None
            elif isinstance(node, ast.ImportFrom):
                module = self._absolute(node)
                for alias in node.names:
                    yield alias.asname or alias.name, module, alias.name

    def _absolute(self, node: ast.ImportFrom) -> str:
        if not node.level:
            return node.module or ""
        parts = self.name.split(".")
        folder = parts[: len(parts) - node.level + self.is_package]
        return ".".join([*folder, *([node.module] if node.module else [])])
