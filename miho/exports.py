"""Imports: the exported names of a package are imported at their first use; former names answer."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from types import MappingProxyType


def at_first_use(
    package: str, removed: Mapping[str, str] = MappingProxyType({})
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` (PEP 562) of a package with lazy exports.

    The package imports the names in its __init__ under `if TYPE_CHECKING`, where readers, type
    checkers and `experiments.app.closure` find them. The imports are not executed at run time.
    Modules of the package are available as attributes too.

    Parameters
    ----------
    package : str
        Name of the package, usually `__name__`.
    removed : mapping of str to str, optional
        Former names, each with its successor, for the message of the ImportError.

    Returns
    -------
    tuple of callable
        `__getattr__` and `__dir__`.
    """
    module = sys.modules[package]

    @cache
    def sources() -> dict[str, str]:
        tree = ast.parse(Path(str(module.__file__)).read_bytes())
        imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
        return {alias.name: str(node.module) for node in imports for alias in node.names}

    def get(name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        if name in removed:
            raise ImportError(f"{package}.{name} was removed; {removed[name]}")
        if name in sources():
            value = getattr(import_module(sources()[name]), name)
        else:
            value = _submodule(package, name)
        setattr(module, name, value)
        return value

    def names() -> list[str]:
        from pkgutil import iter_modules

        packages = (part.name for part in iter_modules(module.__path__) if part.ispkg)
        hidden = {"TYPE_CHECKING", at_first_use.__name__}
        return sorted({*vars(module), *sources(), *packages} - hidden)

    return get, names


def _submodule(package: str, name: str) -> object:
    try:
        return import_module(f"{package}.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"{package}.{name}":
            raise
        raise AttributeError(f"module {package!r} has no attribute {name!r}") from None


class FormerNames:
    """The last finder of imports, which names the successor of a former name."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: object = None) -> None:
        """Raise ModuleNotFoundError for a former name."""
        if name.partition(".")[0] not in ("miho", "baselines"):
            return
        from miho.moved import new_name

        new = new_name(name)
        if new is not None:
            raise ModuleNotFoundError(f"{name} is now {new}")


sys.meta_path.append(FormerNames)
