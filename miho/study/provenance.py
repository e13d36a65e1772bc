"""The origin of results: the command that regenerates them, and the machine that ran it."""

from __future__ import annotations

import json
import shlex
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
    """Leaves of nested mappings by dotted path; an empty mapping is a leaf."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping) and value:
            leaves |= flattened(value, f"{prefix}{key}.")
        else:
            leaves[f"{prefix}{key}"] = value
    return leaves


def command_line(module: str) -> str:
    """The command line of this process, which runs `module`, quoted for a shell."""
    return shlex.join(["python", "-m", module, *sys.argv[1:]])


def lasting(environment: Mapping[str, Any]) -> dict[str, Any]:
    """The part of an environment that is equal for all runs on a machine with these versions."""
    return {key: value for key, value in environment.items() if key not in MOMENTARY}


def provenance(stored: StoredRun) -> dict[str, Any]:
    """Identity, dataset and machine of a run."""
    return {
        **{key: stored.result[key] for key in IDENTITY},
        "dataset": stored.config["dataset"],
        "environment": lasting(stored.environment),
    }


def write_provenance(
    path: Path, command: str, stored: Sequence[StoredRun], facts: Mapping[str, Any]
) -> Path:
    """Write how to regenerate a figure or table of these runs; `facts` describe the runs."""
    about = {"command": command, **facts, "environment": lasting(stored[0].environment)}
    write_text(path, json.dumps(about, indent=1) + "\n")
    return path
