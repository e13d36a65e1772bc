"""Arguments of commands without Hydra, which may also be written as overrides: root=PATH."""

from __future__ import annotations

import argparse
import inspect
import sys
from collections.abc import Collection, Sequence
from pathlib import Path


def as_options(words: Sequence[str], names: Collection[str]) -> list[str]:
    """Replace `name=value` by `--name=value` for these names, so that argparse reads it."""
    return [f"--{word}" if word.partition("=")[0] in names else word for word in words]


def root_folder(text: str) -> Path:
    """Path of a folder of runs, given with or without `root=`."""
    return Path(text.removeprefix("root="))


def chosen_names(description: str | None, names: Sequence[str]) -> Sequence[str]:
    """Parse a command line that gives some of these names, or none for all of them."""
    parser = argparse.ArgumentParser(
        prog=f"python -m experiments.{Path(sys.argv[0]).stem}",
        description=inspect.cleandoc(description or ""),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"by default all: {', '.join(names)}"
    )
    chosen: list[str] = parser.parse_args().names
    if unknown := sorted(set(chosen) - set(names)):
        parser.error(f"{', '.join(unknown)} is unknown; expected {', '.join(names)}")
    return chosen or names
