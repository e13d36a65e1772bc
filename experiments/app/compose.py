"""Composition of configurations from conf/ with the compose API of Hydra."""

import copy
import json
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from hydra import compose, initialize_config_dir
from hydra.conf import HydraConf
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from experiments.app.explain import (
    ConfigError,
    check_choices,
    composition_message,
    replace_spaces,
    without_choice,
)
from experiments.app.options import CONF as CONF
from experiments.app.options import source

VERSION_BASE = "1.3"
PLUGINS = Path(__file__).parents[1] / "plugins"
"""Folder of our plugins: Hydra finds them in packages `hydra_plugins` on the path of Python."""

DEFINING = {"model", "dataset", "space", "loss", "problem", "experiment"}
"""First words of overrides that may change the smallest error of a problem."""
CHANGING = ("sigma", "sigma_known", "parts", "local", "constraints")
"""Settings of a problem that change its loss or its space."""

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


def searching(folder: Path | None) -> list[str]:
    """Overrides that let `composed` find the options of a further folder; none without it."""
    return [] if folder is None else [f"hydra.searchpath=[{json.dumps(str(folder.resolve()))}]"]


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
    return job_config(config, config.hydra)


def job_config(config: DictConfig, node: HydraConf) -> DictConfig:
    """Remove the node `hydra` from `config`, and add the name of its method; `node` is that node.

    Unless `method` gives the name, it is the chosen option of the group `optimizer` without its
    folder. Raises ConfigError if `method` is the name of another option, and if a problem is chosen
    with another dataset than its own. A problem with other settings has no recorded optimum.
    """
    choices = node.runtime.choices
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
    keys = {text.lstrip("+~").partition("=")[0] for text in as_typed(node.overrides.task)}
    if choices.get("problem") and not DEFINING.isdisjoint(
        key.partition(".")[0] for key in keys - {"problem"}
    ):
        _check_problem(config, node)
    return config


def as_typed(overrides: Any) -> list[str]:
    """Overrides in a node of Hydra as they were typed, for example with ${hydra.job.num} in them.

    An element of the node would have the value of the interpolation, or raise if it has none yet.
    """
    texts: Any = OmegaConf.to_container(OmegaConf.create(overrides), resolve=False)
    return [without_choice(str(text)) for text in texts]


def _check_problem(config: DictConfig, node: HydraConf) -> None:
    """Refuse another dataset than the chosen problem's, and forget its optimum if it is another.

    It is another with any other setting that the smallest error depends on.
    """
    name, dataset = node.runtime.choices["problem"], node.runtime.choices["dataset"]
    text = yaml.safe_load(source("problem", name, option_folders())) or {}
    own: dict[str, str] = {}
    for item in text.get("defaults") or ():
        own |= item if isinstance(item, dict) else {}
    if own.get("override /dataset", dataset) != dataset:
        raise ConfigError(
            f"problem={name}: is about dataset={own['override /dataset']}, but the command or its "
            f"experiment chooses dataset={dataset}; choose a dataset without problem={name}"
        )
    typed = as_typed(node.overrides.hydra)
    places = [text for text in typed if text.startswith("hydra.searchpath=")]
    recorded = composed([f"problem={name}", *places])
    is_same = all(config[key] == recorded[key] for key in DEFINING - {"experiment", "problem"})
    is_same &= all(config.problem[key] == recorded.problem[key] for key in CHANGING)
    if not is_same and config.problem.optimum == recorded.problem.optimum:
        config.problem.optimum = None
