"""How the rows of a record stand for a motion over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from miho.compiled.course import Course
from miho.quantities import Array, Integers
from miho.validate import positive

MEASURED, IDENTIFIED = "measured", "identified"
OUTPUT = "output"
"""The column that says which output a row is of, counted from 0."""


@dataclass(frozen=True)
class Layout:
    """The columns by name, and where the motion begins: see `miho.models.Trajectory`.

    `inputs` and `parameters` are names in their order, `states` map theirs to their starts, and
    `outputs` counts the outputs.
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
        """The course that they describe; raises ValueError for rows out of order."""
        t = columns[self.time]
        kind = self._outputs_of(columns, t)
        # Rows of one time stand for one state of the motion.
        times, earliest, at = np.unique(t, return_index=True, return_inverse=True)
        inputs = np.column_stack([columns[name] for name in self.inputs] or [np.empty((t.size, 0))])
        u = np.asarray(inputs[earliest], dtype=float)
        differs = np.argwhere(inputs != u[at])
        if differs.size:
            row, k = differs[0]
            raise ValueError(
                f"column {self.inputs[k]} has two values at {self.time} = {t[row]:g}; "
                "give the outputs of one time the same inputs"
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
        """Which output each row is of, whose times increase."""
        output = columns.get(OUTPUT, np.zeros(t.size))
        kind = output.astype(int)
        if (kind != output).any() or kind.min() < 0 or kind.max() >= self.outputs:
            raise ValueError(
                f"column {OUTPUT} is {output.min():g} to {output.max():g}; expected whole numbers "
                f"from 0 to {self.outputs - 1}, which count the outputs"
            )
        for k in range(self.outputs):
            if not (np.diff(t[kind == k]) > 0).all():
                raise ValueError(
                    f"{self.time} does not increase from row to row; give one record in order of "
                    "time"
                )
        return kind

    def _starts(
        self, columns: Mapping[str, Array], earliest: Integers
    ) -> tuple[Integers, Array, Integers]:
        """Which start there is at each time (N,), -1 for none; and what it sets the states to."""
        N, count = earliest.size, self.segments
        if self.restart is not None:
            at = np.arange(0, N, self.restart)
        elif count > N:
            raise ValueError(f"segments is {count} for {N} times; expected at most as many")
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
    """Raise ValueError unless outputs of these units can be weighed by the scales, one for each."""
    if scales and len(scales) != len(units):
        raise ValueError(
            f"scales has {len(scales)} numbers for {len(units)} outputs; give one for each"
        )
    for scale in scales:
        positive("scales", scale)
    if len(set(units)) > 1 and not scales:
        raise ValueError(
            f"outputs have the units {', '.join(units)}; give scales, the standard deviations of "
            "their errors, so that they can be weighed"
        )
