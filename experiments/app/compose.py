"""Composition of configurations from conf/ with the compose API of Hydra."""

from __future__ import annotations

import copy
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException

from experiments.app.explain import (
    ConfigError,
    check_choices,
    composition_message,
    replace_spaces,
)
from experiments.app.options import CONF as CONF

VERSION_BASE = "1.3"
PLUGINS = Path(__file__).parents[1] / "plugins"
"""Folder of our plugins: Hydra finds them in packages `hydra_plugins` on the path of Python."""

if str(PLUGINS) not in sys.path:
    sys.path.append(str(PLUGINS))


def composed(overrides: Sequence[str]) -> DictConfig:
    """Compose the configuration of some overrides, with the name of its method.

    Inside a command, its folders are used, including --config-dir; otherwise, conf/. Raises
    ConfigError.
    """
    if GlobalHydra.instance().is_initialized():
        return _copied(tuple(overrides))
    with initialize_config_dir(str(CONF), version_base=VERSION_BASE):
        return _copied(tuple(overrides))


def option_folders() -> list[Path]:
    """Folders of options: conf/, and inside a command also the folder of --config-dir."""
    if not GlobalHydra.instance().is_initialized():
        return [CONF]
    sources = GlobalHydra.instance().config_loader().get_sources()
    return [Path(source.path) for source in sources if source.scheme() == "file"]


def _copied(overrides: tuple[str, ...]) -> DictConfig:
    search_path = GlobalHydra.instance().config_loader().get_search_path()
    return copy.deepcopy(_once(overrides, tuple(map(str, search_path.get_path()))))


@cache
def _once(overrides: tuple[str, ...], search_path: tuple[str, ...]) -> DictConfig:
    """Compose each configuration only once, because it takes a tenth of a second."""
    check_choices(overrides)
    try:
        config = compose("config", replace_spaces(overrides), return_hydra_config=True)
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        raise ConfigError(composition_message(error, overrides)) from error
    return job_config(config, config.hydra.runtime.choices)


def job_config(config: DictConfig, choices: Mapping[str, str | None]) -> DictConfig:
    """Copy `config` without its node `hydra`, and add the name of its method.

    Unless `method` gives the name, it is the chosen option of the group `optimizer` without its
    folder. Raises ConfigError if `method` is the name of another option.
    """
    option = (choices.get("optimizer") or "").rpartition("/")[2] or None
    with open_dict(config):
        config.pop("hydra", None)
        if config.get("method") is None:
            config["method"] = option
    name = str(config["method"])
    if option not in (None, name) and (CONF / "optimizer" / f"{name}.yaml").exists():
        raise ConfigError(
            f"method={name}: only names the runs, which are of {option}; write optimizer={name} to "
            "choose a method, or give another name"
        )
    return config
