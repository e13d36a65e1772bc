"""The frame of all commands: help, composition by Hydra, errors in one line, and exit codes."""

import argparse
import functools
import inspect
import io
import os
import shlex
import sys
import textwrap
import threading
import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import chdir
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from tqdm import tqdm
from yaml import YAMLError

from experiments.app.compose import VERSION_BASE, job_config
from experiments.app.explain import (
    ConfigError,
    check_choices,
    composition_message,
    one_line,
    replace_spaces,
)
from experiments.app.options import CONF, groups_of, options_of, source
from experiments.app.safety import check_folder, check_typed
from experiments.app.signals import Stopped, name_of, stopping_signal
from miho.data import CSVError
from miho.parallel.cluster import ClusterError
from miho.parallel.errors import SPURIOUS_INTERRUPT
from miho.regular_file import NotAFileError
from miho.study import DamagedRun
from miho.study.manifest import ResumeRefused
from miho.study.redaction import redacted
from miho.vehicle.data import DataUnavailableError
from miho.vehicle.driving.compiling import MissingNumbaError
from miho.vehicle.models import TirError


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


tqdm.set_lock(threading.RLock())
"""tqdm needs only a lock between threads; its default, a semaphore of the system, remains after a
process is killed."""

OK, BUG, BAD_INPUT, SOME_FAILED, STORAGE, REFUSED, LEFT_ROAD, PIPE_CLOSED = 0, 1, 2, 3, 4, 5, 6, 141
BY_SIGNAL = 128
BAD_INPUT_ERRORS = (
    ClusterError, HydraException, OmegaConfBaseException, ConfigError, CSVError, TirError,
    DataUnavailableError, NotAFileError, YAMLError, FileNotFoundError, IsADirectoryError,
    MissingNumbaError,
)  # fmt: skip

Task = Callable[[DictConfig], float | None]
VALUED = (
    "--cfg", "-c", "--package", "-p", "--config-path", "-cp", "--config-name", "-cn",
    "--config-dir", "-cd", "--experimental-rerun",
)  # fmt: skip
"""Options of Hydra that take the next word as their value."""


class EndedError(Exception):
    """A command has printed its ending; `code` is its exit code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exit code {code}")
        self.code = code


class _Refused(BaseException):
    """Carry the end of a single run through Hydra, which would print another line."""


class _Left(BaseException):
    """The user's code ended the command by SystemExit."""


class Job:
    """The function that Hydra calls for each job: a task, and the runs of a sweep.

    Parameters
    ----------
    task
        Runs one composed configuration; returns the error if a sweeper minimises it.
    pool
        Whether the pool of workers may run the jobs of a sweep instead of `task`.
    config_name
        The file of conf/ that the command composes, unless --config-name names another.
    """

    def __init__(self, task: Task, *, pool: bool = False, config_name: str = "config") -> None:
        functools.update_wrapper(self, task)
        self.task, self.pool, self.config_name = task, pool, config_name
        self.sweep: Any = None
        """The `experiments.app.launch.Sweep` of the pool, after its start."""

    def __call__(self, cfg: DictConfig) -> float | None:
        """Run one job; bad input or storage of a single run, or a printed ending, is no failure."""
        context = HydraConfig.get()
        alone = context.mode is RunMode.RUN
        try:
            if context.job.chdir and self.task.__name__ != "identify":
                raise ConfigError(
                    "hydra.job.chdir=true: is for experiments.identify; leave it out here, because "
                    "this command works in the folder in which it starts"
                )
            with chdir(context.runtime.cwd):  # in which paths begin; see identify
                return self.task(job_config(cfg, context))
        except (*BAD_INPUT_ERRORS, OSError, ResumeRefused, EndedError) as error:
            if alone:
                raise _Refused from error
            raise
        except SystemExit as error:  # only a model's code raises it in a task
            call = f"SystemExit({error.code!r})"
            if alone:
                raise _Left(call).with_traceback(error.__traceback__) from None
            raise RuntimeError(f"{_place(error)}: raises {call}") from None


