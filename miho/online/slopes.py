"""Outputs of one row and their derivatives by parameters and inputs, at several configurations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from miho.core import Tape, TapeError
from miho.models.expression import Expression
from miho.models.formula_tape import tape_of
from miho.models.symbolic import NotAFormulaError, Symbol, argument, gradient, trace
from miho.online.outputs import Output, System
from miho.quantities import Array


class Slopes(NamedTuple):
    """Outputs (m, K) of one row at K configurations, and their derivatives.

    These are by the parameters (m, K, d), and by the inputs with noise (m, K, q).
    """

    values: Array
    parameters: Array
    inputs: Array


class RowFormula(ABC):
    """Abstract base class: the outputs of one row and their derivatives."""

    @abstractmethod
    def at(self, thetas: Array, rows: Array) -> Slopes:
        """Return outputs and derivatives at configurations (K, d) and their inputs (K, p)."""


@dataclass(frozen=True, eq=False)
class TapedFormula(RowFormula):
    """Outputs and derivatives from one tape, whose columns are the inputs, then the parameters.

    Its results are, for each output, the value, the d derivatives by the parameters, and the q
    derivatives by the first inputs, which have noise.
    """

    tape: Tape
    outputs: int
    d: int
    q: int

    def at(self, thetas: Array, rows: Array) -> Slopes:
        """Return outputs and derivatives at configurations (K, d) and their inputs (K, p)."""
        K = len(thetas)
        X = np.ascontiguousarray(np.hstack([rows, thetas]).T)
        results = self.tape.evaluate(np.empty((1, 0)), X)[0]
        each = results.reshape(self.outputs, 1 + self.d + self.q, K)
        slopes = each[:, 1:].transpose(0, 2, 1)
        return Slopes(each[:, 0], slopes[:, :, : self.d], slopes[:, :, self.d :])


@dataclass(frozen=True, eq=False)
class ModelFormula(RowFormula):
    """Outputs and derivatives by the models' own functions, one configuration after the other.

    The input columns with noise come first. Their standard deviations `noise` (q,) are the steps of
    central differences.
    """

    outputs: tuple[Output, ...]
    names: tuple[str, ...]
    columns: tuple[str, ...]
    noise: Array
    _places: list[tuple[list[int], list[int]]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        places = [
            (
                [self.names.index(name) for name in output.parameters],
                [self.columns.index(name) for name in output.model.inputs],
            )
            for output in self.outputs
        ]
        object.__setattr__(self, "_places", places)

    def at(self, thetas: Array, rows: Array) -> Slopes:
        """Return outputs and derivatives at configurations (K, d) and their inputs (K, p)."""
        K, m, q = len(thetas), len(self.outputs), self.noise.size
        slopes = Slopes(np.empty((m, K)), np.zeros((m, K, thetas.shape[1])), np.zeros((m, K, q)))
        for k, (theta, row) in enumerate(zip(thetas, rows, strict=True)):
            near = np.tile(row, (1 + 2 * q, 1))  # the row, and its neighbours on both sides
            for i in range(q):
                near[1 + 2 * i, i] += self.noise[i]
                near[2 + 2 * i, i] -= self.noise[i]
            for o, (output, (own, inputs)) in enumerate(
                zip(self.outputs, self._places, strict=True)
            ):
                columns = [np.ascontiguousarray(near[:, i]) for i in inputs]
                values = output.model.predict(theta[None, own], *columns)[0]
                slopes.values[o, k] = values[0]
                slopes.inputs[o, k] = (values[1::2] - values[2::2]) / (2 * self.noise)
                single = [column[:1] for column in columns]
                slopes.parameters[o, k, own] = output.model.jacobian(theta[own], *single)[0]
        return slopes


def row_formula(system: System, columns: Sequence[str], noise: Array) -> RowFormula:
    """Return one tape if all models can be traced, otherwise the models' own functions.

    The input columns with noise come first; `noise` (q,) are their standard deviations.
    """
    tape = _traced(system, columns, noise.size)
    if tape is None:
        return ModelFormula(system.outputs, system.names, tuple(columns), noise)
    return TapedFormula(tape, len(system.outputs), len(system.names), noise.size)


def _traced(system: System, columns: Sequence[str], q: int) -> Tape | None:
    inputs = {name: argument(f"x{k}") for k, name in enumerate(columns)}
    parameters = {name: argument(f"p{k}") for k, name in enumerate(system.names)}
    by = [*parameters.values(), *list(inputs.values())[:q]]
    results: list[Symbol] = []
    try:
        for output in system.outputs:
            model = output.model
            if not isinstance(model, Expression):
                return None
            own = tuple(inputs[name] for name in model.inputs)
            graph = trace(model.value, own, tuple(parameters[name] for name in output.parameters))
            results += [graph, *gradient(graph, by)]
        tape = tape_of(results, [*inputs.values(), *parameters.values()], ())
        _ = tape.in_machine
    except (NotAFormulaError, TapeError):
        return None
    return tape
