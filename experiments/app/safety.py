"""Checks of configurations before they are used.

A model, dataset, loss or method names its target. Only public classes and functions of our packages
are allowed, so a stored result or a received experiment cannot run other code, except a file that
the user names (see `instantiation`). The size of YAML files is limited, because aliases can expand
beyond any memory. A stored run must not contain a secret. Settings of Hydra, such as callbacks and
launchers, come only from the command line, from conf/ or from --config-dir, and never from a stored
result.
"""

import ast
import importlib
import inspect
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

import yaml
from omegaconf import OmegaConf
from omegaconf.resolvers import oc

import baselines.online
import baselines.problems
import miho.data
import miho.identification
import miho.methods
import miho.models
import miho.online
import miho.optim
import miho.vehicle.data
import miho.vehicle.models
from baselines.online import Stream
from experiments.app.explain import ConfigError
from experiments.app.options import source
from miho import AskTell, Dataset, Optimizer
from miho.identification import Loss
from miho.models import Model
from miho.moved import new_name
from miho.online import OnlineMethod
from miho.study.redaction import holds_secret, names_secret, redacted

T = TypeVar("T")

HOMES: Mapping[type, tuple[ModuleType, ...]] = {
    Model: (miho.models, miho.vehicle.models, baselines.problems),
    Dataset: (miho.data, miho.vehicle.data, baselines.problems),
    Loss: (miho.identification,),
    Optimizer: (miho.optim, miho.methods),
    OnlineMethod: (miho.online, baselines.online),
    Stream: (baselines.online,),
}
"""Packages whose `__all__` lists the targets of each kind."""

METHODS = Path(baselines.__file__).parent
BASES = {Optimizer.__name__, AskTell.__name__, "MultiStart"}
LONGEST_SHOWN = 80


class TargetError(ValueError):
    """Bad target; the message is one line with the fault and the allowed targets."""


def find_target(path: object, kind: type[T]) -> Callable[..., T]:
    """Class or function at a dotted path that makes a `kind`.

    Allowed are the public names of our packages and the methods in `baselines`; the source is read,
    and only an allowed target is imported. Raises TargetError for other paths, and ImportError if
    the library that a method wraps is missing.
    """
    home, _, name = path.rpartition(".") if isinstance(path, str) else ("", "", "")
    for package in HOMES[kind]:
        if home == package.__name__ and name in package.__all__:
            member = getattr(package, name)
            if _gives(member, kind):
                return cast(Callable[..., T], member)
    parent, _, module = home.rpartition(".")
    if kind is Optimizer and parent == baselines.__name__ and name in _methods(module):
        return cast(Callable[..., T], getattr(importlib.import_module(home), name))
    present = new_name(path) if isinstance(path, str) else None
    if present in allowed(kind):
        raise TargetError(f"{path!r} is now {present!r}")
    article = "an" if kind.__name__[0] in "AEIOU" else "a"
    own = "; a class in your own file needs path: FILE.py too" if kind is Optimizer else ""
    raise TargetError(
        f"{_shortened(path)} is not a class or function that gives {article} {kind.__name__}"
        f"{own}; allowed are {', '.join(allowed(kind))}"
    )


def allowed(kind: type) -> list[str]:
    """All dotted paths that a configuration may name for this kind."""
    names = [f"{home.__name__}.{name}" for home in HOMES[kind] for name in _public(home, kind)]
    if kind is Optimizer:
        for file in sorted(METHODS.glob("*.py")):
            names += [f"{baselines.__name__}.{file.stem}.{name}" for name in _methods(file.stem)]
    return names


def nested_target(value: Any, place: str) -> str | None:
    """Key path of a target inside a setting, where targets are not allowed; None without one."""
    if isinstance(value, Mapping):
        if "_target_" in value:
            return f"{place}._target_"
        inner = [(f"{place}.{key}", part) for key, part in value.items()]
    elif isinstance(value, list):
        inner = [(f"{place}[{index}]", part) for index, part in enumerate(value)]
    else:
        return None
    inside = (nested_target(part, key) for key, part in inner)
    return next((key for key in inside if key), None)


def _public(home: ModuleType, kind: type) -> list[str]:
    return [name for name in home.__all__ if _gives(getattr(home, name), kind)]


def is_final(member: object, kind: type) -> bool:
    """Whether an object is a class derived from `kind` without abstract methods."""
    return inspect.isclass(member) and issubclass(member, kind) and not inspect.isabstract(member)


def _gives(member: Any, kind: type) -> bool:
    if inspect.isclass(member):
        return is_final(member, kind)
    return inspect.isfunction(member) and (
        inspect.get_annotations(member).get("return") == kind.__name__
    )


def _methods(module: str) -> list[str]:
    """Names of the methods in a module of `baselines`, from its source without importing it."""
    file = METHODS / f"{module}.py"
    if not (module.isascii() and module.isidentifier() and file.is_file()):
        return []
    return [
        node.name
        for node in ast.parse(file.read_bytes()).body
        if isinstance(node, ast.ClassDef) and BASES & {_base(base) for base in node.bases}
        if not node.name.startswith("_")
    ]


def _base(node: ast.expr) -> str:
    """Bare name of a base class: `AskTell` for `AskTell[State]` or `miho.AskTell`."""
    if isinstance(node, ast.Subscript):
        return _base(node.value)
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def _shortened(path: object) -> str:
    text = repr(path)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."


