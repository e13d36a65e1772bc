"""A model made of a plain Python function, such as a user writes in a file of their own."""

from __future__ import annotations
import __future__

import ast
import contextlib
import functools
import inspect
import traceback
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from miho.compiled.kernel import Formula
from miho.models.function_calls import CONFIGURATIONS, UNTRIED, Calls, FunctionCalls, tried_rowwise
from miho.models.model import DifferencedModel, Model
from miho.models.plain_arithmetic import may_catch
from miho.models.symbolic import (
    NotAFormulaError,
    Symbol,
    arguments_of,
    trace,
)
from miho.models.traced import TracedExpression
from miho.quantities import Array

COMPARED, CLOSE = 1000, 1e-9
"""Rows on which a formula is compared with its function, and how close they have to be."""
COPY = "; the columns of data are shared: copy one before it is changed, as in x = x.copy()"
AGREED: WeakKeyDictionary[Any, set[tuple[Formula, bytes]]] = WeakKeyDictionary()
"""The formulas with which functions agree, and at which configurations."""
REMEMBERED = 100
"""Configurations of a function to remember."""
COLUMN = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


@dataclass(frozen=True)
class FunctionModel(DifferencedModel):
    """A function whose positional arguments are input columns, keyword-only ones parameters.

    Annotations that are strings are units, and a part without one takes any; the model is called
    after the function:

        def decay(t: "s", *, a: "V", b: "1/s") -> "V":
            return a * np.exp(-b * t)

    The function gets columns (N,), read-only. With `batched` it gets parameters (n, 1), so that
    NumPy's functions give (n, N); a result (n, 1) is the same for all rows of data. With `batched`
    false it gets one row of parameters at a time, as numbers, and gives (N,) or a number: it may
    branch or simulate. None finds out: parameters come side by side where a call takes less than
    ten milliseconds and gives the same either way, to rounding (`FunctionCalls`).

    A `rowwise` function is element by element: what it gives for a row of data does not depend on
    the other rows, so it may be asked for some of them. One that is not, such as a simulation or a
    cumulative sum, always gets all rows in their order, as does one of which that is not known,
    with None. What is None `CurveFit` finds out by `tried_at`, once for all processes.

    `columns` names the arguments that are input columns, and all others are parameters, for a
    function without keyword-only ones. A parameter with a default, or bound by `functools.partial`,
    is fixed at that number unless the space has it (`defaults`); one with a default that is no
    number is left to the function. `linear` names the parameters in which the output is jointly
    linear; nobody checks it but `miho.testing.check_model`. Derivatives are central differences,
    which count two evaluations for each parameter; `formula` has exact ones.

    Raises ValueError for another signature, and where the function raises or gives another
    shape; NaN and infinity are values like any other, so NumPy does not warn of them.
    """

    function: Callable[..., Any]
    batched: bool | None = None
    linear: tuple[str, ...] = ()
    source: Path | None = None
    columns: tuple[str, ...] = ()
    rowwise: bool | None = None
    tried: Calls = UNTRIED
    inputs: Mapping[str, str] = field(init=False)
    parameters: Mapping[str, str] = field(init=False)
    output: str = field(init=False)
    name: str = field(init=False)

    def __post_init__(self) -> None:
        try:
            signature = inspect.signature(self.function)
        except (TypeError, ValueError):
            raise ValueError(f"{self.function!r} is not a function with a signature") from None
        plain = self._plain
        own = (signature if plain is self.function else inspect.signature(plain)).parameters
        name = getattr(plain, "__name__", type(plain).__name__)
        code = getattr(plain, "__code__", None)
        source = bool(code and code.co_flags & __future__.annotations.compiler_flag)
        object.__setattr__(self, "name", name)
        columns: dict[str, str] = {}
        parameters: dict[str, str] = {}
        defaults: dict[str, float] = {}
        for argument in signature.parameters.values():
            if argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD):
                raise ValueError(f"{self._place}: {argument} stands for any argument; name each")
            default = argument.default
            column = own[argument.name].kind in COLUMN and default is argument.empty
            if self.columns:
                column = argument.name in self.columns
            if not column and default is not argument.empty:
                if not is_number(default):
                    continue  # a setting that is none of numbers, which stays as it is
                defaults[argument.name] = float(default)
            group = columns if column else parameters
            group[argument.name] = declared_unit(argument.annotation, source)
        output = declared_unit(signature.return_annotation, source)
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
        object.__setattr__(self, "defaults", types.MappingProxyType(defaults))
        object.__setattr__(self, "linear", tuple(self.linear))

    def __reduce__(self) -> tuple[Any, ...]:
        """What it was made of, from which it is made again."""
        own = (self.function, self.batched, self.linear, self.source, self.columns)
        return FunctionModel, (*own, self.rowwise, self.tried)

    @cached_property
    def by_numbers(self) -> FunctionModel:
        """The same function, called with one row of parameters at a time, as numbers."""
        model = object.__new__(FunctionModel)  # all else that is known of this one stays so
        vars(model).update(vars(self), tried=Calls(False, False))
        vars(model).pop("_calls", None)
        return model

    @property
    def ordered(self) -> bool:  # type: ignore[override]
        """Whether it may need every row in order: unless it is known to be `rowwise`."""
        return not (self.tried.rowwise if self.rowwise is None else self.rowwise)

    @property
    def formula(self) -> FunctionFormula | None:
        """The function as a formula of its parameters, None where it is more than arithmetic."""
        formula = FunctionFormula(self)
        try:
            used = arguments_of([formula.graph])
        except NotAFormulaError:
            return None
        return formula if any(p.arguments[0] in used for p in formula.arguments) else None

    def formula_at(self, thetas: Array, *inputs: Array) -> Model:
        """Its formula, if that gives what the function gives at parameter rows (n, d) and columns.

        Else this model: a function may tell arrays from symbols, or not be element by element, or
        have values where the formula has no derivatives.
        """
        formula = self.formula
        if formula is None:
            return self
        columns = list(inputs)
        if inputs[0].size > COMPARED:
            rows = np.linspace(0, inputs[0].size - 1, COMPARED).round().astype(int)
            columns = [column[rows] for column in inputs]
        try:
            traced = formula.predict(thetas, *columns)
            agree = formula.agreed(thetas, lambda: alike(self.predict(thetas, *columns), traced))
            slopes = formula.jacobian(thetas, *columns)
        except (Exception, NotAFormulaError):  # noqa: BLE001 -- it is called, whatever the reason
            return self
        usable = np.isfinite(slopes).all(axis=2) | ~np.isfinite(traced)
        return formula if agree and usable.all() else self

    def tried_at(self, thetas: Array, *inputs: Array) -> FunctionModel:
        """This model with what calls at parameter rows (n, d) and columns (N,) show of it.

        It is tried once. Of one that takes long also for some rows of data, two calls are made: it
        gets all rows of data and one row of parameters at a time, which is never wrong.
        """
        if self.tried != UNTRIED or (self.batched is not None and self.rowwise is not None):
            return self
        rowwise, long = tried_rowwise(self.predict, thetas, inputs)
        if not long:
            with contextlib.suppress(ValueError):  # of some configuration
                self.predict(thetas[:CONFIGURATIONS], *inputs)
        batched = self._calls.batched
        if batched is None and self._calls.takes_numbers:
            batched = False
        return replace(self, tried=Calls(batched, rowwise, dear=long and rowwise is None))

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) of parameter rows (n, d) at input columns (N,)."""
        columns = [column.view() for column in inputs]
        for column in columns:
            column.flags.writeable = False
        return self._calls.values(thetas, columns)

    @cached_property
    def _calls(self) -> FunctionCalls:
        tried = self.tried.batched
        if tried is None and may_catch(self._called):
            tried = False
        return FunctionCalls(self._call, self.batched, tried, self._place)

    def _call(self, columns: Sequence[Array], parameters: Any) -> NDArray[Any]:
        """The function's result, which must be real numbers; ValueError if it is not, or raises."""
        try:
            with np.errstate(all="ignore"):
                named = dict(zip(self.parameters, parameters, strict=True))
                if self.columns:  # which may stand between parameters
                    named |= dict(zip(self.inputs, columns, strict=True))
                    columns = ()
                result = self.function(*columns, **named)
            values = np.asarray(result)
        except MemoryError:
            raise
        except Exception as error:
            raise ValueError(self._at_line(error)) from error
        if values.dtype.kind not in "fiu":
            parts = "; return one part; miho.fit_joint fits both" * (values.dtype.kind == "c")
            raise ValueError(f"{self._place}: gives {values.dtype}; expected real numbers{parts}")
        return values

    @property
    def _place(self) -> str:
        return f"{self.source or self._plain.__module__}: {self.name}"

    @property
    def _called(self) -> Any:
        """What a call of it runs: of an object its method."""
        kind = type(self._plain)
        return self._plain if isinstance(self._plain, types.FunctionType) else kind.__call__

    @property
    def _plain(self) -> Callable[..., Any]:
        """The function without the arguments that a `functools.partial` of it binds."""
        function = self.function
        while isinstance(function, functools.partial):
            function = function.func
        return function

    def _at_line(self, error: Exception) -> str:
        """A message on what the function raised, and in which line of its file."""
        line = line_in(error, str(self.source))
        place = f"{self.source}:{line}: {self.name}" if line else self._place
        return f"{place} raises {type(error).__name__}: {error}{COPY * ('read-only' in str(error))}"


