"""Equations of motion from plain functions: rates of states, outputs, and derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from miho.models.formula_text import written
from miho.models.function_model import COLUMN, declared_unit, signature_of
from miho.models.model import ROOT, VISIBLE
from miho.models.symbolic import NotAFormulaError, Symbol, argument, gradient, of_symbols, trace
from miho.models.taped_equations import TapedEquations, taped_equations
from miho.quantities import Array

NO_UNIT = "-"


@dataclass(frozen=True)
class Declared:
    """A plain function with the units of its arguments, "-" without an annotation.

    Positional arguments are `columns`: states, inputs and time. Keyword-only arguments are
    `parameters`, or constants if they have a default. Raises ValueError for *args and **kwargs.
    """

    function: Callable[..., Any]
    name: str
    columns: Mapping[str, str]
    parameters: Mapping[str, str]
    unit: str

    @classmethod
    def of(cls, function: Callable[..., Any]) -> Declared:
        """Read a function's signature."""
        signature, name, postponed = signature_of(function)
        columns: dict[str, str] = {}
        parameters: dict[str, str] = {}
        for each in signature.parameters.values():
            if each.kind in (each.VAR_POSITIONAL, each.VAR_KEYWORD):
                raise ValueError(
                    f"{name}: expected named arguments, got {each}; name each argument"
                )
            if each.default is each.empty:
                group = columns if each.kind in COLUMN else parameters
                group[each.name] = declared_unit(each.annotation, postponed) or NO_UNIT
        unit = declared_unit(signature.return_annotation, postponed) or NO_UNIT
        return cls(function, name, columns, parameters, unit)

    def __call__(self, values: Mapping[str, Any]) -> Any:
        """Return the result for values by name."""
        arguments = [values[name] for name in self.columns]
        return self.function(*arguments, **{name: values[name] for name in self.parameters})


