"""Trajectories from tapes of the equations, solved by the machine of `miho.core`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from miho.core import Tape, TapeError, machine
from miho.models.formula_tape import tape_of
from miho.models.layout import Course
from miho.models.symbolic import Symbol, argument, constant, gradient
from miho.quantities import Array, Integers


class Slopes(NamedTuple):
    """Nonzero derivatives of rates or outputs by states (S,) and parameters (d,).

    Result i of the tape is the derivative of row at[i, 0] by state at[i, 1], or by parameter
    at[i, 1] - S. In `at` (count, 2), derivatives by states come first, and each group is sorted by
    rows. Inputs of the tape are t, u and x.
    """

    tape: Tape
    at: Integers


@dataclass(frozen=True, eq=False)
class TapedEquations:
    """Right-hand side and outputs as tapes, from which the machine computes trajectories.

    `rates` and `outputs` have the inputs x and p and the parameters t and u, so that they evaluate
    many parameter rows at once. Their slopes have the inputs t, u and x and the parameters p, so
    that they evaluate many times at once. `level` is the instruction set level of the processor,
    -1 for the highest.
    """

    rates: Tape
    outputs: Tape
    rate_slopes: Slopes
    output_slopes: Slopes
    level: int = -1

    def solve(self, thetas: Array, course: Course, out: Array) -> None:
        """Write the outputs of parameter rows (n, d) to out (n, R)."""
        rates, outputs, *_ = self._in_machine
        machine().solve_trajectories(rates, outputs, thetas, course, out)

    def derive(self, theta: Array, course: Course, out: Array) -> None:
        """Write the derivatives of the outputs at theta (d,) to out (R, d)."""
        machine().derive_trajectory(*self._in_machine, theta, course, out)

    @cached_property
    def _in_machine(self) -> list[Any]:
        slopes = self.rate_slopes, self.output_slopes
        return [
            *(tape.at_level(self.level) for tape in (self.rates, self.outputs)),
            *((tape.at_level(self.level), at) for tape, at in slopes),
        ]


def taped_equations(
    rates: Sequence[Symbol], outputs: Sequence[Symbol],
    u: Sequence[Symbol], x: Sequence[Symbol], p: Sequence[Symbol],
) -> TapedEquations | None:  # fmt: skip
    """Return the tapes of rates and outputs of t, u, x and p.

    The result is None without a machine, or if a tape is too long for it.
    """
    if machine() is None:
        return None
    driven = [argument("t"), *u]

    def slopes(results: Sequence[Symbol]) -> Slopes:
        table = [
            (k, column, slope)
            for k, result in enumerate(results)
            for column, slope in enumerate(gradient(result, [*x, *p]))
            if slope.number != 0
        ] or [(0, 0, constant(0.0))]
        table.sort(key=lambda entry: entry[1] >= len(x))
        values = [slope for *_, slope in table]
        at = np.array([place for *place, _ in table], dtype=np.int64)
        return Slopes(tape_of(values, [*driven, *x], p), at)

    taped = TapedEquations(
        tape_of(rates, [*x, *p], driven, abreast=True),
        tape_of(outputs, [*x, *p], driven, abreast=True),
        slopes(rates),
        slopes(outputs),
    )
    try:
        _ = taped._in_machine
    except TapeError:
        return None
    return taped