def is_number(value: object) -> bool:
    """Whether it is one real number, and no truth value."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def alike(first: Array, second: Array) -> bool:
    """Whether outputs are the same to CLOSE, with NaN and infinity in the same places."""
    if np.array_equal(first, second):
        return True
    size = np.abs(first[np.isfinite(first)]).max(initial=0.0)
    return np.allclose(first, second, rtol=CLOSE, atol=CLOSE * size, equal_nan=True)


def declared_unit(annotation: Any, source: bool) -> str:
    """The unit in an annotation, "" for one that is no string.

    With `from __future__ import annotations` an annotation is its `source`: a string is in quotes.
    """
    if source and isinstance(annotation, str):
        try:
            annotation = ast.literal_eval(annotation)
        except (SyntaxError, ValueError):
            return ""
    return annotation if isinstance(annotation, str) else ""


@dataclass(frozen=True)
class FunctionFormula(TracedExpression):
    """A function of arithmetic and NumPy's functions of numbers, traced once.

    So its derivatives are exact, its loss has fast forms, and the parameters in which it is
    jointly linear are known, unless the function model declares them itself.
    """

    function: FunctionModel

    def agreed(self, thetas: Array, compare: Callable[[], bool]) -> bool:
        """Whether function and formula agree at parameter rows (n, d), which a process compares
        once: many fits of a function within the same bounds pay for one comparison."""
        try:
            known = AGREED.setdefault(self.function.function, set())
        except TypeError:  # an object that has no hash, or cannot be referred to weakly
            return compare()
        at = self.value, thetas.tobytes()
        if at not in known:
            if not compare():
                return False
            if len(known) >= REMEMBERED:
                known.clear()
            known.add(at)
        return True

    @cached_property
    def graph(self) -> Symbol:
        """The function's result; raises NotAFormulaError for one that is no formula."""
        named = dict(zip(self.parameters, self.arguments, strict=True))
        if self.function.columns:
            named |= dict(zip(self.inputs, self.columns, strict=True))
            return trace(self.function.function, **named)
        return trace(self.function.function, *self.columns, **named)

    @cached_property
    def linear(self) -> tuple[str, ...]:  # type: ignore[override]
        """The parameters in which the function declares to be linear, or is."""
        if self.function.linear:
            return self.function.linear
        return self.jointly_linear

    @property
    def inputs(self) -> Mapping[str, str]:  # type: ignore[override]
        """Units by name."""
        return self.function.inputs

    @property
    def parameters(self) -> Mapping[str, str]:  # type: ignore[override]
        """Units by name."""
        return self.function.parameters

    @property
    def output(self) -> str:  # type: ignore[override]
        """The unit of the result."""
        return self.function.output

    @property
    def name(self) -> str:  # type: ignore[override]
        """The function's name."""
        return self.function.name

    @property
    def source(self) -> Path | None:  # type: ignore[override]
        """The file that the function was read from."""
        return self.function.source


def line_in(error: BaseException, file: str) -> int | None:
    """The last line of `file` that an error passed through."""
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == file]
    return lines[-1] if lines else None
