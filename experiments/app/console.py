"""What every command does alike: its configuration is composed, errors are one line, exit codes
have a meaning."""

from __future__ import annotations

import argparse
import io
import os
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NoReturn

from hydra._internal.callbacks import Callbacks
from hydra._internal.hydra import Hydra
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from tqdm import tqdm
from yaml import YAMLError

from experiments.app import schema
from experiments.app.compose import (
    CONF,
    check_values,
    command_name,
    hydra_of,
    whole_config,
    without_hydra,
)
from experiments.app.explain import ConfigError, one_line, parse_overrides, replace_spaces
from experiments.app.help import completion, help_text
from experiments.app.safety import (
    HydraSettingError,
    ReceivedError,
    check_arguments,
    check_machines,
)
from experiments.app.signals import Stopped, name_of, stopping_signal
from miho.data import CSVError, DataUnavailableError
from miho.models import TirError
from miho.parallel.cluster import ClusterError
from miho.parallel.worker_process import SPURIOUS_INTERRUPT
from miho.regular_file import NotAFileError
from miho.study import DamagedRun
from miho.study.changes import ResumeRefused
from miho.study.redaction import redacted

tqdm.set_lock(threading.RLock())
"""Bars of other processes are none of ours: the lock by default is a semaphore of the system, which
a process that is killed leaves behind."""

OK, BUG, BAD_INPUT, SOME_FAILED, STORAGE, REFUSED, LEFT_ROAD, PIPE_CLOSED = 0, 1, 2, 3, 4, 5, 6, 141
BY_SIGNAL = 128
BAD_INPUT_ERRORS = (
    ClusterError, HydraException, OmegaConfBaseException, ConfigError, CSVError, TirError,
    DataUnavailableError,
    HydraSettingError, NotAFileError, ReceivedError, YAMLError, FileNotFoundError,
    IsADirectoryError,
)  # fmt: skip

Task = Callable[[DictConfig], int]
Sweep = Callable[[HydraContext, DictConfig, Sequence[Override]], int]


def command(
    task: Task, *, sweep: Sweep | None = None, settings: Mapping[str, str] = MappingProxyType({})
) -> None:
    """Compose the configuration from the command line, run `task` on it, exit with what it returns.

    With -m, `sweep` gets Hydra's context, the whole configuration, `hydra` included, and the
    overrides. `settings` are the command's own, for its help.
    """
    schema.register()

    def job() -> int:
        parser = get_args_parser()
        parser.error = _refuse_option  # type: ignore[method-assign]
        arguments = parser.parse_intermixed_args()
        check_arguments(arguments)
        # What only shows something ends here; all else is a run or a sweep.
        with hydra_of(arguments.config_dir) as hydra:
            if arguments.help:
                print(help_text(task, settings, arguments.overrides, hydra.config_loader))
            elif arguments.shell_completion:
                print(completion(CONF))
            elif arguments.hydra_help or arguments.cfg or arguments.info:
                _show(hydra, parser, arguments)
            else:
                return _start(hydra, arguments)
        return OK

    def _start(hydra: Hydra, arguments: argparse.Namespace) -> int:
        overrides = parse_overrides(arguments.overrides)
        mode = RunMode.MULTIRUN if arguments.multirun else RunMode.RUN
        check_values(overrides, mode)
        if mode is RunMode.MULTIRUN and sweep is None:
            raise ConfigError(
                f"-m: {command_name()} goes through its runs by itself; leave it out, or sweep "
                "with python -m experiments.identify -m"
            )
        # Composed once, and checked as it is composed; Hydra's own settings are for the sweep.
        cfg = whole_config((*arguments.overrides, f"hydra.mode={mode.name}"), mode)
        check_machines(cfg, overrides)
        HydraConfig.instance().set_config(cfg)
        try:
            if mode is RunMode.MULTIRUN and sweep is not None:
                return sweep(HydraContext(hydra.config_loader, Callbacks(cfg)), cfg, overrides)
            return task(without_hydra(cfg))
        except SystemExit as error:  # of a model: nothing of ours ends a task by it
            call = f"SystemExit({error.code!r})"
            raise _Ended(call).with_traceback(error.__traceback__) from None

    run_and_exit(job)


def _show(hydra: Hydra, parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Print what Hydra shows of a configuration: --cfg, --info, --hydra-help."""
    overrides, mode = arguments.overrides, RunMode.MULTIRUN if arguments.multirun else RunMode.RUN
    whole_config(tuple(overrides), mode)
    if arguments.hydra_help:
        hydra.hydra_help("config", parser, arguments)
    elif arguments.cfg:
        hydra.show_cfg(
            "config", replace_spaces(overrides), arguments.cfg, arguments.package, arguments.resolve
        )
    else:
        hydra.show_info(arguments.info, "config", replace_spaces(overrides), mode)


def _refuse_option(message: str) -> NoReturn:
    raise ConfigError(
        f"{message.removeprefix('unrecognized arguments: ')}: is no option; settings have no "
        "dashes, as in seed=1; see --help"
    )


class _Ended(BaseException):
    """A command ended by what only the user's code can have called."""


def run_and_exit(job: Callable[[], int | None]) -> NoReturn:
    """Run `job` and exit with the code that it returns, or with the one that fits what it raises.

    That is printed in one line. SIGTERM stops it like Ctrl-C, and so does a terminal that closes:
    what was found is kept. An interrupt that no signal sent, or what else only a model of the
    user's raises, is a failed run.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without UTF-8 gets escapes
            stream.reconfigure(errors="backslashreplace")
    with stopping_signal() as arrived:
        try:
            code = job() or OK
        except BAD_INPUT_ERRORS as error:
            code = _say(error, BAD_INPUT)
        except DamagedRun as error:
            code = _say(error, BAD_INPUT)
        except BrokenPipeError:  # whoever read our output has seen enough
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            code = PIPE_CLOSED
        except OSError as error:
            code = _say(error, STORAGE)
        except ResumeRefused as error:
            code = _say(error, REFUSED)
        except KeyboardInterrupt as error:
            number = error.number if isinstance(error, Stopped) else arrived()
            if number is None:
                code = _say(
                    RuntimeError(f"{_place(error)}: raises {SPURIOUS_INTERRUPT}"), SOME_FAILED
                )
            else:
                print(f"interrupted by {name_of(number)}", file=sys.stderr)
                code = BY_SIGNAL + number
        except SystemExit:
            raise
        except Exception:  # noqa: BLE001 -- a bug: the traceback is the message
            print(redacted(traceback.format_exc()), file=sys.stderr, end="")
            code = BUG
        except BaseException as error:  # noqa: BLE001 -- nothing of ours raises it
            call = f"{error}" if isinstance(error, _Ended) else f"{type(error).__name__}: {error}"
            code = _say(RuntimeError(f"{_place(error)}: raises {call}"), SOME_FAILED)
    sys.exit(code)


def _place(error: BaseException) -> str:
    """The file and line that raised an error."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{last.filename}:{last.lineno}"


def _say(error: BaseException, code: int) -> int:
    print(f"error: {redacted(one_line(error))}", file=sys.stderr)
    return code
