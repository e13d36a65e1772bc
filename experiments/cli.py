"""What every command does alike: Hydra composes, errors are one line, exit codes have a meaning."""

from __future__ import annotations

import contextlib
import copy
import io
import os
import re
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from types import FrameType

import hydra
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.utils import get_args_parser
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, OverrideParseException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from experiments import schema
from experiments.build import ConfigError
from experiments.hydra_settings import HydraSettingError, check_arguments, check_hydra
from experiments.stopped import Stopped
from miho.data import CSVError, DataUnavailableError
from miho.models import TirError
from miho.regular_file import NotAFileError
from miho.study.changes import ResumeRefused
from miho.study.redaction import redacted

CONF = Path(__file__).parent.parent / "conf"

OK, BUG, BAD_INPUT, SOME_FAILED, STORAGE, REFUSED, PIPE_CLOSED = 0, 1, 2, 3, 4, 5, 141
BY_SIGNAL = 128
SEED = re.compile(r"seed=\d+")
BAD_INPUT_ERRORS = (
    HydraException, OmegaConfBaseException, ConfigError, CSVError, TirError, DataUnavailableError,
    HydraSettingError, YAMLError, FileNotFoundError, IsADirectoryError, NotAFileError,
)  # fmt: skip


def command(
    task: Callable[[DictConfig], None],
    check: Callable[[DictConfig], object],
    after: Callable[[], int] = lambda: OK,
) -> None:
    """Compose the configuration from the command line, run `task` on it and exit.

    Before a sweep starts, `check` sees each of its settings and each of its seeds once, so that
    a mistake in the last one stops the first. `after` runs once at the end, also of a sweep and of
    one that is interrupted, and gives the exit code of what is not.
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
        check_arguments(arguments)
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
        except KeyboardInterrupt:
            after()
            raise
        except (HydraException, OmegaConfBaseException, ValueError) as error:
            raise ConfigError(_explained(error, arguments.overrides)) from error
        for failure in failures:
            raise failure

    guarded(job, after)


def composed(overrides: Sequence[str]) -> DictConfig:
    """The configuration that these overrides give, outside of a Hydra command or inside one."""
    return copy.deepcopy(_composed(overrides)[0])


def _composed(overrides: Sequence[str]) -> tuple[DictConfig, DictConfig]:
    """The configuration, and what it says to Hydra itself."""
    return _once(tuple(overrides), GlobalHydra.instance().is_initialized())


@cache
def _once(overrides: tuple[str, ...], inside: bool) -> tuple[DictConfig, DictConfig]:
    """Composing takes a fifth of a second; inside of a command it sees more folders."""
    if inside:
        return _parts(overrides)
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        return _parts(overrides)


def _parts(overrides: Sequence[str]) -> tuple[DictConfig, DictConfig]:
    whole = hydra.compose("config", list(overrides), return_hydra_config=True)
    to_hydra = whole.hydra
    with open_dict(whole):
        del whole["hydra"]
    return whole, to_hydra


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
    check_hydra(_composed(overrides)[1], _composed([])[1], overrides)


def _sweep(overrides: Sequence[str]) -> list[tuple[str, ...]]:
    """The overrides of the jobs of a sweep that show everything but good seeds once."""
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    jobs = BasicSweeper.split_arguments(parsed, max_batch_size=None)[0]
    first: dict[tuple[str, ...], tuple[str, ...]] = {}
    for job in jobs:
        rest = tuple(o for o in job if not SEED.fullmatch(o))
        first.setdefault(rest, tuple(job))
    return list(dict.fromkeys(first.values()))


_ended_by: int = signal.SIGINT
"""The signal that an interrupt of this process stands for."""


def _as_interrupt(number: int, frame: FrameType | None) -> None:
    global _ended_by
    _ended_by = number
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell's background jobs begin so
        raise KeyboardInterrupt
    signal.raise_signal(signal.SIGINT)


def guarded(job: Callable[[], object], after: Callable[[], int] = lambda: OK) -> None:
    """Run `job`, turn what it raises into one line and the exit code that fits, and exit.

    SIGTERM stops it like Ctrl-C: what was found is kept.
    """
    signal.signal(signal.SIGTERM, _as_interrupt)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without UTF-8 gets escapes
            stream.reconfigure(errors="backslashreplace")
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
    except ResumeRefused as error:
        code = _say(error, REFUSED)
    except KeyboardInterrupt as error:
        number = error.number if isinstance(error, Stopped) else _ended_by
        print(f"interrupted by {signal.Signals(number).name}", file=sys.stderr)
        code = BY_SIGNAL + number
    except Exception:  # noqa: BLE001 -- a bug: the traceback is the message
        print(redacted(traceback.format_exc()), file=sys.stderr, end="")
        code = BUG
    sys.exit(code)


def _say(error: BaseException, code: int) -> int:
    print(f"error: {redacted(one_line(error))}", file=sys.stderr)
    return code


def one_line(error: BaseException) -> str:
    """The message of an error in one line, the file first if it is about one."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"{error.filename}: {error.strerror}"
    lines = (line.strip() for line in str(error).splitlines())
    noise = ("full_key", "object_type", "reference_type", "Config search path", "provider=")
    told = " ".join(line for line in lines if line and not line.startswith(noise))
    return "".join(one if one.isprintable() else repr(one)[1:-1] for one in told)
