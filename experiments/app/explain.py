"""Error messages on command lines and configurations, in one line with a remedy."""

import difflib
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, Override, OverrideType
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    OmegaConfBaseException,
    ValidationError,
)
from omegaconf.nodes import BooleanNode, FloatNode, IntegerNode

from experiments.app.options import options_of, source
from experiments.app.schema import RENAMED
from miho.data import CSVError
from miho.moved import SETTINGS

EXPECTED: dict[type, str] = {
    IntegerNode: "a whole number",
    FloatNode: "a number",
    BooleanNode: "true or false",
}
HIDDEN = ("hydra", "_target_")
LISTED, CLOSEST = 40, 5
"""A message lists at most LISTED names; of more names it lists the CLOSEST best matches."""
EXTRAS = {
    "hydra/launcher": ("joblib", "submitit_local", "submitit_slurm", "slurm"),
    "hydra/job_logging": ("colorlog",),
    "hydra/hydra_logging": ("colorlog",),
}
"""Options of Hydra's groups that the plugins of the extra `launchers` provide."""
Kinds = type[Exception] | tuple[type[Exception], ...]
BAD_SETTINGS = TypeError, ValueError
WHOLE = "# @package _global_"
"""First line of options that change the whole configuration, not only the node of their group."""


class ConfigError(ValueError):
    """Bad configuration; the message is one line with the key, the fault and the allowed values."""


@contextmanager
def as_config_error(place: str = "", kinds: Kinds = ValueError) -> Iterator[None]:
    """Convert errors of these kinds to ConfigError, whose message begins with the place, if any."""
    try:
        yield
    except (ConfigError, CSVError):
        raise
    except kinds as error:
        raise ConfigError(f"{place}: {error}" if place else str(error)) from None


def unknown_message(key: str, allowed: Iterable[object]) -> str:
    """Message on an unknown key or choice: the closest name and all names, or the closest of many.

    Many names are options of a group, which its help lists.
    """
    names = [str(name) for name in allowed if name not in HIDDEN]
    group, _, value = key.rpartition("=")
    last = value if group else key.rpartition(".")[2]
    if len(names) > LISTED:
        group = group.lstrip("-").rpartition(".")[2].removesuffix("s")  # comparison.problems
        close = difflib.get_close_matches(last, names, n=CLOSEST, cutoff=0)
        return (
            f"{key}: is unknown; the closest of {len(names)} are {', '.join(close)}; "
            f"python -m experiments.identify {group} --help lists all"
        )
    close = difflib.get_close_matches(last, names, n=1)
    guess = f"; did you mean {close[0]}?" if close else ";"
    return f"{key}: is unknown{guess} allowed are {', '.join(names) or 'none'}"


def parse_overrides(texts: Sequence[str]) -> list[Override]:
    """Parse the overrides of a command line; raise ConfigError if one cannot be read."""
    parser = OverridesParser.create()
    overrides = []
    for text in texts:
        try:
            overrides += parser.parse_overrides([text])
        except HydraException:
            raise ConfigError(_unreadable(text)) from None
        if not overrides[-1].key_or_group:
            raise ConfigError(f"{text}: has no key; write KEY=VALUE, such as seed=1")
    return overrides


def check_choices(texts: Sequence[str]) -> None:
    """Raise ConfigError for a number, null or a list in place of an option of conf/.

    Hydra fails without a reason for a number or null. It merges the options of a list, of which
    then only the last would be used; only experiments are merged.
    """
    for text, override in zip(texts, parse_overrides(texts), strict=True):
        key, value = override.key_or_group, override.value()
        if isinstance(value, ChoiceSweep):
            value = next((item for item in value.list if isinstance(item, list)), "")
        if override.is_delete() or not isinstance(value, int | float | list | None):
            continue
        options = options_of(key)
        if isinstance(value, list):
            if options and key != "experiment":
                names = ",".join(map(str, value))
                choose = f"choose one option, or sweep: -m {key}={names}"
                raise ConfigError(f"{text}: is a list; {choose}")
            continue
        if options and value is None:
            raise ConfigError(f"{key}=null: is not an option; ~{key} removes the group")
        if options:
            raise ConfigError(unknown_message(f"{key}={value}", options))