@dataclass(frozen=True)
class Equations:
    """dx/dt = rhs(t, x, u, p) and outputs y = h(t, x, u, p) / scale, of states x (S,).

    Functions get their arguments by name: the time, states, inputs u (q,) and parameters p (d,).
    An output is a function or the name of a state. Arrays may have a second axis of n parameter
    rows. Functions that can be traced (`miho.models.symbolic`) are differentiated exactly, and are
    `taped` for the machine. For other functions, derivatives are central differences of rhs and h.
    """

    rhs: Declared
    outputs: tuple[str | Declared, ...]
    scales: tuple[float, ...]
    time: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]

    def rates(self, t: float, u: Array, x: Array, p: Array) -> Array:
        """The derivatives of the states, (S,) or (S, n)."""
        if not self._formulas:
            return self._called(self.rates_of, t, u, x, p)
        return _stacked(self._formulas["rates"]((t, *u, *x, *p)), x.shape[1:])

    def observed(self, t: float, u: Array, x: Array, p: Array) -> Array:
        """The outputs, (K,) or (K, n)."""
        if not self._formulas:
            return self._called(self._observed, t, u, x, p)
        return _stacked(self._formulas["outputs"]((t, *u, *x, *p)), x.shape[1:])

    def rate_slopes(self, t: float, u: Array, x: Array, p: Array) -> tuple[Array, Array]:
        """Return derivatives of the rates (S,) by states (S, S) and by parameters (S, d)."""
        if not self._formulas:
            return self._differences(self.rates_of, t, u, x, p)
        return self._split(self._formulas["rate_slopes"]((t, *u, *x, *p)))

    def output_slopes(self, t: float, u: Array, x: Array, p: Array) -> tuple[Array, Array]:
        """Return derivatives of the outputs by states (K, S) and by parameters (K, d)."""
        if not self._formulas:
            return self._differences(self._observed, t, u, x, p)
        return self._split(self._formulas["output_slopes"]((t, *u, *x, *p)))

    @property
    def traced(self) -> bool:
        """Whether all functions can be traced.

        Raises ValueError unless rhs returns one derivative per state.
        """
        return self._graphs is not None

    @cached_property
    def taped(self) -> TapedEquations | None:
        """Equations for the machine, None without a machine or if they cannot be traced."""
        return None if self._graphs is None else taped_equations(*self._graphs, *self._symbols)

    def _values(
        self, t: Any, u: Iterable[Any], x: Iterable[Any], p: Iterable[Any]
    ) -> dict[str, Any]:
        names = (self.time, *self.inputs, *self.states, *self.parameters)
        return dict(zip(names, (t, *u, *x, *p), strict=True))

    def rates_of(self, values: Mapping[str, Any]) -> Sequence[Any]:
        """Return the derivatives of the states for values by name, which may be symbols."""
        return self._one_each(self.rhs(values))

    def _one_each(self, result: Any) -> list[Any]:
        """Return the derivatives in a result; raises ValueError unless there is one per state."""
        rates = list(result) if isinstance(result, tuple | list | np.ndarray) else [result]
        rates = [] if result is None else rates
        if len(rates) != len(self.states):
            raise ValueError(
                f"{self.rhs.name}: expected one derivative for each of the states "
                f"{', '.join(self.states)}, got {len(rates)}; return them in this order"
            )
        return rates

    def _observed(self, values: Mapping[str, Any]) -> Sequence[Any]:
        results = [values[h] if isinstance(h, str) else h(values) for h in self.outputs]
        return [
            y if scale == 1 else y / scale for y, scale in zip(results, self.scales, strict=True)
        ]

    def _called(
        self, function: Callable[..., Sequence[Any]], t: float, u: Array, x: Array, p: Array
    ) -> Array:
        """Return results (K, n) of n parameter rows: in one batch, or one by one if this fails."""
        if x.ndim == 1:
            return self._called(function, t, u, x[:, None], p[:, None])[:, 0]
        try:
            return _stacked(function(self._values(t, u, x, p)), x.shape[1:])
        except Exception:  # noqa: BLE001 -- branches, or errors that the calls below raise again
            rows = zip(x.T.tolist(), p.T.tolist(), strict=True)
            return np.array([self._of_numbers(function, t, u, *row) for row in rows]).T

    def _of_numbers(
        self, function: Callable[..., Sequence[Any]], t: float, u: Any, x: Any, p: Any
    ) -> Array:
        try:
            return np.array(function(self._values(t, u, x, p)), dtype=float)
        except ArithmeticError:  # NaN for division by zero and overflow
            count = len(self.states) if function == self.rates_of else len(self.outputs)
            return np.full(count, np.nan)
        except (TypeError, ValueError, AttributeError, LookupError) as error:
            raise ValueError(
                f"{self.rhs.name}: right-hand side or output raises {type(error).__name__}: "
                f"{' '.join(str(error).split())}"
            ) from error

    def _differences(
        self, function: Callable[..., Sequence[Any]], t: float, u: Array, x: Array, p: Array
    ) -> tuple[Array, Array]:
        at = np.concatenate([x, p])
        size = float(np.abs(x).max()) or 1.0
        step = ROOT * np.where(at == 0, ROOT * size, np.abs(at))
        slopes, lost = np.zeros((1, at.size)), np.ones((1, at.size), dtype=bool)
        # A number near 0 gives no scale for its step: results that it leaves as they are, up to
        # rounding, have a wider step, first in the scale of the states.
        for least in (0.0, ROOT * min(size, ROOT), ROOT**2):
            wide = np.maximum(step, least)
            if least and not lost[:, wide > step].any():
                continue
            step = wide
            moved = np.hstack([at[:, None] + np.diag(step), at[:, None] - np.diag(step)])
            high, low = np.hsplit(self._called(function, t, u, *np.split(moved, [x.size])), 2)
            slopes = np.where(lost, (high - low) / (2 * step), slopes)
            lost = lost & (np.abs(high - low) <= VISIBLE * np.abs(high))
        return slopes[:, : x.size], slopes[:, x.size :]

    @cached_property
    def _symbols(self) -> tuple[list[Symbol], list[Symbol], list[Symbol]]:
        groups = (("u", self.inputs), ("x", self.states), ("p", self.parameters))
        u, x, p = ([argument(f"{g}{k}") for k in range(len(names))] for g, names in groups)
        return u, x, p

    @cached_property
    def _graphs(self) -> tuple[list[Symbol], list[Symbol]] | None:
        """Rates and outputs as formulas of t, u0, ..., x0, ..., p0, ...; None if not traceable."""
        values = self._values(argument("t"), *self._symbols)
        try:
            results = of_symbols(lambda: (self.rhs(values), self._observed(values)))
        except NotAFormulaError:
            return None
        groups = self._one_each(results[0]), results[1]
        try:
            rates, outputs = ([trace(lambda y=y: y) for y in group] for group in groups)
        except NotAFormulaError:
            return None
        return rates, outputs

    @cached_property
    def _formulas(self) -> dict[str, Callable[..., Any]]:
        """Traced equations as plain functions of the tuple (t, *u, *x, *p), by name; or {}."""
        if self._graphs is None:
            return {}
        (rates, outputs), (u, x, p) = self._graphs, self._symbols
        arguments = {"values": ["t", *(s.arguments[0] for s in (*u, *x, *p))]}

        def slopes(results: Sequence[Symbol]) -> list[Symbol]:
            return [slope for result in results for slope in gradient(result, [*x, *p])]

        results = {"rates": rates, "outputs": outputs}
        results |= {"rate_slopes": slopes(rates), "output_slopes": slopes(outputs)}
        return {name: written(name, arguments, own, single=False) for name, own in results.items()}

    def _split(self, slopes: Sequence[Any]) -> tuple[Array, Array]:
        S, d = len(self.states), len(self.parameters)
        both = np.array(slopes, dtype=float).reshape(-1, S + d)
        return both[:, :S], both[:, S:]


def _stacked(results: Iterable[Any], columns: tuple[int, ...]) -> Array:
    """Return results as rows (K, n) or numbers (K,); constant results are broadcast."""
    return np.array([np.broadcast_to(result, columns) for result in results], dtype=float)
