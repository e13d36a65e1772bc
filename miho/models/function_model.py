"""A model made of a plain Python function."""

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
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from miho.models.function_calls import (
    CONFIGURATIONS,
    UNTRIED,
    Calls,
    FunctionCalls,
    may_catch,
    tried_rowwise,
)
from miho.models.model import DifferencedModel, Model, Wrapper
from miho.models.symbolic import NotAFormulaError, Symbol, arguments_of, trace
from miho.models.traced import TracedExpression
from miho.quantities import Array
from miho.validate import is_number, true_or_false

COMPARED, CLOSE = 1000, 1e-9
"""Rows on which a formula is compared with its function, and the relative tolerance."""
ARRAY = "; a parameter is one number: name each as an argument, as in f(x, a, b)"
COPY = "; columns of data are read-only: copy a column before you change it, as in x = x.copy()"
WHOLE = "; a column is an array: use numpy.exp for math.exp, and numpy.where for if or max"
PASSED: WeakKeyDictionary[Any, set[tuple[Any, ...]]] = WeakKeyDictionary()
"""Checks that formulas of a function passed, with the bytes of configurations and columns."""
REMEMBERED, LARGEST = 100, 1 << 16
"""Largest number of remembered checks per function, and of bytes in one of them."""
COLUMN = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


