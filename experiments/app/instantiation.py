"""Instantiation of configured objects; no other module instantiates targets.

A configuration can name only public classes and functions of our packages, so it cannot run other
code. The exceptions are files that the user names on the command line or in a YAML file:
`miho.models.load_function`, `load_trajectory` and `FmuModel` run the file of `model.path`, and a
method with `optimizer.path` is a class of that file.
"""

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

from experiments.app.explain import ConfigError, as_config_error, unknown_message
from experiments.app.safety import (
    TargetError,
    check_no_secret,
    find_target,
    guard_environment,
    is_final,
    nested_target,
)
from experiments.app.schema import RENAMED
from miho.models.user_file import defined_in, executed, make_picklable, raised
from miho.optim import Optimizer

PLAIN = {kind.__name__: kind for kind in (int, float, str, bool)}

T = TypeVar("T")
MISSING = "???"
"""Value of a mandatory setting that was not given."""

guard_environment()


class MissingLibraryError(ConfigError):
    """A configured object needs a library that is not installed; the message names the extra."""


def instantiate(node: Mapping[str, Any], key: str, kind: type[T]) -> T:
    """Instantiate the object that `node` describes.

    `safety.find_target` must allow the target for this `kind`, and the target must accept all
    settings; both are checked before a target is imported or called. Hydra's `instantiate` is not
    used, because it runs any target.
    """
    own = kind is Optimizer and node.get("path") is not None
    target = _own_class(node, key, kind) if own else _target(node.get("_target_"), key, kind)
    allowed = inspect.signature(target).parameters
    used = ("_target_", "path") if own else ("_target_",)
    settings = {name: value for name, value in node.items() if name not in used}
    for name, value in settings.items():
        if name not in allowed:
            raise ConfigError(unknown_message(f"{key}.{name}", allowed))
        inner = nested_target(value, f"{key}.{name}")
        if inner:
            raise ConfigError(f"{inner}: a target is not allowed inside a setting; remove it")
        settings[name] = _checked_value(value, allowed[name].annotation, f"{key}.{name}")
    try:
        built = target(**settings)
    except ImportError as error:
        raise MissingLibraryError(f"{key}: {error}") from None
    except ValueError as error:
        if type(error) is not ValueError:
            raise
        raise ConfigError(f"{key}: {error}") from None
    except (TypeError, OverflowError) as error:
        raise ConfigError(f"{key}: {error}") from None
    except MemoryError:
        raise ConfigError(f"{key}: is too large for the memory of this machine") from None
    except Exception as error:
        if not own:
            raise
        raise ConfigError(f"{key}: {raised(error, Path(node['path']))}") from None
    return built


def _target(path: object, key: str, kind: type[T]) -> Callable[..., T]:
    try:
        return find_target(path, kind)
    except TargetError as error:
        former = f"{path}: {RENAMED[path]}" if isinstance(path, str) and path in RENAMED else error
        raise ConfigError(f"{key}._target_: {former}") from None
    except ImportError as error:
        raise MissingLibraryError(f"{key}: {error}") from None


def _own_class(node: Mapping[str, Any], key: str, kind: type[T]) -> Callable[..., T]:
    """Class in a file of the user, which is run."""
    path, name = node["path"], node.get("_target_")
    if not isinstance(path, str):
        raise ConfigError(f"{key}.path: is {path!r}; expected a file")
    with as_config_error():
        module = executed(Path(path))
    make_picklable(Path(path), module)
    members = defined_in(module)
    classes = {name: member for name, member in members.items() if is_final(member, kind)}
    if name is None:
        raise ConfigError(
            f"{key}._target_: is missing; name a class of {path}: {', '.join(classes) or 'none'}"
        )
    if name not in classes:
        if lacking := getattr(members.get(str(name)), "__abstractmethods__", None):
            raise ConfigError(
                f"{key}._target_: {name} in {path} lacks {', '.join(sorted(lacking))}"
            )
        raise ConfigError(
            f"{key}._target_: {path} has no class {name} derived from miho.{kind.__name__}; "
            f"it has {', '.join(classes) or 'none'}"
        )
    return cast(Callable[..., T], classes[name])


def _checked_value(value: Any, annotation: Any, key: str) -> Any:
    """The value, converted to the plain type that the signature declares; else ConfigError."""
    if value == MISSING:
        raise ConfigError(f"{key}: is missing; give it on the command line as {key}=...")
    kind = PLAIN.get(annotation if isinstance(annotation, str) else annotation.__name__)
    if kind is None or type(value) is kind:
        return value
    if kind is float and type(value) is int:
        return float(value)
    if kind is int and type(value) is float and value.is_integer():
        return int(value)
    raise ConfigError(f"{key}: is {value!r}; expected a value of type {kind.__name__}")


def part_of(setting: Mapping[str, Any], key: str) -> dict[str, Any]:
    """Copy of one node of a plain setting, checked to be a mapping without a secret."""
    node = setting[key]
    if node == MISSING:
        raise ConfigError(f"{key}: is missing; choose one of conf/{key}/")
    if not isinstance(node, Mapping):
        raise ConfigError(f"{key}: is {node!r}; expected a mapping")
    check_no_secret(node, key)
    return {str(name): value for name, value in node.items()}
