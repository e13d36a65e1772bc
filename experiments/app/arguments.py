"""Arguments of commands without Hydra, which may be written as its overrides are: root=PATH."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path


def as_options(words: Sequence[str], names: Collection[str]) -> list[str]:
    """`words` in which `name=value` of these names is `--name=value`, which argparse reads."""
    return [f"--{word}" if word.partition("=")[0] in names else word for word in words]


def root_folder(text: str) -> Path:
    """A folder of runs given in its place, with or without `root=` before it."""
    return Path(text.removeprefix("root="))
