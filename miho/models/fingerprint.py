"""Digests of models from their class, settings and the code of their functions."""

from __future__ import annotations

import collections
import dis
import functools
import hashlib
import types
from collections.abc import Collection, Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

WRAPPED = 10
"""Largest number of decorators around a function."""
CLOCK = 1e9, 4e9
"""Range of numbers that are taken as times in seconds since 1970 (years 2001 to 2096)."""
FOUNDATIONS = {"builtins", "abc", "typing", "collections.abc"}
OURS = "miho."
"""Prefix of this package's modules."""
MAKERS = {"__init__", "__new__", "__post_init__"}
Variable = tuple[int, str]
"""The `id` of the cell or of the module's globals, and the name."""


class Seen(set[int]):
    """The `id` of visited functions and objects, and the variables that functions write."""

    def __init__(self, written: set[Variable]) -> None:
        super().__init__()
        self.written = written


def fingerprint(thing: Any) -> str:
    """Return a hexadecimal digest of a model or function, equal in all processes of one Python.

    The digest of an object covers its class with the methods, and its fields. The digest of a
    function covers its code with constants, defaults, closures and the names that it uses from its
    module; comments do not count, numbers do. Imports and classes of MIHO count by name only.

    State that a function can change is excluded: lists, mappings and counters, arrays that it
    fills, attributes that methods write, and files. Values that may differ between processes are
    excluded too: paths and time stamps of the module. A journal therefore compares values in
    addition (`miho.parallel.journal_check`).
    """
    digest, written = hashlib.sha256(), set[Variable]()
    collections.deque(_parts(thing, Seen(written)), maxlen=0)  # collects written variables
    for part in _parts(thing, Seen(written)):
        digest.update(part.encode())
        digest.update(b"\0")
    return digest.hexdigest()


def _parts(thing: Any, seen: Seen) -> Iterator[str]:
    """Yield the parts of a thing as text; functions and objects are visited once."""
    thing = _unwrapped(thing)
    if thing is None or isinstance(thing, bool | int | float | complex | bytes | Enum):
        yield repr(thing)
    elif isinstance(thing, str | Path):
        yield repr(str(thing))
    elif isinstance(thing, np.ndarray | np.generic):
        array = np.asarray(thing)
        yield f"{array.dtype} {array.shape} {hashlib.sha256(array.tobytes()).hexdigest()}"
    elif isinstance(thing, types.CodeType):
        yield from _code(thing, seen)
    elif isinstance(thing, functools.partial):
        yield from _parts((thing.func, thing.args, thing.keywords), seen)
    elif isinstance(thing, types.MethodType):
        yield from _parts((thing.__func__, thing.__self__), seen)
    elif isinstance(thing, type | types.ModuleType | types.BuiltinFunctionType | np.ufunc):
        yield f"{getattr(thing, '__module__', '')}.{thing.__name__}"
    elif isinstance(thing, Mapping):
        yield f"mapping of {len(thing)}"
        for key in sorted(thing, key=repr):
            yield from _parts((key, thing[key]), seen)
    elif isinstance(thing, Collection):
        yield f"{type(thing).__name__} of {len(thing)}"
        unordered = isinstance(thing, set | frozenset)
        for member in sorted(thing, key=repr) if unordered else thing:
            yield from _parts(member, seen)
    elif id(thing) not in seen:
        seen.add(id(thing))
        yield from (_function if isinstance(thing, types.FunctionType) else _object)(thing, seen)


def _object(thing: Any, seen: Seen) -> Iterator[str]:
    """Yield the class of an object and its fields, or its attributes without dataclass fields."""
    yield from _class(type(thing), seen)
    if is_dataclass(thing):
        yield from _parts({f.name: getattr(thing, f.name) for f in fields(thing)}, seen)
        return
    # Attributes that methods write are state, not settings.
    methods = list(_methods(type(thing)))
    written = set[str]().union(*(_names(m, "STORE_ATTR", "DELETE_ATTR") for m in methods))
    fills = any(_names(method, "STORE_SUBSCR", "STORE_SLICE") for method in methods)
    for name, value in sorted(getattr(thing, "__dict__", {}).items()):
        if name not in written and not (fills and isinstance(value, np.ndarray)):
            yield name
            yield from _used(value, type(thing).__module__, seen)


def _methods(kind: type) -> Iterator[types.CodeType]:
    """Yield the code of the methods of a class, without constructors."""
    for ancestor in kind.__mro__:
        for name, member in vars(ancestor).items():
            method = _unwrapped(member)
            if isinstance(method, types.FunctionType) and name not in MAKERS:
                yield method.__code__


