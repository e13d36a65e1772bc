"""A model given by its right-hand side: the outputs of a motion over time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from miho.compiled.course import Course
from miho.models.equations import NO_UNIT, Declared, Equations
from miho.models.integration import Path as Solution
from miho.models.integration import Sensitivities, Values, along, runge_kutta, stiff
from miho.models.layout import IDENTIFIED, MEASURED, OUTPUT, Layout, check_scales
from miho.models.model import Model
from miho.models.time_step import time_step_remarks
from miho.quantities import Array
from miho.validate import one_of, positive, whole

if TYPE_CHECKING:
    from miho.models.taped_equations import TapedEquations

RUNGE_KUTTA = "RK4"
SOLVERS = (RUNGE_KUTTA, "Radau", "BDF", "LSODA")
INTERPOLATIONS = ("linear", "hold")
SMALLEST = 1e-12
LARGEST = 1e100
"""Derivatives beyond are those of a motion that diverges: their squares would overflow."""
ORDER = 4
"""The error of RK4 falls with so high a power of its step."""


@dataclass(frozen=True)
class Trajectory(Model):
    """Outputs y = h(t, x, u, p) along the solution of dx/dt = rhs(t, x, u, p), over time.

    `rhs` and the outputs are plain functions of numbers, with their arguments by name: the time,
    states and inputs are positional, parameters keyword-only; a keyword with a default is a
    constant. Annotations are units, as are `units` by name; without it is "-". `rhs` gives one
    derivative for each state:

        def swing(x: "m", v: "m/s", force: "N", *, k: "N/m", c: "N*s/m", m: "kg" = 2.0):
            return v, (force - k * x - c * v) / m

        Trajectory(swing, states={"x": 0.0, "v": "identified"}, outputs=["x"])

    states: where each begins, in the order of the derivatives: a number; "measured", in the first
        row of a column of its name; or "identified", as a parameter called x_0.
    outputs: names of states, and functions like `rhs` that give one number, with its unit. The
        data of several outputs stand below each other, with a column `output` that counts them
        from 0 (`miho.data.stacked`); they need not be measured at the same times.
    scales: what each output is divided by, the standard deviation of its error, so that outputs of
        different units weigh what they should. The model's unit is then "-".
    interpolation: inputs are "linear" from row to row, or "hold" the earlier row's value.
    restart: None to simulate freely from the start (output error), which is right for errors of
        measurement. So many rows to start again from the measured states of each so many (1: one
        step ahead, equation error), which is right for disturbances of the motion: the errors of
        the measured states go into the rows that follow, and bias parameters.
    segments: of equal length, each begun at identified states of its own (multiple shooting without
        the constraint that they meet). That is sound for both kinds of errors, at S parameters a
        segment: it smooths the loss of long, sensitive or unstable motions.
    quantities: functions of some parameters, which are reported with their intervals.
    solver: RK4, `substeps` classical Runge-Kutta steps from row to row; or Radau, BDF or LSODA of
        SciPy for stiff equations, to the relative `tolerance`.

    Derivatives are those of the computed solution (forward sensitivities), exact where `rhs` is
    arithmetic and NumPy's functions of numbers: it then runs on the machine of `miho.core` too.
    Others are differenced, and run in NumPy, as all do where the library was installed without a C
    compiler. A solution that fails or diverges is NaN. Times increase from row to row.
    """

    rhs: Callable[..., Any]
    states: Mapping[str, float | str]
    outputs: Sequence[str | Callable[..., Any]]
    scales: Sequence[float] = ()
    interpolation: str = "linear"
    restart: int | None = None
    segments: int = 1
    solver: str = RUNGE_KUTTA
    substeps: int = 1
    tolerance: float = 1e-8
    time: str = "t"
    units: Mapping[str, str] = field(default_factory=dict)
    name: str = ""
    quantities: Sequence[Callable[..., Any]] = ()
    source: Path | None = None
    ordered = True

    def __post_init__(self) -> None:
        one_of("interpolation", self.interpolation, INTERPOLATIONS)
        one_of("solver", self.solver, SOLVERS)
        positive("tolerance", self.tolerance)
        whole("substeps", self.substeps, 1)
        whole("segments", self.segments, 1)
        if self.restart is not None:
            whole("restart", self.restart, 1)
        for setting in ("outputs", "scales", "quantities"):
            object.__setattr__(self, setting, tuple(getattr(self, setting)))
        for setting in ("states", "units"):
            object.__setattr__(self, setting, dict(getattr(self, setting)))
        if not self.name:
            object.__setattr__(self, "name", self._rhs.name)
        self._check_starts()
        self._check_outputs()
        self._check_names()
        _ = self.equations.traced  # raises where rhs does not give a derivative for each state

    def _check_names(self) -> None:
        quantities = [Declared.of(quantity) for quantity in self.quantities]
        known = {self.time, *self._columns, *self.parameters, *(q.name for q in quantities)}
        if self.units.keys() - known:
            strange = min(self.units.keys() - known)
            raise ValueError(f"units has {strange!r}, which no function takes; remove it")
        for quantity in quantities:
            unknown = [*quantity.columns, *(quantity.parameters.keys() - self.parameters.keys())]
            if unknown:
                raise ValueError(
                    f"{quantity.name}: has the argument {unknown[0]}; a quantity takes parameters "
                    f"of the model, by keyword: {', '.join(self.parameters)}"
                )

    def _check_starts(self) -> None:
        for state, start in self.states.items():
            number = isinstance(start, int | float) and np.isfinite(start)
            if not number and start not in (MEASURED, IDENTIFIED):
                raise ValueError(
                    f"states.{state} is {start!r}; expected a number, {MEASURED} or {IDENTIFIED}"
                )
        for setting, active, needed in (
            ("restart", self.restart is not None, MEASURED),
            ("segments", self.segments > 1, IDENTIFIED),
        ):
            others = [state for state, start in self.states.items() if start != needed]
            if active and others:
                raise ValueError(
                    f"{setting} is {getattr(self, setting)}, which begins at {needed} states; "
                    f"declare {', '.join(others)} as {needed}"
                )

    def __reduce__(self) -> tuple[Any, ...]:
        """The settings alone: what was traced is so again."""
        settings = [getattr(self, f.name) for f in fields(self)]
        return type(self), tuple(settings)

    def _check_outputs(self) -> None:
        if not self.outputs or not self.states:
            raise ValueError(f"{self.name}: outputs and states name at least one each")
        for output in self.outputs:
            if isinstance(output, str) and output not in self.states:
                raise ValueError(
                    f"outputs has {output!r}, which is no state; expected one of "
                    f"{', '.join(self.states)}, or a function"
                )
        check_scales(self.scales, self._output_units)

    @cached_property
    def _rhs(self) -> Declared:
        return Declared.of(self.rhs)

    @cached_property
    def _outputs(self) -> tuple[str | Declared, ...]:
        return tuple(h if isinstance(h, str) else Declared.of(h) for h in self.outputs)

    @cached_property
    def _functions(self) -> tuple[Declared, ...]:
        return self._rhs, *(h for h in self._outputs if isinstance(h, Declared))

    @cached_property
    def _columns(self) -> dict[str, str]:
        """Units of time, states and inputs."""
        return _agreeing(self.units, [function.columns for function in self._functions])

    @cached_property
    def _output_units(self) -> list[str]:
        return [
            self._columns.get(h, NO_UNIT) if isinstance(h, str) else h.unit for h in self._outputs
        ]

    @cached_property
    def _driven(self) -> dict[str, str]:
        """The inputs but time, with their units."""
        return {k: v for k, v in self._columns.items() if k != self.time and k not in self.states}

    @cached_property
    def inputs(self) -> Mapping[str, str]:  # type: ignore[override]
        """Time, inputs, measured states, and which output it is where there are several."""
        measured = [state for state, start in self.states.items() if start == MEASURED]
        return (
            {self.time: self._columns.get(self.time, self.units.get(self.time, "s"))}
            | self._driven
            | {state: self._columns.get(state, NO_UNIT) for state in measured}
            | ({OUTPUT: NO_UNIT} if len(self.outputs) > 1 else {})
        )

    @cached_property
    def parameters(self) -> Mapping[str, str]:  # type: ignore[override]
        """Those of the functions, and the identified states that segments begin at."""
        own = _agreeing(self.units, [function.parameters for function in self._functions])
        starts = {
            f"{state}_{m}": self._columns.get(state, NO_UNIT)
            for m in range(self.segments)
            for state, start in self.states.items()
            if start == IDENTIFIED
        }
        twice = own.keys() & (starts.keys() | self._columns.keys())
        if twice:
            raise ValueError(f"{self.name}: {min(twice)} names two things; rename the parameter")
        return own | starts

    @property
    def output(self) -> str:  # type: ignore[override]
        """The unit of the outputs, "-" of those in multiples of their scales."""
        return NO_UNIT if self.scales else self._output_units[0]

    @property
    def derived(self) -> Mapping[str, tuple[str, Callable[[Array], Array]]]:  # type: ignore[override]
        """Unit and function of parameter rows, by the name of each quantity."""
        names = list(self.parameters)

        def of_rows(quantity: Declared) -> Callable[[Array], Array]:
            return lambda thetas: np.asarray(quantity(dict(zip(names, thetas.T, strict=True))))

        declared = map(Declared.of, self.quantities)
        return {
            q.name.replace("_", " "): (self.units.get(q.name, q.unit), of_rows(q)) for q in declared
        }

    @cached_property
    def equations(self) -> Equations:
        """What the functions declare, ready to be evaluated."""
        return Equations(
            self._rhs,
            self._outputs,
            tuple(self.scales) or (1.0,) * len(self.outputs),
            self.time,
            tuple(self.states),
            tuple(self._driven),
            tuple(self.parameters),
        )

    @property
    def _taped(self) -> TapedEquations | None:
        """The solution by the machine, None where it is NumPy's or SciPy's."""
        return self.equations.taped if self.solver == RUNGE_KUTTA else None

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) of parameter rows (n, d) at input columns (N,)."""
        course = self._course(inputs)
        out = np.empty((len(thetas), inputs[0].size))
        if self._taped is not None:
            self._taped.solve(np.array(thetas, dtype=float, order="C"), course, out)
        elif self.solver == RUNGE_KUTTA:
            motion = Values(self.equations, thetas.T.copy())
            out[:] = along(course, motion, runge_kutta(course, motion)).T
        else:
            for row, theta in zip(out, thetas, strict=True):
                motion = Values(self.equations, theta[:, None].copy())
                row[:] = along(course, motion, self._stiff(course, motion))[:, 0]
        out[~np.isfinite(out)] = np.nan
        return out

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the outputs (N, d), by the equations that they obey along the solution."""
        course, theta = self._course(inputs), np.array(theta, dtype=float)
        motion = Sensitivities(self.equations, theta, np.maximum(np.abs(theta), SMALLEST))
        if self._taped is not None:
            out = np.empty((inputs[0].size, theta.size))
            self._taped.derive(theta, course, out)
        elif self.solver == RUNGE_KUTTA:
            out = along(course, motion, runge_kutta(course, motion))
        else:
            out = along(course, motion, self._stiff(course, motion))
        out[~(np.abs(out) < LARGEST)] = np.nan
        return out

    def _stiff(self, course: Course, motion: Values | Sensitivities) -> Solution:
        return stiff(course, motion, self.solver, self.tolerance)

    def remarks(self, theta: Array, noise: float, *inputs: Array) -> list[str]:
        """A sentence if half the step would move parameters by much of their standard errors."""
        if self.solver != RUNGE_KUTTA:
            return []
        return time_step_remarks(self, ORDER, theta, noise, *inputs)

    def _course(self, inputs: tuple[Array, ...]) -> Course:
        """The course that columns (N,) describe, made once for the same read-only columns."""
        key = [id(column) for column in inputs]
        columns: tuple[Array, ...]
        course: Course | None
        columns, course = self._latest
        if course is None or key != [id(column) for column in columns]:
            course = self._layout.course(dict(zip(self.inputs, inputs, strict=True)))
            if not any(column.flags.writeable for column in inputs):
                self._latest[:] = inputs, course
        return course

    @cached_property
    def _layout(self) -> Layout:
        return Layout(
            self.time,
            tuple(self._driven),
            self.states,
            tuple(self.parameters),
            len(self.outputs),
            self.restart,
            self.segments,
            self.interpolation == "hold",
            self.substeps,
        )

    @cached_property
    def _latest(self) -> list[Any]:
        """The latest columns and their course."""
        return [(), None]


def _agreeing(given: Mapping[str, str], groups: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """The units of all names: as given, or as declared by any of the functions that take it."""
    units: dict[str, str] = {}
    for group in groups:
        for name, declared in group.items():
            for unit in (declared, given.get(name, NO_UNIT)):
                known = units.get(name, NO_UNIT)
                if NO_UNIT not in (unit, known) and unit != known:
                    raise ValueError(f"argument {name} has the units {known!r} and {unit!r}")
                units[name] = unit if known == NO_UNIT else known
    return units
