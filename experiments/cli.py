"""What every command does alike: Hydra composes, errors are one line, exit codes have a meaning."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import traceback
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import hydra
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.utils import get_args_parser
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from experiments import schema
from experiments.build import ConfigError
from miho.data import CSVError, DataUnavailableError
from miho.models import TirError

CONF = Path(__file__).parent.parent / "conf"

OK, BUG, BAD_INPUT, SOME_FAILED, STORAGE, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 3, 4, 130, 141
BAD_INPUT_ERRORS = (
    HydraException, OmegaConfBaseException, ConfigError, CSVError, TirError, DataUnavailableError,
    FileNotFoundError, IsADirectoryError,
)  # fmt: skip


def command(
    task: Callable[[DictConfig], None],
    check: Callable[[DictConfig], object],
    after: Callable[[], int] = lambda: OK,
) -> None:
    """Compose the configuration from the command line, run `task` on it and exit.

    Before a sweep starts, `check` sees each of its settings and each of its seeds once, so that
    a mistake in the last one stops the first. `after` runs once at the end, also of a sweep, and
    gives the exit code.
    """
    schema.register()
    os.environ["HYDRA_FULL_ERROR"] = "1"  # let errors reach us instead of being printed
    main = hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")

    failures: list[Exception] = []

    def kept(cfg: DictConfig) -> None:
        try:
            task(cfg)
        except Exception as error:  # noqa: BLE001 -- Hydra would print it; we raise it below
            failures.append(error)

    def job() -> None:
        arguments = get_args_parser().parse_args()
        jobs = _sweep(arguments.overrides) if arguments.multirun else [arguments.overrides]
        try:
            for overrides in jobs:
                _check_hydra(overrides)
                if arguments.multirun:
                    check(composed(overrides))
        except (HydraException, ValueError) as error:
            raise ConfigError(_explained(error, arguments.overrides)) from error
        try:
            main(kept)()
        except Exception as error:
            raise ConfigError(_explained(error, arguments.overrides)) from error
        for failure in failures:
            raise failure

    guarded(job, after)


def composed(overrides: Sequence[str]) -> DictConfig:
    """The configuration that these overrides give, outside of a Hydra command or inside one."""
    return _composed(overrides)


def _composed(overrides: Sequence[str], *, hydra_too: bool = False) -> DictConfig:
    if GlobalHydra.instance().is_initialized():
        return hydra.compose("config", list(overrides), return_hydra_config=hydra_too)
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        return _composed(overrides, hydra_too=hydra_too)


def _explained(error: Exception, overrides: Sequence[str]) -> str:
    """What Hydra says, with the allowed keys where it names only the wrong one."""
    unknown = re.match(r"Could not override '([^']+)'", str(error))
    if unknown:
        key = unknown[1]
        others = [o for o in overrides if o.partition("=")[0] != key]
        with contextlib.suppress(Exception):
            cfg = composed(others)
            parent = key.rpartition(".")[0]
            node = OmegaConf.select(cfg, parent) if parent else cfg
            return f"{key}: is unknown; allowed are {', '.join(map(str, node))}"
    message = one_line(error)
    if isinstance(error, OverrideParseException) or "Lexer" in message:
        message = message.partition(" See https")[0]
        message += '; quote the whole override for the shell, and inside brackets "m/s^2"'
    if isinstance(error.__cause__, OmegaConfBaseException):
        message += f": {one_line(error.__cause__)}"
    return message


def _check_hydra(overrides: Sequence[str]) -> None:
    """Refuse what Hydra itself would run for a configuration, other than a launcher's job."""
    hydra_node, usual = _composed(overrides, hydra_too=True).hydra, _usual_hydra()
    for key in ("callbacks", "job_logging", "hydra_logging"):
        if hydra_node[key] != usual[key]:
            raise ConfigError(f"hydra.{key}: cannot be changed here; leave it as it is")
    for key in ("launcher", "sweeper"):
        node = {str(name): value for name, value in hydra_node[key].items()}
        target = str(node.pop("_target_"))
        if not target.startswith(("hydra._internal.core_plugins.", "hydra_plugins.")):
            raise ConfigError(f"hydra.{key}._target_: {target!r} is not a plugin of Hydra")
        if "_target_" in str(node):
            raise ConfigError(f"hydra.{key}: holds a target of its own; remove it")


@cache
def _usual_hydra() -> Any:
    return _composed([], hydra_too=True).hydra


def _sweep(overrides: Sequence[str]) -> list[tuple[str, ...]]:
    """The overrides of the jobs of a sweep that show every seed and everything else once."""
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    jobs = BasicSweeper.split_arguments(parsed, max_batch_size=None)[0]
    first: dict[tuple[str, ...], tuple[str, ...]] = {}
    for job in jobs:
        seeds = tuple(o for o in job if o.startswith("seed="))
        rest = tuple(o for o in job if not o.startswith("seed="))
        if rest not in first or seeds not in first:
            first[rest] = first[seeds] = tuple(job)
    return list(dict.fromkeys(first.values()))


def guarded(job: Callable[[], object], after: Callable[[], int] = lambda: OK) -> None:
    """Run `job`, turn what it raises into one line and the exit code that fits, and exit."""
    try:
        job()
        code = after()
    except BAD_INPUT_ERRORS as error:
        code = _say(error, BAD_INPUT)
    except BrokenPipeError:  # whoever read our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = PIPE_CLOSED
    except OSError as error:
        code = _say(error, STORAGE)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        code = INTERRUPTED
    except Exception:  # noqa: BLE001 -- a bug: the traceback is the message
        traceback.print_exc()
        code = BUG
    sys.exit(code)


def _say(error: BaseException, code: int) -> int:
    print(f"error: {one_line(error)}", file=sys.stderr)
    return code


def one_line(error: BaseException) -> str:
    """The message of an error in one line, the file first if it is about one."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"{error.filename}: {error.strerror}"
    lines = (line.strip() for line in str(error).splitlines())
    noise = ("full_key", "object_type", "reference_type", "Config search path", "provider=")
    return " ".join(line for line in lines if line and not line.startswith(noise))
