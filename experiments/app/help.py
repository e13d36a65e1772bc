"""Texts of --help: of a command, of a group of options, of one option."""

from __future__ import annotations

import shlex
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.app.options import CONF, groups_of, options_of, source

WIDTH = 100

FOOTER = """\
more:
  GROUP --help            list the options of a group, e.g. dataset --help
  GROUP=OPTION --help     show the file of an option, e.g. dataset=csv --help
  --cfg job               show the whole configuration; KEY=VALUE replaces any value
  --config-dir FOLDER     add your options, e.g. FOLDER/experiment/mine.yaml
  --hydra-help            show the options of Hydra, which composes the configuration
  --shell-completion      print a bash script that completes groups and options
Exit codes: 0 success, 1 bug, 2 bad input, 3 some runs failed, 4 storage error, 5 finished runs used
other code, data or settings (add fresh=true), 6 a simulated car left its road, 130 interrupted."""


def completion() -> str:
    """Bash script that completes groups and options of conf/ after `python -m`.

    Hydra's script (`-sc install=bash`) does not support `python -m`, and starts Python at each key.
    """
    script = Path(__file__).with_name("completion.bash").read_text(encoding="utf-8")
    return script.replace("@CONF@", shlex.quote(str(CONF))).strip()


def help_text(
    task: Callable[..., Any],
    settings: Mapping[str, str],
    overrides: Sequence[str],
    folders: Sequence[Path],
) -> str:
    """Help on the last override that names a group or an option, else on the command.

    `folders` are conf/ and further folders of options.
    """
    for text in reversed(overrides):
        group, _, option = text.partition("=")
        options = options_of(group, folders)
        if option in options:
            return source(group, option, folders)
        if options:
            return _options(group, options, folders)
    return _command(task, settings, folders)


def _command(task: Callable[..., Any], settings: Mapping[str, str], folders: Sequence[Path]) -> str:
    """Help on a command: its description, its settings, and the groups of options."""
    description = (sys.modules[task.__module__].__doc__ or "").strip()
    width = max(map(len, settings), default=0)
    setting_lines = [f"  {key:<{width}}  {meaning}" for key, meaning in settings.items()]
    groups = [f"{group} ({len(options_of(group, folders))})" for group in groups_of(folders)]
    choices = textwrap.wrap("groups (and how many options): " + ", ".join(groups), WIDTH)
    return "\n".join(
        [description, "", "settings, as KEY=VALUE:", *setting_lines, "", *choices, "", FOOTER]
    )


def _options(group: str, options: Sequence[str], folders: Sequence[Path]) -> str:
    """Options of a group, each with the first comment of its file."""
    width = max(map(len, options))
    room = WIDTH - width - 4
    titles = [textwrap.shorten(_title(source(group, name, folders)), room) for name in options]
    lines = [f"  {name:<{width}}  {title}" for name, title in zip(options, titles, strict=True)]
    return "\n".join([f"{group}=OPTION, one of:", *lines])


def _title(text: str) -> str:
    comments = (line[1:].strip() for line in text.splitlines() if line.startswith("#"))
    return next((line for line in comments if line and not line.startswith("@package")), "")