def command(
    task: Task,
    *,
    config_name: str = "config",
    pool: bool = False,
    afterwards: Callable[[Any], int] | None = None,
    settings: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Compose the configuration from the command line with Hydra, call `task`, and exit.

    Parameters
    ----------
    task
        Runs one composed configuration.
    config_name
        The file of conf/ to compose, unless --config-name names another.
    pool
        Whether `hydra/launcher=pool` may run the jobs of a sweep.
    afterwards
        Called with the finished `Sweep` of the pool; returns the exit code.
    settings
        The settings of the command and their meanings, for its help.
    """
    job = Job(task, pool=pool, config_name=config_name)
    # With this, Hydra raises its errors, and run_and_exit prints them in one line.
    os.environ["HYDRA_FULL_ERROR"] = "1"

    def run() -> int:
        options, overrides = _split(sys.argv[1:])
        folders = [CONF, *map(Path, _values(options, "--config-dir", "-cd"))]
        if len(folders) > 2:
            raise ConfigError(
                f"--config-dir: is given {len(folders) - 1} times, and Hydra reads one folder; add "
                "others as 'hydra.searchpath=[/path/to/folder]'"
            )
        if {"--help", "-h"} & set(options):
            print(help_text(task, settings, overrides, folders))
            return OK
        completes = any(text.startswith(("install=", "uninstall=", "query=")) for text in overrides)
        if options in (["--shell-completion"], ["-sc"]) and not completes:
            print(completion())
            return OK
        for folder in folders[1:]:
            check_folder(folder)
        if not completes:
            check_typed(overrides)
            check_choices(overrides)
        sys.argv[1:] = [*replace_spaces(overrides), *options]  # --info may take the next word
        try:
            main = hydra.main(
                version_base=VERSION_BASE, config_path=str(CONF), config_name=config_name
            )
            main(job)()
        except (HydraException, OmegaConfBaseException) as error:
            raise ConfigError(composition_message(error, overrides)) from error
        except _Refused as refused:
            raise refused.__cause__ or refused from None
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            if not Path(last.filename).is_relative_to(Path(hydra.__file__).parent):
                raise
            raise ConfigError(one_line(error) or f"Hydra requires: {last.line}") from error
        finally:
            code = OK if job.sweep is None else job.sweep.summed_up()
        return afterwards(job.sweep) if afterwards and job.sweep is not None else code

    run_and_exit(run)


def _split(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split arguments into the options of Hydra, with their values, and the overrides."""
    options: list[str] = []
    overrides: list[str] = []
    is_value = False
    for text in arguments:
        if is_value or text.startswith("-") or (options[-1:] == ["--info"] and "=" not in text):
            options.append(text)
            is_value = text in VALUED and not is_value
        else:
            overrides.append(text)
    return options, overrides


def _values(options: Sequence[str], *names: str) -> list[str]:
    """Values of an option, given as `--name VALUE` or `--name=VALUE`."""
    values = []
    for text, following in zip(options, [*options, ""][1:], strict=True):
        name, equals, value = text.partition("=")
        if name in names:
            values.append(value if equals else following)
    return values


def run_and_exit(job: Callable[[], int | None]) -> NoReturn:
    """Run `job` and exit with its exit code, or with the exit code of the error that it raises.

    An error is printed in one line. SIGTERM and a closed terminal stop the job like Ctrl-C, and the
    best results so far are kept. A KeyboardInterrupt without a signal, or another exception that
    only the user's model can raise, is a failed run.
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
        except BrokenPipeError:  # the reader of the output has closed the pipe
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
        except EndedError as error:
            code = error.code
        except SystemExit:
            raise
        except Exception:  # noqa: BLE001 -- a bug: the traceback is the message
            print(redacted(traceback.format_exc()), file=sys.stderr, end="")
            code = BUG
        except BaseException as error:  # noqa: BLE001 -- nothing of ours raises it
            call = f"{error}" if isinstance(error, _Left) else f"{type(error).__name__}: {error}"
            code = _say(RuntimeError(f"{_place(error)}: raises {call}"), SOME_FAILED)
    sys.exit(code)


def _place(error: BaseException) -> str:
    """File and line that raised an error."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{last.filename}:{last.lineno}"


def _say(error: BaseException, code: int) -> int:
    print(f"error: {redacted(one_line(error))}", file=sys.stderr)
    return code