@dataclass(frozen=True)
class FunctionModel(DifferencedModel):
    """Model of a function with columns as positional and parameters as keyword-only arguments.

    String annotations are units; an argument without one accepts any unit. The model has the name
    of the function. Columns (N,) are passed read-only. A parameter with a numeric default, or bound
    by `functools.partial`, is fixed at this number unless the space contains it (`defaults`). An
    argument with any other default is not a parameter. NaN and infinity are valid results, and
    NumPy's warnings about them are silenced.

    Derivatives are central differences and cost two evaluations per parameter. `formula` has exact
    derivatives if the function can be traced.

    Parameters
    ----------
    function : callable
        Function of columns and parameters.
    batched : bool, optional
        If true, parameters are arrays (n, 1) and the result has shape (n, N), or (n, 1) if it is
        the same for all rows of data. If false, each call gets one row of parameters as numbers
        and returns (N,) or a number, so the function may branch or simulate. By default, trial
        calls decide: parameters are batched if a call takes less than ten milliseconds and both
        ways agree up to rounding (see `FunctionCalls`).
    linear : sequence of str, optional
        Parameters in which the output is jointly linear. Only `miho.testing.check_model` verifies
        this declaration.
    source : Path, optional
        File of the function, for messages and for the identity of stored runs.
    columns : sequence of str, optional
        Arguments that are input columns; all other arguments are parameters. Use it for functions
        without keyword-only arguments.
    rowwise : bool, optional
        Whether the result for a row of data is independent of the other rows. A rowwise function
        may be called with some of the rows. Otherwise, as for simulations and cumulative sums, it
        always gets all rows in order. By default, `CurveFit` finds out by `tried_at`, once for all
        processes.
    tried : Calls, optional
        Results of trial calls.

    Raises
    ------
    ValueError
        If the signature cannot be used, or, during a call, if the function raises or returns
        another shape.

    Examples
    --------
    >>> import numpy as np
    >>> def decay(t: "s", *, a: "V", b: "1/s") -> "V":
    ...     return a * np.exp(-b * t)
    >>> model = FunctionModel(decay)
    >>> dict(model.parameters), model.output
    ({'a': 'V', 'b': '1/s'}, 'V')
    >>> model.predict(np.array([[2.0, 0.0]]), np.array([0.0, 1.0]))
    array([[2., 2.]])
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
        true_or_false(self, ("batched", "rowwise"), none=True)
        signature, name, source = signature_of(self.function)
        plain = plain_of(self.function)
        own = (signature if plain is self.function else inspect.signature(plain)).parameters
        object.__setattr__(self, "name", name)
        columns: dict[str, str] = {}
        parameters: dict[str, str] = {}
        defaults: dict[str, float] = {}
        for argument in signature.parameters.values():
            if argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD):
                raise ValueError(
                    f"{self._place}: expected named arguments, got {argument}; name each argument, "
                    "as in lambda t, a, b: f(t, a, b)"
                )
            default = argument.default
            column = own[argument.name].kind in COLUMN and default is argument.empty
            if self.columns:
                column = argument.name in self.columns
            if not column and default is not argument.empty:
                if not is_number(default):
                    continue  # an option of the function, not a parameter
                defaults[argument.name] = float(default)
            group = columns if column else parameters
            group[argument.name] = declared_unit(argument.annotation, source)
        output = declared_unit(signature.return_annotation, source)
        if not columns or not parameters:
            raise ValueError(
                f"{self._place}: expected at least one input column and one parameter, got "
                f"{len(columns)} and {len(parameters)}; declare parameters after a *"
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
        """Return the constructor's arguments, because properties are derived from them."""
        own = (self.function, self.batched, self.linear, self.source, self.columns)
        return FunctionModel, (*own, self.rowwise, self.tried)

    def with_numbers(self) -> FunctionModel:
        """Return the model with the function called with numbers, if it accepts arrays as well."""
        automatic = self.batched is None and self.tried.batched
        return replace(self, tried=self.tried._replace(batched=False)) if automatic else self

    @cached_property
    def by_numbers(self) -> FunctionModel:
        """The same function, called with one row of parameters at a time, as numbers."""
        model = object.__new__(FunctionModel)  # keeps the cached properties of this model
        vars(model).update(vars(self), tried=Calls(False, False))
        vars(model).pop("_calls", None)
        return model

    @property
    def ordered(self) -> bool:
        """Whether the function may need every row in order: true unless known to be `rowwise`."""
        return not (self.tried.rowwise if self.rowwise is None else self.rowwise)

    @property
    def formula(self) -> FunctionFormula | None:
        """The function as a traced formula, None if it is more than arithmetic."""
        formula = FunctionFormula(self)
        try:
            used = arguments_of([formula.graph])
        except NotAFormulaError:
            return None
        return formula if any(p.arguments[0] in used for p in formula.arguments) else None

    def formula_at(self, thetas: Array, *inputs: Array) -> Model:
        """Return the formula if it agrees with the function at parameter rows (n, d) and columns.

        Otherwise return this model. The two disagree if the function treats arrays and symbols
        differently, or if it is not elementwise. The formula is also rejected if its derivatives
        are not finite at finite values.
        """
        formula = self.formula
        if formula is None:
            return self
        columns = list(inputs)
        if inputs[0].size > COMPARED:
            rows = np.linspace(0, inputs[0].size - 1, COMPARED).round().astype(int)
            columns = [column[rows] for column in inputs]
        traced = formula

        def usable() -> bool:
            values = traced.predict(thetas, *columns)
            if not alike(self.predict(thetas, *columns), values):
                return False
            slopes = np.isfinite(traced.jacobian(thetas, *columns)).all(axis=2)
            return bool((slopes | ~np.isfinite(values)).all())

        try:
            return formula if formula.passed("usable", usable, thetas, *columns) else self
        except (Exception, NotAFormulaError):  # noqa: BLE001 -- use the function instead
            return self

    def tried_at(self, thetas: Array, *inputs: Array) -> FunctionModel:
        """Return this model with the results of trial calls at rows (n, d) and columns (N,).

        Trial calls are made once. If a call takes long even for some rows of data, two calls are
        made, and the model keeps the safe choice: all rows of data, one row of parameters.
        """
        if self.tried != UNTRIED or (self.batched is not None and self.rowwise is not None):
            return self
        rowwise, long = tried_rowwise(self.predict, thetas, inputs)
        if not long:
            with contextlib.suppress(ValueError):  # a configuration may fail
                self.predict(thetas[:CONFIGURATIONS], *inputs)
        batched = self._calls.batched
        if batched is None and self._calls.takes_numbers:
            batched = False
        return replace(self, tried=Calls(batched, rowwise, expensive=long and rowwise is None))

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Return the outputs (n, N) of parameter rows (n, d) at input columns (N,)."""
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
        """Return the function's result; raise ValueError unless it returns real numbers."""
        try:
            with np.errstate(all="ignore"):
                named = dict(zip(self.parameters, parameters, strict=True))
                if self.columns:  # columns may come between parameters
                    named |= dict(zip(self.inputs, columns, strict=True))
                    columns = ()
                result = self.function(*columns, **named)
            values = np.asarray(result)
        except MemoryError:
            raise
        except Exception as error:
            raise ValueError(self._at_line(error)) from error
        if values.dtype.kind not in "fiu":
            got = type(result).__name__ if result is None else values.dtype
            parts = "; return one part; miho.fit_joint fits both" * (values.dtype.kind == "c")
            raise ValueError(f"{self._place}: expected real numbers, got {got}{parts}")
        return values

    @property
    def _place(self) -> str:
        return f"{self.source or plain_of(self.function).__module__}: {self.name}"

    @property
    def _called(self) -> Any:
        """The code that a call runs: the function, or the `__call__` method of an object."""
        plain = plain_of(self.function)
        return plain if isinstance(plain, types.FunctionType) else type(plain).__call__

    def _at_line(self, error: Exception) -> str:
        """Return a message with the error of the function and the line of its file."""
        line = line_in(error, str(self.source))
        place = f"{self.source}:{line}: {self.name}" if line else self._place
        message = " ".join(str(error).split())  # in one line
        hint = COPY * ("read-only" in message) + ARRAY * ("'float' object is not sub" in message)
        hint += WHOLE * ("truth value of an array" in message or "arrays can be conv" in message)
        return f"{place} raises {type(error).__name__}: {message}{hint}"