OPEN = ("problem.parts", "online.changes", "online.names", "online.input_noise")
"""Nodes to which an override adds names."""
CHOOSING = {"model", "dataset", "space", "loss", "problem", "optimizer"}
"""Groups whose options have different settings."""


def replace_spaces(texts: Sequence[str]) -> list[str]:
    """Rewrite overrides for Hydra.

    `space={...}` replaces the whole space, and `comparison.methods=[a,b]` means `{a: {}, b: {}}`.
    `+space.NAME=...`, `hydra.sweeper.params.KEY=...` and names in the nodes of `OPEN` add to the
    composed node. In a sweep over options, a setting is a choice of one value: Hydra then adds it
    to each job, and not to the default option as well.
    """
    whole: list[str] = []
    overrides = parse_overrides(texts)
    swept = {x.key_or_group for x in overrides if x.is_sweep_override()} & CHOOSING
    for text, override in zip(texts, overrides, strict=True):
        key, _, value = text.partition("=")
        names = override.key_or_group.split(".")
        if override.key_or_group == "space" and isinstance(override.value(), dict):
            whole += ["~space", f"+{text.lstrip('+')}"]
        elif override.key_or_group == "comparison.methods" and not override.is_delete():
            methods = override.value()
            if isinstance(methods, list):
                value = f"{{{', '.join(f'{name}: {{}}' for name in methods)}}}"
            whole.append(f"++comparison.methods={value}")
        elif override.is_add() and key.lstrip("+").startswith("space."):
            for name in reversed(key.split(".")[1:]):
                value = f"{{{name}: {value}}}"
            whole.append(f"+space={value}")
        elif ".".join(names[:2]) in OPEN and not (
            override.is_delete() or override.is_sweep_override()
        ):
            for name in reversed(names[2:]):
                value = f"{{{name}: {value}}}"
            whole.append(f"++{'.'.join(names[:2])}={value}")
        elif names[:3] == ["hydra", "sweeper", "params"] and not override.is_delete():
            whole.append(f"++{text.lstrip('+')}")
        elif swept and len(names) > 1 and names[0] in CHOOSING and value and _is_plain(override):
            whole.append(f"{key}=choice({value})")
        else:
            whole.append(text)
    return whole


def _is_plain(override: Override) -> bool:
    """Whether a value may be a choice, which cannot be null and loses the quotes of a text."""
    changes = override.type is OverrideType.CHANGE and not override.is_sweep_override()
    quoted = (override.input_line or "").partition("=")[2].startswith(("'", '"'))
    return changes and not quoted and override.value() is not None


def without_choice(text: str) -> str:
    """An override as it was typed, before `replace_spaces` made it a choice of one value."""
    plain = re.sub(r"=choice\((.+)\)$", r"=\1", text)
    return text if plain == text or parse_overrides([plain])[0].is_sweep_override() else plain


def _unreadable(text: str) -> str:
    if text.endswith(","):
        return f"{text}: ends with a comma; remove it, or add a value"
    if "=" not in text:
        return f"{text}: is not a setting; write KEY=VALUE, such as seed=1 or optimizer=miho"
    quoted = "quote the whole override, and in it quote names with other characters, as in "
    example = """'dataset.headers=["m/s^2", "Schräglauf"]'"""
    if "{" in text and not text.isascii():
        example += "; names before a colon cannot be quoted: put those into a file for --config-dir"
    return f"{text}: cannot be read; {quoted}{example}"


