"""A model made of a plain Python function, such as a user writes in a file of their own."""

from __future__ import annotations

import ast
import inspect
import traceback
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miho.models.model import DifferencedModel, Model
from miho.quantities import Array
from miho.regular_file import read_regular

COLUMN = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


@dataclass(frozen=True)
class FunctionModel(DifferencedModel):
    """A function whose positional arguments are input columns, keyword-only ones parameters.

    Annotations are units, as strings; the model is called after the function:

        def decay(t: "s", *, a: "V", b: "1/s") -> "V":
            return a * np.exp(-b * t)

    The function gets columns (N,), read-only, and parameters (n, 1), so that NumPy's functions
    give (n, N); a result (n, 1) is the same for all rows of data. With `batched` false it gets
    one row of parameters at a time, as numbers, and gives (N,) or a number: slower, but it may
    branch. `linear` names the parameters in which the output is jointly linear; nobody checks it
    but `miho.testing.check_model`. Derivatives are central differences, which count
    two evaluations for each parameter.

    Raises ValueError for another signature, and where the function raises or gives another
    shape; NaN and infinity are values like any other, so NumPy does not warn of them.
    """

    function: Callable[..., Any]
    batched: bool = True
    linear: tuple[str, ...] = ()
    source: Path | None = None
    inputs: Mapping[str, str] = field(init=False)
    parameters: Mapping[str, str] = field(init=False)
    output: str = field(init=False)
    name: str = field(init=False)

    def __post_init__(self) -> None:
        try:
            signature = inspect.signature(self.function)
        except (TypeError, ValueError):
            raise ValueError(f"{self.function!r} is not a function with a signature") from None
        name = getattr(self.function, "__name__", type(self.function).__name__)
        object.__setattr__(self, "name", name)
        columns: dict[str, str] = {}
        parameters: dict[str, str] = {}
        for argument in signature.parameters.values():
            if argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD):
                raise ValueError(f"{self._place}: {argument} stands for any argument; name each")
            label = f"argument {argument.name!r}"
            if argument.default is not argument.empty:
                raise ValueError(
                    f"{self._place}: {label} has a default, which no search would use; remove it"
                )
            group = columns if argument.kind in COLUMN else parameters
            group[argument.name] = self._unit(argument.annotation, label, argument.name)
        output = self._unit(signature.return_annotation, "the result", ") ->")
        if not columns or not parameters:
            raise ValueError(
                f"{self._place}: has {len(columns)} input columns and {len(parameters)} "
                "parameters; expected at least one of each, parameters behind a *"
            )
        unknown = [name for name in self.linear if name not in parameters]
        if unknown:
            raise ValueError(
                f"{self._place}: linear is {self.linear!r}; expected a list of names among "
                f"{', '.join(parameters)}"
            )
        object.__setattr__(self, "inputs", types.MappingProxyType(columns))
        object.__setattr__(self, "parameters", types.MappingProxyType(parameters))
        object.__setattr__(self, "output", output)
        object.__setattr__(self, "linear", tuple(self.linear))

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) of parameter rows (n, d) at input columns (N,)."""
        columns = [column.view() for column in inputs]
        for column in columns:
            column.flags.writeable = False
        if not self.batched:
            return np.vstack([self._row(theta, columns) for theta in thetas])
        try:
            values = self._call(columns, thetas.T[:, :, None].copy())
        except ValueError as error:
            if len(thetas) == 1 or not self._works_alone(thetas, columns):
                raise
            raise ValueError(
                f"{error}; it does not with one row of parameters at a time; {REMEDY}"
            ) from error
        n, rows = len(thetas), columns[0].size
        if values.shape not in ((n, rows), (n, 1)):
            raise ValueError(
                f"{self._place}: gives shape {values.shape} for columns ({rows},) and parameters "
                f"({n}, 1); expected ({n}, {rows}); {REMEDY}"
            )
        return np.broadcast_to(values, (n, rows)).astype(float)

    def _row(self, theta: Array, columns: Sequence[Array]) -> Array:
        values = self._call(columns, theta.tolist())
        rows = columns[0].size
        if values.shape not in ((rows,), ()):
            raise ValueError(
                f"{self._place}: gives shape {values.shape} for columns ({rows},); "
                f"expected ({rows},)"
            )
        return np.broadcast_to(values, rows).astype(float)

    def _works_alone(self, thetas: Array, columns: Sequence[Array]) -> bool:
        """Whether the function takes each row of parameters alone, and fails on several at once."""
        try:
            for theta in thetas:
                self._row(theta, columns)
        except ValueError:
            return False
        return True

    def _call(self, columns: Sequence[Array], parameters: Any) -> NDArray[Any]:
        """The function's result, which must be real numbers; ValueError if it is not, or raises."""
        try:
            with np.errstate(all="ignore"):
                result = self.function(
                    *columns, **dict(zip(self.parameters, parameters, strict=True))
                )
            values = np.asarray(result)
        except MemoryError:
            raise
        except Exception as error:
            raise ValueError(self._at_line(error)) from error
        if values.dtype.kind not in "fiu":
            raise ValueError(f"{self._place}: gives {values.dtype}; expected real numbers")
        return values

    @property
    def _place(self) -> str:
        return f"{self.source or self.function.__module__}: {self.name}"

    def _at_line(self, error: Exception) -> str:
        """A message on what the function raised, and in which line of its file."""
        line = _line(error, str(self.source))
        place = f"{self.source}:{line}: {self.name}" if line else self._place
        return f"{place} raises {type(error).__name__}: {error}"

    def _unit(self, annotation: Any, label: str, before: str) -> str:
        """The unit; `from __future__ import annotations` gives the source of the string."""
        if not isinstance(annotation, str):
            example = f'{before} "m"' if before.endswith(">") else f'{before}: "m"'
            raise ValueError(
                f"{self._place}: {label} has no unit; annotate it with a string, such as {example}"
            )
        try:
            literal = ast.literal_eval(annotation)
        except (SyntaxError, ValueError):
            return annotation
        return literal if isinstance(literal, str) else annotation


REMEDY = "write it with NumPy functions that broadcast, or set batched to false"


def load_function(
    path: str, function: str | None = None, batched: bool = True, linear: Sequence[str] = ()
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
    return FunctionModel(chosen, batched, tuple(linear), source)


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
        line = _line(error, str(source))
        place = f"{source}:{line}" if line else str(source)
        raise ValueError(f"{place}: raises {type(error).__name__}: {error}") from error
    return module


def _line(error: BaseException, file: str) -> int | None:
    """The last line of `file` that an error passed through."""
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == file]
    return lines[-1] if lines else None
