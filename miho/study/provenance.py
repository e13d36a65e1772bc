"""Where results come from: what regenerates them, and what they ran on."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from miho.study.files import write_text
from miho.study.store import StoredRun

MOMENTARY = ("load", "timing")
"""Of an environment what differs from run to run on one machine."""
IDENTITY = ("problem", "optimizer", "seed", "id", "code", "data")


def flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The leaves of nested mappings by dotted path; an empty mapping is a leaf."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping) and value:
            leaves |= flat(value, f"{prefix}{key}.")
        else:
            leaves[f"{prefix}{key}"] = value
    return leaves


def command_line(module: str) -> str:
    """What was typed to run this process, of which `module` is the command."""
    return " ".join(["python -m", module, *sys.argv[1:]])


def lasting(environment: Mapping[str, Any]) -> dict[str, Any]:
    """What of a run's environment is the same for all runs on a machine with these versions."""
    return {key: value for key, value in environment.items() if key not in MOMENTARY}


def provenance(stored: StoredRun) -> dict[str, Any]:
    """What regenerates a run, and what it ran on."""
    return {
        **{key: stored.result[key] for key in IDENTITY},
        "dataset": stored.config["dataset"],
        "environment": lasting(stored.environment),
    }


def write_provenance(
    path: Path, command: str, stored: Sequence[StoredRun], facts: Mapping[str, Any]
) -> Path:
    """Write what regenerates a figure or table of these runs; `facts` say which runs they are."""
    about = {"command": command, **facts, "environment": lasting(stored[0].environment)}
    write_text(path, json.dumps(about, indent=1) + "\n")
    return path
