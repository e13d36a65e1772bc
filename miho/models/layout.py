"""Assignment of the rows of a record to times, inputs, outputs and starts of a motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from miho.quantities import Array, Integers
from miho.validate import positive

MEASURED, IDENTIFIED = "measured", "identified"
OUTPUT = "output"
"""Column with the number of a row's output, from 0."""
PART = "part of the row"
"""Column with the number of a row's part in a joint model, from 0."""


class Course(NamedTuple):
    """Times t (N,), inputs u (N, q), and the substeps between rows of a trajectory.

    Inputs are linear from row to row, or constant from the earlier row if `held`. At row j the data
    contain output[r] for all r = rows[i] with first[j] <= i < first[j + 1]. At row j the state is
    set to start reset[j] unless this is negative: to `values` (M, S), or to the parameter at
    position `parameters` (M, S) unless this is negative. Outputs at such a row follow the reset;
    with `restart` they precede it, except at row 0.
    """

    t: Array
    u: Array
    substeps: int
    held: bool
    first: Integers
    rows: Integers
    output: Integers
    reset: Integers
    values: Array
    parameters: Integers
    restart: bool


@dataclass(frozen=True)
class Layout:
    """Names of the columns and starts of the motion; see `miho.models.Trajectory`.

    `inputs` and `parameters` are names in order, `states` maps names to starts, and `outputs` is
    the number of outputs.
    """

    time: str
    inputs: tuple[str, ...]
    states: Mapping[str, float | str]
    parameters: tuple[str, ...]
    outputs: int
    restart: int | None
    segments: int
    held: bool
    substeps: int

    def course(self, columns: Mapping[str, Array]) -> Course:
        """Return the course of the columns; raises ValueError if rows are out of order."""
        t = columns[self.time]
        kind = self._outputs_of(columns, t)
        # Rows with the same time share one state of the motion.
        times, earliest, at = np.unique(t, return_index=True, return_inverse=True)
        inputs = np.column_stack([columns[name] for name in self.inputs] or [np.empty((t.size, 0))])
        u = np.asarray(inputs[earliest], dtype=float)
        differs = np.argwhere(inputs != u[at])
        if differs.size:
            row, k = differs[0]
            raise ValueError(
                f"column {self.inputs[k]} has two values at {self.time} = {t[row]:g}; "
                "give all outputs at one time the same inputs"
            )
        reset, values, parameters = self._starts(columns, earliest)
        return Course(
            t=np.asarray(times, dtype=float),
            u=u,
            substeps=self.substeps,
            held=self.held,
            first=np.searchsorted(np.sort(at), np.arange(times.size + 1)),
            rows=np.argsort(at, kind="stable"),
            output=kind,
            reset=reset,
            values=values,
            parameters=parameters,
            restart=self.restart is not None,
        )

    def _outputs_of(self, columns: Mapping[str, Array], t: Array) -> Integers:
        """Return the number of each row's output; the times of each output must increase."""
        output = columns.get(OUTPUT, np.zeros(t.size))
        kind = output.astype(int)
        if (kind != output).any() or kind.min() < 0 or kind.max() >= self.outputs:
            raise ValueError(
                f"column {OUTPUT}: expected whole numbers from 0 to {self.outputs - 1}, one per "
                f"output, got values from {output.min():g} to {output.max():g}"
            )
        for k in range(self.outputs):
            if not (np.diff(t[kind == k]) > 0).all():
                raise ValueError(
                    f"{self.time} does not increase from row to row; sort the rows by time and "
                    "give one record"
                )
        return kind

    def _starts(
        self, columns: Mapping[str, Array], earliest: Integers
    ) -> tuple[Integers, Array, Integers]:
        """Return the start number at each time (N,), -1 for none, and the states at each start."""
        N, count = earliest.size, self.segments
        if self.restart is not None:
            at = np.arange(0, N, self.restart)
        elif count > N:
            raise ValueError(f"segments: expected at most {N}, the number of times, got {count}")
        else:
            at = np.arange(count) * N // count
        reset = np.full(N, -1)
        reset[at] = np.arange(at.size)
        values = np.zeros((at.size, len(self.states)))
        parameters = np.full(values.shape, -1)
        names = list(self.parameters)
        for s, (state, start) in enumerate(self.states.items()):
            if start == MEASURED:
                values[:, s] = columns[state][earliest[at]]
            elif start == IDENTIFIED:
                parameters[:, s] = [names.index(f"{state}_{m}") for m in range(at.size)]
            else:
                values[:, s] = start
        return reset, values, parameters


def check_scales(scales: Sequence[float], units: Sequence[str]) -> None:
    """Raise ValueError unless there is one scale per output, or all outputs have the same unit."""
    if scales and len(scales) != len(units):
        raise ValueError(
            f"scales: expected {len(units)} numbers, one for each output, got {len(scales)}"
        )
    for scale in scales:
        positive("scales", scale)
    if len(set(units)) > 1 and not scales:
        raise ValueError(
            f"outputs have the units {', '.join(units)}; give scales, the standard deviations of "
            "their errors"
        )
