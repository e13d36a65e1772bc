"""Composing a configuration with Hydra, with all checks before Hydra acts on anything."""

from __future__ import annotations

import contextlib
import copy
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import cast

from hydra import version
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.config_search_path import ConfigSearchPath, SearchPathQuery
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException

from experiments.app.explain import (
    ConfigError,
    composition_message,
    parse_overrides,
    replace_spaces,
    unknown_message,
)
from experiments.app.safety import check_hydra

CONF = Path(__file__).parents[2] / "conf"


def composed(overrides: Sequence[str]) -> DictConfig:
    """The configuration that these overrides give, outside of a command or inside one.

    Inside, it sees the folder of --config-dir as well. Raises ConfigError, and HydraSettingError
    for what may not be said to Hydra, which is checked before Hydra acts on it.
    """
    if GlobalHydra.instance().is_initialized():
        return without_hydra(whole_config(tuple(overrides)))
    with hydra_of():
        return without_hydra(whole_config(tuple(overrides)))


@contextlib.contextmanager
def hydra_of(folder: str | None = None) -> Iterator[Hydra]:
    """Hydra, which composes from conf/ and, behind it, from one folder of further options."""
    version.setbase("1.3")
    path = create_config_search_path(str(CONF))
    if folder is not None:
        _add_folder(path, Path(folder))
    instance = GlobalHydra.instance()
    before, instance.hydra = instance.hydra, None
    try:
        yield Hydra.create_main_hydra2(command_name(), path)
    finally:
        instance.hydra = before


def _add_folder(path: ConfigSearchPath, folder: Path) -> None:
    if not folder.is_dir():
        raise ConfigError(f"--config-dir: {folder} is not a folder; name one that is")
    if (folder / "schema.yaml").exists():  # Hydra would take it for the types of all settings
        raise ConfigError(
            f"--config-dir: {folder} holds a schema.yaml; give that file another name"
        )
    query = SearchPathQuery(provider="schema")
    path.prepend("command-line", f"file://{folder.resolve()}", anchor=query)


def command_name() -> str:
    """The name of the running command, such as identify."""
    return Path(sys.argv[0]).stem


def whole_config(overrides: tuple[str, ...], mode: RunMode = RunMode.RUN) -> DictConfig:
    """The configuration with its node `hydra`, Hydra's own settings, which are checked."""
    places = tuple(map(str, GlobalHydra.instance().config_loader().get_search_path().get_path()))
    return _once(overrides, mode, places)


@cache
def _once(overrides: tuple[str, ...], mode: RunMode, places: tuple[str, ...]) -> DictConfig:
    """Composing takes a fifth of a second."""
    parsed_overrides = parse_overrides(overrides)
    _check_choices(parsed_overrides)
    try:
        config = _composed(replace_spaces(overrides), mode)
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        loader = GlobalHydra.instance().config_loader()
        raise ConfigError(composition_message(error, parsed_overrides, loader)) from error
    check_hydra(config.hydra, _usual(), overrides)
    return config


@cache
def _usual() -> DictConfig:
    """Hydra's own settings without any override."""
    with hydra_of():
        return cast(DictConfig, _composed((), RunMode.RUN).hydra)


def _composed(overrides: Sequence[str], mode: RunMode) -> DictConfig:
    hydra = GlobalHydra.instance().hydra
    if hydra is None:
        raise RuntimeError("Hydra is not initialized")
    config: DictConfig = hydra.compose_config("config", list(overrides), mode, from_shell=False)
    return config


def without_hydra(config: DictConfig) -> DictConfig:
    """A copy of the configuration without its node `hydra`."""
    cfg = copy.deepcopy(config)
    with open_dict(cfg):
        del cfg["hydra"]
    return cfg


def _check_choices(overrides: Sequence[Override]) -> None:
    """A group is chosen from by name."""
    loader = GlobalHydra.instance().config_loader()
    for override in overrides:
        key, value = override.key_or_group, override.value()
        if override.is_delete() or not isinstance(value, int | float | None):
            continue
        options = loader.get_group_options(key)
        if options and value is None:
            raise ConfigError(f"{key}=null: is no choice; ~{key} leaves it out")
        if options:
            raise ConfigError(unknown_message(f"{key}={value}", options))


def check_values(overrides: Sequence[Override], mode: RunMode) -> None:
    """Several values are for a sweep, which needs at least one."""
    for override in overrides:
        if not override.is_sweep_override():
            continue
        text = override.input_line
        if mode is RunMode.RUN:
            raise ConfigError(
                f"{text}: is several values; sweep over them with -m, or write a list in []"
            )
        if override.is_discrete_sweep() and not list(override.sweep_string_iterator()):
            raise ConfigError(
                f"{text}: has no values, so there is nothing to do; give at least one"
            )
