"""Arguments of commands without Hydra, which may also be written as overrides: root=PATH."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path


def as_options(words: Sequence[str], names: Collection[str]) -> list[str]:
    """Replace `name=value` by `--name=value` for these names, so that argparse reads it."""
    return [f"--{word}" if word.partition("=")[0] in names else word for word in words]


def root_folder(text: str) -> Path:
    """Path of a folder of runs, given with or without `root=`."""
    return Path(text.removeprefix("root="))
