"""Where results come from: the command that regenerates them, and the machine that they ran on."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from miho.study.files import write_text
from miho.study.store import StoredRun

MOMENTARY = ("load", "timing")
"""Keys of an environment whose values differ from run to run on one machine."""
IDENTITY = ("problem", "optimizer", "seed", "id", "code", "data")


def flattened(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The leaves of nested mappings by dotted path; an empty mapping is a leaf."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping) and value:
            leaves |= flattened(value, f"{prefix}{key}.")
        else:
            leaves[f"{prefix}{key}"] = value
    return leaves


def command_line(module: str) -> str:
    """The command line of this process, of which `module` is the command."""
    return " ".join(["python -m", module, *sys.argv[1:]])


def lasting(environment: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a run's environment that all runs on one machine with these versions share."""
    return {key: value for key, value in environment.items() if key not in MOMENTARY}


def provenance(stored: StoredRun) -> dict[str, Any]:
    """The identity of a run, its dataset, and the machine that it ran on."""
    return {
        **{key: stored.result[key] for key in IDENTITY},
        "dataset": stored.config["dataset"],
        "environment": lasting(stored.environment),
    }


def write_provenance(
    path: Path, command: str, stored: Sequence[StoredRun], facts: Mapping[str, Any]
) -> Path:
    """Write how a figure or table of these runs is made again; `facts` say which runs they are."""
    about = {"command": command, **facts, "environment": lasting(stored[0].environment)}
    write_text(path, json.dumps(about, indent=1) + "\n")
    return path
