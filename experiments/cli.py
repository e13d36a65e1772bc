"""What every command does alike: Hydra composes, errors are one line, exit codes have a meaning."""

from __future__ import annotations

import argparse
import contextlib
import copy
import io
import os
import signal
import socket
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import FrameType, MappingProxyType
from typing import NoReturn, cast

from hydra import version
from hydra._internal.callbacks import Callbacks
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path, get_args_parser
from hydra.core.config_search_path import ConfigSearchPath, SearchPathQuery
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException
from tqdm import tqdm
from yaml import YAMLError

from experiments import schema
from experiments.explain import ConfigError, explained, one_line, parsed, unknown, whole_space
from experiments.help import completion, help_text
from experiments.hydra_settings import HydraSettingError, check_arguments, check_hydra
from experiments.received_yaml import ReceivedError
from experiments.stopped import HANG_UP, Stopped, ignores_hang_up
from miho.data import CSVError, DataUnavailableError
from miho.models import TirError
from miho.optim.oracle import UNSENT
from miho.regular_file import NotAFileError
from miho.study import DamagedRun
from miho.study.changes import ResumeRefused
from miho.study.redaction import redacted

tqdm.set_lock(threading.RLock())
"""Bars of other processes are none of ours: the lock by default is a semaphore of the system, which
a process that is killed leaves behind."""

CONF = Path(__file__).parent.parent / "conf"

OK, BUG, BAD_INPUT, SOME_FAILED, STORAGE, REFUSED, LEFT_ROAD, PIPE_CLOSED = 0, 1, 2, 3, 4, 5, 6, 141
BY_SIGNAL = 128
BAD_INPUT_ERRORS = (
    HydraException, OmegaConfBaseException, ConfigError, CSVError, TirError, DataUnavailableError,
    HydraSettingError, NotAFileError, ReceivedError, YAMLError, FileNotFoundError,
    IsADirectoryError,
)  # fmt: skip

Sweep = Callable[[HydraContext, DictConfig, Sequence[Override]], object]