def alike(first: Array, second: Array) -> bool:
    """Return whether outputs agree to CLOSE, with NaN and infinity in the same places."""
    if np.array_equal(first, second):
        return True
    size = np.abs(first[np.isfinite(first)]).max(initial=0.0)
    return np.allclose(first, second, rtol=CLOSE, atol=CLOSE * size, equal_nan=True)


def plain_of(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function without `functools.partial` around it."""
    while isinstance(function, functools.partial):
        function = function.func
    return function


def signature_of(function: Callable[..., Any]) -> tuple[inspect.Signature, str, bool]:
    """Return a function's signature, its name, and whether annotations are source text."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        raise ValueError(f"{function!r} is not a function with a signature; wrap it") from None
    plain = plain_of(function)
    flags = getattr(getattr(plain, "__code__", None), "co_flags", 0)
    source = bool(flags & __future__.annotations.compiler_flag)
    return signature, str(getattr(plain, "__name__", type(plain).__name__)), source


def declared_unit(annotation: Any, source: bool) -> str:
    """Return the unit in an annotation, "" if the annotation is not a string.

    With `from __future__ import annotations`, annotations are source text (`source` is true), so
    a string is in quotes.
    """
    if source and isinstance(annotation, str):
        annotation = _literal(annotation)
    return annotation if isinstance(annotation, str) else ""


@lru_cache(maxsize=256)
def _literal(text: str) -> Any:
    """Return the value of a literal as source text, None for other text."""
    try:
        return ast.literal_eval(text)
    except (SyntaxError, ValueError):
        return None


@dataclass(frozen=True)
class FunctionFormula(Wrapper, TracedExpression):
    """A traced function, which consists of arithmetic and NumPy's elementwise functions.

    Its derivatives are exact and its loss has fast forms. The trace also finds the parameters in
    which the output is jointly linear, unless the function model declares them.
    """

    model: FunctionModel

    def with_numbers(self) -> FunctionModel:
        """Return the function itself, called with numbers."""
        return self.model.by_numbers

    def passed(self, name: str, check: Callable[[], bool], *arrays: Array) -> bool:
        """Return whether the formula passes a check that depends on these arrays alone.

        A process checks once for the same formula and arrays, unless the arrays are large. The
        result of a fit is compared with the function in any case.
        """
        try:
            known = PASSED.setdefault(self.model.function, set())
        except TypeError:  # an object without a hash or weak references
            return check()
        if sum(array.nbytes for array in arrays) > LARGEST:
            return check()
        at = self.value, name, *(array.tobytes() for array in arrays)
        if at not in known:
            if not check():
                return False
            if len(known) >= REMEMBERED:
                known.clear()
            known.add(at)
        return True

    @cached_property
    def graph(self) -> Symbol:
        """Graph of the function's result; raises NotAFormulaError if it cannot be traced."""
        named = dict(zip(self.parameters, self.arguments, strict=True))
        if self.model.columns:
            named |= dict(zip(self.inputs, self.columns, strict=True))
            return trace(self.model.function, **named)
        return trace(self.model.function, *self.columns, **named)

    @cached_property
    def linear(self) -> tuple[str, ...]:
        """The declared linear parameters, otherwise the ones found by the trace."""
        return self.model.linear or self.jointly_linear


def line_in(error: BaseException, file: str) -> int | None:
    """Return the last line of `file` in the traceback of an error, None if there is none."""
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == file]
    return lines[-1] if lines else None
