"""What a command line or a received configuration may say to Hydra itself, which runs targets too.

Hydra makes its launcher, sweeper, callbacks and loggers from what is configured, sets environment
variables and reads pickles. A received file must not reach any of that.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.plugins import Plugins
from hydra.plugins.launcher import Launcher
from omegaconf import DictConfig, OmegaConf

from experiments.received_yaml import check_folder
from experiments.targets import nested_target

FREE = {"launcher", "mode", "verbose", "overrides", "runtime", "job"}
FREE_OF_JOB = {"name", "override_dirname", "id", "num", "config_name"}
SHELL = ("setup", "teardown", "srun_args", "additional_parameters", "python")
"""Settings of launchers that become shell commands on a cluster."""
OPTIONS = {
    "config_path": "name a folder of further options with --config-dir",
    "config_name": "choose an experiment=... instead",
    "experimental_rerun": "it reads a pickle, which can run anything; type the overrides again",
}


class HydraSettingError(ValueError):
    """One line naming the setting of Hydra that is refused."""


def check_arguments(arguments: argparse.Namespace) -> None:
    """Refuse options that replace our configuration, or load code to find another one."""
    for option, remedy in OPTIONS.items():
        if getattr(arguments, option) is not None:
            name = option.replace("_", "-")
            raise HydraSettingError(f"--{name}: cannot be used here; {remedy}")
    if arguments.config_dir is not None:
        check_folder(Path(arguments.config_dir))
    for override in arguments.overrides:
        if "searchpath" in override:
            raise HydraSettingError(
                "hydra.searchpath: cannot be changed here, since it can import packages; name a "
                "folder of further options with --config-dir"
            )


def check_hydra(chosen: DictConfig, usual: DictConfig, overrides: Sequence[str]) -> None:
    """Refuse settings of Hydra other than a choice of a launcher and its plain settings.

    `chosen` and `usual` are the nodes `hydra` of the composed configuration and of the one
    without overrides. What a launcher passes to a shell must be typed in `overrides`.
    """
    new, old = _plain(chosen), _plain(usual)
    _check_same(new, old, "hydra", FREE)
    for key in ("job", "launcher"):
        if not isinstance(new.get(key), Mapping):
            raise HydraSettingError(f"hydra.{key}: is not a mapping; leave it as it is")
    _check_same(new["job"], old["job"], "hydra.job", FREE_OF_JOB)
    node = dict(new["launcher"])
    target = node.pop("_target_", None)
    launchers = Plugins.instance().discover(Launcher)
    names = sorted(f"{launcher.__module__}.{launcher.__name__}" for launcher in launchers)
    if target not in names:
        raise HydraSettingError(
            f"hydra.launcher._target_: {str(target)[:80]!r} is not a plugin of Hydra that is "
            f"installed; allowed are {', '.join(names)}"
        )
    inner = nested_target(node, "hydra.launcher")
    if inner:
        raise HydraSettingError(f"{inner}: hydra.launcher holds a target of its own; remove it")
    for key in SHELL:
        typed = any(text.lstrip("+").startswith(f"hydra.launcher.{key}") for text in overrides)
        if new["launcher"].get(key) and not typed:
            raise HydraSettingError(
                f"hydra.launcher.{key}: reaches a shell, so it must be typed on the command line"
            )


def _check_same(new: Mapping[str, Any], old: Mapping[str, Any], place: str, free: set[str]) -> None:
    for key in (new.keys() | old.keys()) - free:
        if new.get(key) != old.get(key):
            raise HydraSettingError(f"{place}.{key}: cannot be changed here; leave it as it is")


def _plain(node: DictConfig) -> dict[str, Any]:
    """As it is written: interpolations are compared, not what they stand for."""
    plain = OmegaConf.to_container(node, resolve=False)
    if not isinstance(plain, dict):
        raise HydraSettingError("hydra: is not a mapping; leave it as it is")
    return {str(key): value for key, value in plain.items()}