def command(
    task: Callable[[DictConfig], None],
    after: Callable[[], int] = lambda: OK,
    *,
    sweep: Sweep | None = None,
    settings: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Compose the configuration from the command line, run `task` on it and exit.

    With -m, `sweep` gets Hydra's context, the whole configuration, `hydra` included, and the
    overrides. `after` runs once at the end, also of a sweep and of one that is interrupted, and
    gives the exit code of what is not. `settings` are the command's own, for its help.
    """
    schema.register()

    def job() -> None:
        parser = get_args_parser()
        parser.error = _refuse_option  # type: ignore[method-assign]
        arguments = parser.parse_intermixed_args()
        check_arguments(arguments)
        with _hydra(arguments.config_dir) as hydra:
            if arguments.help:
                print(help_text(task, settings, arguments.overrides, hydra.config_loader))
            elif arguments.shell_completion:
                print(completion(CONF))
            elif arguments.hydra_help or arguments.cfg or arguments.info:
                _show(hydra, parser, arguments)
            else:
                _start(hydra, arguments)

    def _start(hydra: Hydra, arguments: argparse.Namespace) -> None:
        overrides = parsed(arguments.overrides)
        mode = RunMode.MULTIRUN if arguments.multirun else RunMode.RUN
        _check_values(overrides, mode)
        if mode is RunMode.MULTIRUN and sweep is None:
            raise ConfigError(
                f"-m: {_name()} goes through its runs by itself; leave it out, or sweep with "
                "python -m experiments.identify -m"
            )
        whole = _whole((*arguments.overrides, f"hydra.mode={mode.name}"), mode)
        HydraConfig.instance().set_config(whole)
        try:
            if mode is RunMode.MULTIRUN and sweep is not None:
                context = HydraContext(hydra.config_loader, Callbacks(whole))
                sweep(context, whole, overrides)
            else:
                task(_without_hydra(whole))
        except KeyboardInterrupt:
            after()
            raise
        except SystemExit as error:  # of a model: nothing of ours ends a task by it
            told = f"SystemExit({error.code!r})"
            raise _Ended(told).with_traceback(error.__traceback__) from None

    guarded(job, after)


def composed(overrides: Sequence[str]) -> DictConfig:
    """The configuration that these overrides give, outside of a command or inside one.

    Inside, it sees the folder of --config-dir as well. Raises ConfigError, and HydraSettingError
    for what may not be said to Hydra, which is checked before Hydra acts on it.
    """
    if GlobalHydra.instance().is_initialized():
        return _without_hydra(_whole(tuple(overrides)))
    with _hydra():
        return _without_hydra(_whole(tuple(overrides)))


@contextlib.contextmanager
def _hydra(folder: str | None = None) -> Iterator[Hydra]:
    """Hydra, which composes from conf/ and, behind it, from one folder of further options."""
    version.setbase("1.3")
    path = create_config_search_path(str(CONF))
    if folder is not None:
        _add_folder(path, Path(folder))
    there = GlobalHydra.instance()
    before, there.hydra = there.hydra, None
    try:
        yield Hydra.create_main_hydra2(_name(), path)
    finally:
        there.hydra = before


def _add_folder(path: ConfigSearchPath, folder: Path) -> None:
    if not folder.is_dir():
        raise ConfigError(f"--config-dir: {folder} is not a folder; name one that is")
    if (folder / "schema.yaml").exists():  # Hydra would take it for the types of all settings
        raise ConfigError(
            f"--config-dir: {folder} holds a schema.yaml; give that file another name"
        )
    query = SearchPathQuery(provider="schema")
    path.prepend("command-line", f"file://{folder.resolve()}", anchor=query)


def _name() -> str:
    return Path(sys.argv[0]).stem


def _whole(overrides: tuple[str, ...], mode: RunMode = RunMode.RUN) -> DictConfig:
    """The configuration with what it says to Hydra itself, which is checked."""
    places = tuple(map(str, GlobalHydra.instance().config_loader().get_search_path().get_path()))
    return _once(overrides, mode, places)


@cache
def _once(overrides: tuple[str, ...], mode: RunMode, places: tuple[str, ...]) -> DictConfig:
    """Composing takes a fifth of a second."""
    typed = parsed(overrides)
    _check_choices(typed)
    try:
        whole = _composed(whole_space(overrides), mode)
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        loader = GlobalHydra.instance().config_loader()
        raise ConfigError(explained(error, typed, loader)) from error
    check_hydra(whole.hydra, _usual(), overrides)
    return whole


@cache
def _usual() -> DictConfig:
    """What is said to Hydra where nobody says anything."""
    with _hydra():
        return cast(DictConfig, _composed((), RunMode.RUN).hydra)


def _composed(overrides: Sequence[str], mode: RunMode) -> DictConfig:
    hydra = GlobalHydra.instance().hydra
    if hydra is None:
        raise RuntimeError("Hydra is not initialized")
    whole: DictConfig = hydra.compose_config("config", list(overrides), mode, from_shell=False)
    return whole


def _without_hydra(whole: DictConfig) -> DictConfig:
    cfg = copy.deepcopy(whole)
    with open_dict(cfg):
        del cfg["hydra"]
    return cfg


def _check_choices(overrides: Sequence[Override]) -> None:
    """A group is chosen from by name."""
    loader = GlobalHydra.instance().config_loader()
    for override in overrides:
        key, value = override.key_or_group, override.value()
        if override.is_delete() or not isinstance(value, int | float | None):
            continue
        options = loader.get_group_options(key)
        if options and value is None:
            raise ConfigError(f"{key}=null: is no choice; ~{key} leaves it out")
        if options:
            raise ConfigError(unknown(f"{key}={value}", options))


def _check_values(overrides: Sequence[Override], mode: RunMode) -> None:
    """Several values are for a sweep, which needs at least one."""
    for override in overrides:
        if not override.is_sweep_override():
            continue
        text = override.input_line
        if mode is RunMode.RUN:
            raise ConfigError(
                f"{text}: is several values; sweep over them with -m, or write a list in []"
            )
        if override.is_discrete_sweep() and not list(override.sweep_string_iterator()):
            raise ConfigError(
                f"{text}: has no values, so there is nothing to do; give at least one"
            )


def _show(hydra: Hydra, parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """What Hydra itself tells of a configuration that may be composed."""
    overrides, mode = arguments.overrides, RunMode.MULTIRUN if arguments.multirun else RunMode.RUN
    _whole(tuple(overrides), mode)
    if arguments.hydra_help:
        hydra.hydra_help("config", parser, arguments)
    elif arguments.cfg:
        hydra.show_cfg(
            "config", whole_space(overrides), arguments.cfg, arguments.package, arguments.resolve
        )
    else:
        hydra.show_info(arguments.info, "config", whole_space(overrides), mode)


def _refuse_option(message: str) -> NoReturn:
    raise ConfigError(
        f"{message.removeprefix('unrecognized arguments: ')}: is no option; settings have no "
        "dashes, as in seed=1; see --help"
    )


class _Ended(BaseException):
    """A command ended by what only the user's code can have called."""


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

    SIGTERM stops it like Ctrl-C, and so does a terminal that closes: what was found is kept. An
    interrupt that no signal sent, or what else only a model of the user's raises, is a failed run.
    """
    signal.signal(signal.SIGTERM, _as_interrupt)
    if HANG_UP is not None and not ignores_hang_up():
        signal.signal(HANG_UP, _as_interrupt)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without UTF-8 gets escapes
            stream.reconfigure(errors="backslashreplace")
    with _signals() as arrived:
        try:
            job()
            code = after()
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
            if isinstance(error, Stopped) or arrived():
                number = error.number if isinstance(error, Stopped) else _ended_by
                print(f"interrupted by {signal.Signals(number).name}", file=sys.stderr)
                code = BY_SIGNAL + number
            else:
                code = _say(RuntimeError(f"{_place(error)}: raises {UNSENT}"), SOME_FAILED)
        except SystemExit:
            raise
        except Exception:  # noqa: BLE001 -- a bug: the traceback is the message
            print(redacted(traceback.format_exc()), file=sys.stderr, end="")
            code = BUG
        except BaseException as error:  # noqa: BLE001 -- nothing of ours raises it
            what = f"{type(error).__name__}: {error}" if not isinstance(error, _Ended) else error
            code = _say(RuntimeError(f"{_place(error)}: raises {what}"), SOME_FAILED)
    sys.exit(code)


@contextlib.contextmanager
def _signals() -> Iterator[Callable[[], bool]]:
    """Meanwhile signals that this process handles are noted; what is given says if one was."""
    noted, write = socket.socketpair()
    with noted, write:
        for end in (noted, write):
            end.setblocking(False)
        before = signal.set_wakeup_fd(write.fileno(), warn_on_full_buffer=False)

        def arrived() -> bool:
            with contextlib.suppress(BlockingIOError):
                return bool(noted.recv(1))
            return False

        try:
            yield arrived
        finally:
            signal.set_wakeup_fd(before)


def _place(error: BaseException) -> str:
    """The file and line that raised an error."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{last.filename}:{last.lineno}"


def _say(error: BaseException, code: int) -> int:
    print(f"error: {redacted(one_line(error))}", file=sys.stderr)
    return code