def composition_message(error: Exception, texts: Sequence[str]) -> str:
    """Message on a failed composition, from the fields of Hydra's error rather than its text.

    `texts` are the composed overrides.
    """
    cause = error.__cause__
    if isinstance(error, OverrideParseException):
        return _unreadable(error.override)
    if isinstance(error, MissingConfigException) and error.options is not None:
        return _missing_message(error, texts)
    node = getattr(cause, "parent_node", None)
    if isinstance(cause, ConfigKeyError | ConfigAttributeError) and isinstance(node, DictConfig):
        key = str(cause.full_key)
        if key in RENAMED:
            return f"{key}: {RENAMED[key]}"
        group, _, name = key.rpartition(".")
        if SETTINGS.get(name) in node:
            return f"{key}: is now {group}.{SETTINGS[name]}"
        if not group and (places := _places(key, node)):
            return f"{key}: is unknown; did you mean {' or '.join(places)}?"
        return unknown_message(key, node) + _having(key)
    if isinstance(cause, ValidationError) and isinstance(node, DictConfig):
        expected = EXPECTED.get(type(node._get_node(cause.key)))
        key = str(cause.full_key)
        typed = [text for text in texts if text.lstrip("+").startswith(f"{key}=")]
        if expected and typed:
            last = parse_overrides(typed)[-1]
            value = typed[-1].partition("=")[2] if last.is_sweep_override() else last.value()
            if expected == "a whole number" and isinstance(value, float) and value.is_integer():
                expected += f", written {value:.0f}"
            return f"{key}: is {value!r}; expected {expected}"
    for text in texts:
        if text.startswith("+experiment="):
            return f"{text}: an experiment is chosen once; write {text[1:]}"
        if text.startswith("space.") and "=[" in text:
            name = text.partition("=")[0].split(".")[1]
            ends = f"space.{name}.low=0 space.{name}.high=1"
            return f"{text}: is a list; write its ends by name, as in {ends}"
    message = one_line(error)
    if isinstance(cause, OmegaConfBaseException):
        message += f": {one_line(cause)}"
    return message


def _missing_message(error: MissingConfigException, texts: Sequence[str]) -> str:
    """Message on an option that does not exist: it belongs to an extra, or is misspelt."""
    missing = str(error.missing_cfg_file)
    group, _, name = missing.rpartition("/")
    for key, _, values in (text.lstrip("+").partition("=") for text in texts):
        for value in values.split(","):  # a value may name a folder
            if value and f"{key}/{value}" == missing:
                group, name = key, value
    chosen = any(text.lstrip("+").startswith(f"{group}=") for text in texts)
    place = "" if chosen else f"{str(error).partition(':')[0]}: "  # the file that chooses it
    if name in EXTRAS.get(group, ()):
        return f"{place}{group}={name}: is not installed; pip install 'miho[launchers]'"
    folder, slash, _ = name.rpartition("/")
    for former in (f"{group}={name}", f"{group}={folder}{slash}"):
        if former in RENAMED:
            return f"{place}{group}={name}: {RENAMED[former]}"
    own = "; your own need --config-dir FOLDER" * (group == "experiment")
    return place + unknown_message(f"{group}={name}", error.options or ()) + own


def _places(key: str, config: DictConfig) -> list[str]:
    """The settings of the groups with this name."""
    groups = [str(name) for name in config if name not in HIDDEN]
    nodes = ((name, config._get_node(name)) for name in groups)
    return [f"{name}.{key}" for name, node in nodes if isinstance(node, DictConfig) and key in node]


def _having(key: str) -> str:
    """Options of the group that have a setting which the chosen option lacks."""
    group, _, setting = key.partition(".")
    line = re.compile(rf"^\s*{re.escape(setting)}:", re.MULTILINE)
    names = options_of(group) if setting else []
    having = [f"{group}={name}" for name in names if line.search(_node(group, name))]
    return f"; {setting} is a setting of {', '.join(having)}" if having else ""


def _node(group: str, name: str) -> str:
    """Text of an option, of one that changes the whole configuration only the node of its group."""
    text = source(group, name)
    if not text.startswith(WHOLE):
        return text
    match = re.search(rf"^{re.escape(group)}:.*\n((?: .*\n?)*)", text, re.MULTILINE)
    return match[1] if match else ""


def one_line(error: BaseException) -> str:
    """Message of an error in one line; it begins with the file if the error names one."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"{error.filename}: {error.strerror}"
    lines = (line.strip() for line in str(error).splitlines())
    noise = ("full_key", "object_type", "reference_type", "Config search path", "provider=")
    message = " ".join(line for line in lines if line and not line.startswith(noise))
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)
