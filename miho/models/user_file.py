"""Models of functions in a user's Python file."""

from __future__ import annotations

import copyreg
import inspect
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from miho.models.function_model import FunctionModel, line_in
from miho.models.model import Model
from miho.models.trajectory import RUNGE_KUTTA, Trajectory
from miho.regular_file import read_regular

_classes: dict[Path, dict[int, Mapping[str, type]]] = {}
"""The classes of a file by name, of each execution of the file."""


def load_function(
    path: str,
    function: str | None = None,
    batched: bool | None = None,
    linear: Sequence[str] = (),
    rowwise: bool | None = None,
) -> Model:
    """Load the model of a function in a Python file.

    The file is executed, with all its side effects. A change of the file changes the identity of
    stored runs; a change of other files that it imports does not.

    Parameters
    ----------
    path : str
        The Python file.
    function : str, optional
        Name of the function; may be left out if the file has only one public function.
    batched, linear, rowwise
        See `FunctionModel`.

    Returns
    -------
    Model
        A `FunctionModel`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file cannot be used; the message has the file and, if known, the line.
    """
    source = Path(path)
    module = executed(source)
    public = {
        name: value
        for name, value in defined_in(module).items()
        if inspect.isfunction(value) and not name.startswith("_")
    }
    if function is None and len(public) != 1:
        listed = f"public functions {', '.join(public)}" if public else "no public function"
        remedy = "name one by the setting function" if public else "define one"
        raise ValueError(f"{source}: has {listed}; {remedy}")
    chosen = next(iter(public.values())) if function is None else vars(module).get(function)
    if not callable(chosen):
        raise ValueError(
            f"{source}: has no function {function!r}; it has {', '.join(public) or 'none'}"
        )
    return FunctionModel(chosen, batched, tuple(linear), source, rowwise=rowwise)


def load_trajectory(
    path: str,
    rhs: str,
    states: Mapping[str, float | str],
    outputs: Sequence[str],
    scales: Sequence[float] = (),
    interpolation: str = "linear",
    restart: int | None = None,
    segments: int = 1,
    solver: str = RUNGE_KUTTA,
    substeps: int = 1,
    tolerance: float = 1e-8,
    time: str = "t",
    quantities: Sequence[str] = (),
) -> Model:
    """Load a `Trajectory` of functions in a Python file.

    The file is executed, with all its side effects.

    Parameters
    ----------
    path : str
        The Python file.
    rhs : str
        Name of the function of the right-hand side.
    states : Mapping[str, float or str]
        Start of each state, as in `Trajectory`.
    outputs : sequence of str
        Names of states or functions.
    scales, interpolation, restart, segments, solver, substeps, tolerance, time
        See `Trajectory`.
    quantities : sequence of str, optional
        Names of functions of parameters.

    Returns
    -------
    Model
        A `Trajectory`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file or the settings cannot be used.
    """
    source = Path(path)
    functions = vars(executed(source))

    def named(name: str, setting: str) -> Callable[..., Any]:
        if not callable(functions.get(name)):
            raise ValueError(
                f"{source}: has no function {name!r}; define it, or correct the setting {setting}"
            )
        chosen: Callable[..., Any] = functions[name]
        return chosen

    return Trajectory(
        named(rhs, "rhs"),
        states,
        [name if name in states else named(name, "outputs") for name in outputs],
        scales=scales,
        interpolation=interpolation,
        restart=restart,
        segments=segments,
        solver=solver,
        substeps=substeps,
        tolerance=tolerance,
        time=time,
        quantities=[named(name, "quantities") for name in quantities],
        source=source,
    )


def raised(error: BaseException, source: Path) -> str:
    """An exception of the user's file with its line there, for a message."""
    line = line_in(error, str(source))
    place = f"{source}:{line}" if line else str(source)
    return f"{place}: raises {type(error).__name__}: {error}"


def executed(source: Path) -> types.ModuleType:
    """Execute a Python file and return its module.

    Raises FileNotFoundError if there is no such file, and ValueError with file and line if it
    cannot be used.
    """
    module = types.ModuleType(source.stem)
    module.__file__ = str(source)
    # An import would write a cache next to the file, and would use it even after an edit within
    # the same second.
    text = read_regular(source)
    # Dataclasses look their module up there.
    added = sys.modules.setdefault(module.__name__, module) is module
    try:
        exec(compile(text, str(source), "exec", dont_inherit=True), module.__dict__)  # noqa: S102 -- the user's file
    except SyntaxError as error:
        raise ValueError(f"{source}:{error.lineno or 1}: {error.msg}; correct it") from None
    except (Exception, SystemExit) as error:
        raise ValueError(raised(error, source)) from error
    finally:
        if added:
            sys.modules.pop(module.__name__, None)
    return module


def defined_in(module: types.ModuleType) -> dict[str, Any]:
    """The functions and classes of a module by name, without imported ones."""
    return {
        name: member
        for name, member in vars(module).items()
        if (inspect.isfunction(member) or inspect.isclass(member))
        and member.__module__ == module.__name__
    }


def make_picklable(source: Path, module: types.ModuleType) -> None:
    """Pickle objects of the classes of a file by its path, since no import finds the module.

    They can be unpickled only where the file is; cloudpickle follows this too.
    """
    source = source.resolve()
    classes = {
        name: member for name, member in defined_in(module).items() if inspect.isclass(member)
    }
    known = _classes.setdefault(source, {})
    execution = 1 + max(known, default=-1)
    known[execution] = classes
    for name, own in classes.items():
        copyreg.pickle(own, _Reduce(own, (source, execution, name)))


@dataclass(frozen=True)
class _Reduce:
    """Reduces objects of a class to the place of the class, and their state."""

    own: type
    place: tuple[Path, int, str]

    def __call__(self, instance: Any) -> Any:
        reduced = instance.__reduce_ex__(4)
        if isinstance(reduced, tuple) and getattr(reduced[0], "__name__", "") == "__newobj__":
            return _created, (*self.place, *reduced[1][1:]), *reduced[2:]
        return reduced


def _created(source: Path, execution: int, name: str, *arguments: Any) -> Any:
    """An object of a class in a file, which is executed unless this process has done so."""
    known = _classes.setdefault(source, {})
    if execution not in known:
        make_picklable(source, executed(source))
        known[execution] = known[max(known)]
    own = known[execution].get(name)
    if own is None:
        raise ValueError(f"{source}: has no class {name} any more; restore it")
    return own.__new__(own, *arguments)
