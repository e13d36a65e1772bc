"""Models that functions in a Python file of the user's describe."""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from miho.models.function_model import FunctionModel, line_in
from miho.models.model import Model
from miho.models.trajectory import RUNGE_KUTTA, Trajectory
from miho.regular_file import read_regular


def load_function(
    path: str,
    function: str | None = None,
    batched: bool | None = None,
    linear: Sequence[str] = (),
    rowwise: bool | None = None,
) -> Model:
    """The model that a function in a Python file describes; see `FunctionModel`.

    This runs the file, with all that it does. `function` may be left out if the file has just one
    public function. A change of the file is noticed, one of other files that it imports is not.
    Raises FileNotFoundError, and ValueError with file and line for a file that cannot be used.
    """
    source = Path(path)
    module = executed(source)
    public = {
        name: value
        for name, value in vars(module).items()
        if inspect.isfunction(value)
        and value.__module__ == module.__name__
        and not name.startswith("_")
    }
    if function is None and len(public) != 1:
        listed = f"public functions {', '.join(public)}" if public else "no public function"
        remedy = "choose one with the setting function" if public else "write one"
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
    """The `Trajectory` of functions in a Python file, which this runs with all that it does.

    `rhs` and `quantities` name functions of the file, `outputs` states or functions; the settings
    are those of `Trajectory`. Raises FileNotFoundError, and ValueError for a file or settings that
    cannot be used.
    """
    source = Path(path)
    functions = vars(executed(source))

    def named(name: str, setting: str) -> Callable[..., Any]:
        if not callable(functions.get(name)):
            raise ValueError(f"{source}: has no function {name!r}, which {setting} names")
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


def executed(source: Path) -> types.ModuleType:
    """The module that a Python file gives when it is run, which this does.

    Raises FileNotFoundError, and ValueError with file and line for a file that cannot be used.
    """
    module = types.ModuleType(source.stem)
    module.__file__ = str(source)
    # Read and compiled here: an import would leave its cache beside the file and trust it even
    # after an edit within the same second.
    text = read_regular(source)
    try:
        exec(compile(text, str(source), "exec", dont_inherit=True), module.__dict__)  # noqa: S102 -- the user's file
    except SyntaxError as error:
        raise ValueError(f"{source}:{error.lineno or 1}: {error.msg}; correct it") from None
    except (Exception, SystemExit) as error:
        line = line_in(error, str(source))
        place = f"{source}:{line}" if line else str(source)
        raise ValueError(f"{place}: raises {type(error).__name__}: {error}") from error
    return module
