"""The parts of a joint problem in a configuration: their models, datasets and parameters."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from experiments.app.schema import ParameterConfig

GROUPS = ("model", "dataset")
USUAL = asdict(ParameterConfig())
"""Default settings of a parameter."""


def part_nodes(config: Mapping[str, Any]) -> dict[str, dict[str, Mapping[str, Any]]]:
    """Model and dataset of each part: its settings replace settings of the configuration.

    Settings of a part with a `_target_` replace the whole node. A problem without parts has one
    part, named "".
    """
    parts = config["problem"].get("parts") or {"": {}}
    return {
        str(name): {key: _over(config[key], part.get(key) or {}) for key in GROUPS}
        for name, part in parts.items()
    }


def _over(node: Mapping[str, Any], own: Mapping[str, Any]) -> Mapping[str, Any]:
    return own if "_target_" in own or not isinstance(node, Mapping) else {**node, **own}


def with_local(config: Mapping[str, Any], space: Mapping[str, Any]) -> dict[str, Any]:
    """Space in which NAME_PART of a local parameter takes the settings of NAME as its defaults."""
    nodes = dict(space)
    for name in config["problem"].get("local") or ():
        for part in config["problem"].get("parts") or ():
            own, common = nodes.get(f"{name}_{part}"), nodes.get(name)
            if own is not None and common is not None:
                chosen = {key: value for key, value in own.items() if value != USUAL.get(key)}
                nodes[f"{name}_{part}"] = {**common, **chosen}
    return nodes


def model_files(config: Mapping[str, Any]) -> list[str]:
    """Files of the user that a configuration names as models."""
    models = [nodes["model"] for nodes in part_nodes(config).values()]
    paths = [model.get("path") for model in models if isinstance(model, Mapping)]
    return list(dict.fromkeys(str(path) for path in paths if path is not None))


def own_files(config: Mapping[str, Any]) -> list[str]:
    """Files of the user that run with a configuration: its models, and its method."""
    method = config["optimizer"]
    path = method.get("path") if isinstance(method, Mapping) else None
    return [*model_files(config), *([] if path is None else [str(path)])]