LARGEST = 1 << 20
"""Largest size of a configuration file [bytes]."""
DEEPEST = 50
MOST_ALIASES = 1000
MOST_NODES = 100_000
"""Largest number of nodes of a file after its aliases are expanded."""
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class ReceivedError(ConfigError):
    """Bad file; the message is one line with the file and the fault."""


def check_folder(folder: Path) -> None:
    """Raise ConfigError if a folder of options is missing, ReceivedError for its first bad file.

    Of two files with one name Hydra reads the file in conf/, so another one in `folder` is refused.
    """
    if not folder.is_dir():
        raise ConfigError(f"--config-dir: {folder} is not a folder; check the path")
    for path in sorted((*folder.rglob("*.yaml"), *folder.rglob("*.yml"))):
        check_file(path)
        place = path.relative_to(folder)
        if source(str(place.parent), place.stem) not in ("", path.read_text("utf-8").strip()):
            raise ConfigError(
                f"--config-dir: {path} is not read, because conf/ has an option of this name; "
                "rename the file"
            )


def check_file(path: Path) -> None:
    """Raise ReceivedError if a file is not regular, too large, too deep, or expands without end."""
    if not path.is_file():
        raise ReceivedError(f"{path}: is not a regular file; remove it")
    if path.stat().st_size > LARGEST:
        raise ReceivedError(f"{path}: is larger than {LARGEST >> 20} MiB; use a smaller file")
    try:
        _check_events(path)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        line = " ".join(str(error).split())
        raise ReceivedError(f"{path}: is not YAML: {line}; correct it") from None


def _check_events(path: Path) -> None:
    """Count the nodes of a file without building it; an alias counts as the node that it names."""
    sizes: dict[str, int] = {}
    open_nodes: list[tuple[str | None, int]] = []
    aliases = total = 0
    with path.open("rb") as file:
        for event in yaml.parse(file, Loader=LOADER):
            size = 0
            if isinstance(event, yaml.CollectionStartEvent):
                open_nodes.append((event.anchor, total))
                total += 1
                if len(open_nodes) > DEEPEST:
                    raise ReceivedError(f"{path}: is nested deeper than {DEEPEST}; flatten it")
            elif isinstance(event, yaml.CollectionEndEvent):
                anchor, start = open_nodes.pop()
                if anchor is not None:
                    sizes[anchor] = total - start
            elif isinstance(event, yaml.ScalarEvent):
                size = 1
                if event.anchor is not None:
                    sizes[event.anchor] = 1
            elif isinstance(event, yaml.AliasEvent):
                if event.anchor in {anchor for anchor, _ in open_nodes}:
                    raise ReceivedError(
                        f"{path}: {event.anchor!r} contains itself; remove the alias"
                    )
                aliases += 1
                size = sizes.get(event.anchor, 1)
            total += size
            if total > MOST_NODES or aliases > MOST_ALIASES:
                raise ReceivedError(
                    f"{path}: expands to more than {MOST_NODES:,} values or {MOST_ALIASES:,} "
                    "aliases; use fewer"
                )


class SecretError(ConfigError):
    """A secret in a configuration; the message names its place and does not show it."""


def check_no_secret(value: Any, key: str) -> None:
    """Raise SecretError if a text in this resolved part of a configuration contains a secret."""
    texts = list(_texts(value, key))
    if holds_secret("\n".join(text for _, text in texts)):
        place = next((place for place, text in texts if holds_secret(text)), key)
        raise SecretError(
            f"{place}: contains a password or token, which would be stored with the run; remove it"
        )


def check_typed(overrides: Sequence[str]) -> None:
    """Raise SecretError or ConfigError for overrides that Hydra must not write to its files.

    Hydra writes all overrides to `.hydra/overrides.yaml` below `root` before it calls a task.
    """
    for text in overrides:
        key, _, value = text.partition("=")
        if holds_secret(text) or names_secret(key.rpartition(".")[2]):
            raise SecretError(
                f"{redacted(key)}: contains a password or token, which would be stored with the "
                "run; remove it"
            )
        if key == "root":
            check_root(value)


def check_root(text: str) -> None:
    """Raise ConfigError if `root` is not a path that this system can store, or is one of a job."""
    if "${hydra:job." in text:
        raise ConfigError(f"root: is {text}; leave out the job: each run has its own folder")
    if not text.strip() or not text.isprintable():
        raise ConfigError(f"root: is {text[:LONGEST_SHOWN]!r}; expected the path of a folder")
    try:
        os.fsencode(text)
    except UnicodeEncodeError:
        raise ConfigError(
            f"root: {text!a} cannot be a file name in the locale of this system; "
            "set LC_ALL=C.UTF-8 or choose a plain name"
        ) from None


def guard_environment() -> None:
    """Keep `${oc.env:NAME}` from reading variables with the name of a secret."""
    OmegaConf.register_new_resolver("oc.env", _environment, replace=True)


def _environment(name: str, *default: str | None) -> str | None:
    """Resolver of OmegaConf, for variables that are no secrets."""
    if names_secret(name) and name in os.environ:
        raise SecretError(
            f"the environment variable {name} names a secret, which would be stored with the run; "
            "a configuration cannot read it"
        )
    value: str | None = oc.env(name, *default)
    return value


def _texts(value: Any, key: str) -> Iterator[tuple[str, str]]:
    """All texts, names included, with their key paths."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield key, str(name)
            yield from _texts(part, f"{key}.{name}")
    elif isinstance(value, list):
        for index, part in enumerate(value):
            yield from _texts(part, f"{key}[{index}]")
    elif isinstance(value, str):
        yield key, value