def _class(kind: type, seen: Seen) -> Iterator[str]:
    """Yield the names and methods of a class and its base classes."""
    for ancestor in kind.__mro__:
        if ancestor.__module__ in FOUNDATIONS:
            continue
        yield f"{ancestor.__module__}.{ancestor.__qualname__}"
        if ancestor.__module__.startswith(OURS):
            continue
        for name, member in sorted(vars(ancestor).items()):
            member = _unwrapped(member)
            if isinstance(member, types.FunctionType):
                yield from _parts(member, seen)
            elif _is_constant(member) and not name.startswith("__"):
                yield name
                yield from _parts(member, seen)


def _function(function: types.FunctionType, seen: Seen) -> Iterator[str]:
    code = function.__code__
    yield from _parts((code, function.__defaults__, function.__kwdefaults__), seen)
    # Names of its closure and module: numbers and arrays by value, functions by code.
    cells = dict(zip(code.co_freevars, function.__closure__ or (), strict=True))
    members = {name: cell.cell_contents for name, cell in cells.items() if cell != types.CellType()}
    for name in _names(code, "LOAD_GLOBAL", "LOAD_NAME") - cells.keys():
        member = function.__globals__.get(name)
        if name in function.__globals__ and not _is_place_or_stamp(member):
            members[name] = member

    def variable(name: str) -> Variable:
        return id(cells.get(name, function.__globals__)), name

    seen.written.update(map(variable, _names(code, "STORE_DEREF", "DELETE_DEREF") & cells.keys()))
    seen.written.update(map(variable, _names(code, "STORE_GLOBAL", "DELETE_GLOBAL") - cells.keys()))
    fills = _names(code, "STORE_SUBSCR", "STORE_SLICE")
    for name in sorted(members):
        filled = fills and isinstance(members[name], np.ndarray)
        if not filled and variable(name) not in seen.written:
            yield name
            yield from _used(members[name], function.__module__, seen)


def _used(member: Any, module: str, seen: Seen) -> Iterator[str]:
    """Yield a used value: constants and members of the same module by content, others by name."""
    member = _unwrapped(member)
    own = isinstance(member, types.FunctionType) and member.__module__ == module
    if _is_constant(member) or own or isinstance(member, functools.partial | types.MethodType):
        yield from _parts(member, seen)
    elif isinstance(member, type) and member.__module__ == module:
        if id(member) not in seen:
            seen.add(id(member))
            yield from _class(member, seen)
    elif type(member).__module__ == module or isinstance(member, types.SimpleNamespace):
        yield from _parts(member, seen)
    else:
        yield f"{getattr(member, '__module__', '')}.{getattr(member, '__name__', '')}"


def _unwrapped(member: Any) -> Any:
    """Return the function inside decorators of Python, functools or numba; others unchanged."""
    for _ in range(WRAPPED):
        inner = getattr(member, "fget", None) if isinstance(member, property) else None
        if isinstance(member, staticmethod | classmethod):
            inner = member.__func__
        elif isinstance(member, functools.cached_property):
            inner = member.func
        elif inner is None and not isinstance(member, types.FunctionType | type):
            inner = getattr(member, "py_func", None) or getattr(member, "__wrapped__", None)
        if inner is None:
            return member
        member = inner
    return member


def _is_constant(member: Any) -> bool:
    return member is None or isinstance(
        member, bool | int | float | complex | str | bytes | tuple | np.ndarray | np.generic | Path
    )


def _is_place_or_stamp(member: Any) -> bool:
    """Return whether a value is a path, a text with a slash or digit, or a time.

    Such values may be created when the module is loaded: a temporary folder, the time, a random
    name. Times are seconds with a fraction, or integer nanoseconds.
    """
    if isinstance(member, int):
        return 1e9 * CLOCK[0] < member < 1e9 * CLOCK[1]
    if isinstance(member, float):
        return CLOCK[0] < member < CLOCK[1] and not member.is_integer()
    texts = isinstance(member, str) and any(c in "/\\" or c.isdigit() for c in member)
    return texts or isinstance(member, Path)


def _names(code: types.CodeType, *operations: str) -> set[str]:
    """Return the names in some operations of a function and its inner functions."""
    names = {str(i.argval) for i in dis.get_instructions(code) if i.opname in operations}
    inner = (constant for constant in code.co_consts if isinstance(constant, types.CodeType))
    return names.union(*(_names(part, *operations) for part in inner))


def _code(code: types.CodeType, seen: Seen) -> Iterator[str]:
    """Yield instructions, names and constants, without line numbers, files and docstrings."""
    yield code.co_code.hex()
    yield repr((code.co_names, code.co_varnames, code.co_freevars, code.co_argcount))
    documented = code.co_consts[:1] and isinstance(code.co_consts[0], str)
    yield from _parts(code.co_consts[1:] if documented else code.co_consts, seen)
