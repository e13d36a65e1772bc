"""A model given by an ordinary differential equation: outputs along its solution over time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from miho.models.equations import NO_UNIT, Declared, Equations
from miho.models.integration import Motion, Sensitivities, Values, along, runge_kutta, stiff
from miho.models.layout import IDENTIFIED, MEASURED, OUTPUT, Course, Layout, check_scales
from miho.models.model import Model
from miho.models.time_step import time_step_remarks
from miho.quantities import Array
from miho.units import differ
from miho.validate import one_of, positive, whole

if TYPE_CHECKING:
    from miho.models.taped_equations import TapedEquations

RUNGE_KUTTA = "RK4"
SOLVERS = (RUNGE_KUTTA, "Radau", "BDF", "LSODA")
INTERPOLATIONS = ("linear", "hold")
SMALLEST = 1e-12
LARGEST = 1e100
"""Larger derivatives indicate a diverging solution; their squares would overflow."""
ORDER = 4
"""Order of convergence of RK4 in the step size."""


@dataclass(frozen=True)
class Trajectory(Model):
    """Outputs y = h(t, x, u, p) along the solution of dx/dt = rhs(t, x, u, p), over time.

    `rhs` and the outputs are plain functions, which are called with numbers by argument name. The
    time, states and inputs are positional arguments, and parameters are keyword-only. A keyword
    argument with a default is a constant. Annotations are units; `units` adds further units by
    name, and the default is "-". Times must increase from row to row. A solution that fails or
    diverges is NaN.

    Derivatives are forward sensitivities of the computed solution. They are exact if `rhs`
    consists of arithmetic and NumPy's elementwise functions; such equations also run in the
    virtual machine of `miho.core` if it was compiled. Other functions are differentiated by
    central differences and run in NumPy.

    Parameters
    ----------
    rhs : callable
        Right-hand side, which returns one derivative per state.
    states : Mapping[str, float or str]
        Start of each state, in the order of the derivatives: a number; "measured" for the first
        row of the column with the name of the state; or "identified" for a parameter (x_0 for
        the state x, and x_1, x_2, ... in further segments).
    outputs : sequence of str or callable
        Names of states, or functions like `rhs` that return one number. The rows of several
        outputs are stacked, with a column `output` that counts them from 0
        (`miho.data.stacked`); outputs may be measured at different times.
    scales : sequence of float, optional
        Standard deviation of the error of each output. Outputs are divided by it, so outputs with
        different units are weighted properly, and the unit of the model is "-".
    interpolation : {"linear", "hold"}, optional
        Inputs between rows: linear, or constant at the earlier row's value.
    restart : int, optional
        By default, the simulation runs freely from the start (output error), which is correct for
        measurement errors. With a number of rows, the simulation restarts from the measured
        states after each such number of rows (1: one-step-ahead prediction, equation error),
        which is correct for disturbances of the motion. Errors of the measured states then
        propagate into the next rows and bias the parameters.
    segments : int, optional
        Number of segments of equal length, each with identified initial states (multiple shooting
        without continuity constraints). It is valid for both kinds of errors, costs one parameter
        per state and segment, and smooths the loss of long, sensitive or unstable motions.
    solver : {"RK4", "Radau", "BDF", "LSODA"}, optional
        RK4, the classical Runge-Kutta method, or a method of SciPy for stiff equations.
    substeps : int, optional
        Steps of RK4 between two rows.
    tolerance : float, optional
        Relative tolerance of SciPy's solvers.
    time : str, optional
        Name of the time column.
    units : Mapping[str, str], optional
        Units by name, in addition to annotations.
    name : str, optional
        Name of the model, by default the name of `rhs`.
    quantities : sequence of callable, optional
        Functions of some parameters, reported with intervals.
    source : Path, optional
        File of the functions.

    Raises
    ------
    ValueError
        If functions and settings do not fit together, or if times do not increase.

    References
    ----------
    Ljung, System Identification: Theory for the User (1999), Sec. 4.2 (output error and equation
    error). Bock, in Modelling of Chemical Reaction Systems (1981) (multiple shooting).

    Examples
    --------
    >>> def swing(x: "m", v: "m/s", force: "N", *, k: "N/m", c: "N*s/m", m: "kg" = 2.0):
    ...     return v, (force - k * x - c * v) / m
    >>> model = Trajectory(swing, states={"x": 0.0, "v": "identified"}, outputs=["x"])
    >>> dict(model.parameters)
    {'k': 'N/m', 'c': 'N*s/m', 'v_0': 'm/s'}
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
        whole("restart", self.restart, 1, none=True)
        for setting in ("outputs", "scales", "quantities"):
            object.__setattr__(self, setting, tuple(getattr(self, setting)))
        for setting in ("states", "units"):
            if not isinstance(getattr(self, setting), Mapping):
                raise ValueError(f"{setting} is {getattr(self, setting)!r}; give values by name")
            object.__setattr__(self, setting, dict(getattr(self, setting)))
        if not self.name:
            object.__setattr__(self, "name", self._rhs.name)
        self._check_starts()
        self._check_outputs()
        self._check_names()
        _ = self.equations.traced  # raises unless rhs returns one derivative per state

    def _check_names(self) -> None:
        quantities = [Declared.of(quantity) for quantity in self.quantities]
        known = {self.time, *self._columns, *self.parameters, *(q.name for q in quantities)}
        if self.units.keys() - known:
            strange = min(self.units.keys() - known)
            raise ValueError(f"units has {strange!r}, which no function uses; remove it")
        for quantity in quantities:
            unknown = [*quantity.columns, *(quantity.parameters.keys() - self.parameters.keys())]
            if unknown:
                raise ValueError(
                    f"{quantity.name}: has the argument {unknown[0]}; expected parameters of the "
                    f"model, keyword-only: {', '.join(self.parameters)}"
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
                    f"{setting} is {getattr(self, setting)}, which needs {needed} states; "
                    f"declare {', '.join(others)} as {needed}"
                )

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the settings only, because cached properties are computed again."""
        settings = [getattr(self, f.name) for f in fields(self)]
        return type(self), tuple(settings)

    def _check_outputs(self) -> None:
        if not self.outputs or not self.states:
            raise ValueError(f"{self.name}: expected at least one output and one state")
        for output in self.outputs:
            if isinstance(output, str) and output not in self.states:
                raise ValueError(
                    f"outputs has {output!r}, which is not a state; expected one of "
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
        """Units of the time, states and inputs."""
        return _agreeing(self.units, [function.columns for function in self._functions])

    @cached_property
    def _output_units(self) -> list[str]:
        return [
            self._columns.get(h, NO_UNIT) if isinstance(h, str) else h.unit for h in self._outputs
        ]

    @cached_property
    def _driven(self) -> dict[str, str]:
        """Units of the inputs, without the time."""
        return {k: v for k, v in self._columns.items() if k != self.time and k not in self.states}

    @cached_property
    def inputs(self) -> Mapping[str, str]:
        """Units of the columns: time, inputs, measured states, and the number of the output."""
        measured = [state for state, start in self.states.items() if start == MEASURED]
        return (
            {self.time: self._columns.get(self.time, self.units.get(self.time, "s"))}
            | self._driven
            | {state: self._columns.get(state, NO_UNIT) for state in measured}
            | ({OUTPUT: NO_UNIT} if len(self.outputs) > 1 else {})
        )

    @cached_property
    def parameters(self) -> Mapping[str, str]:
        """Units of the functions' parameters and of the identified initial states."""
        own = _agreeing(self.units, [function.parameters for function in self._functions])
        starts = {
            f"{state}_{m}": self._columns.get(state, NO_UNIT)
            for m in range(self.segments)
            for state, start in self.states.items()
            if start == IDENTIFIED
        }
        twice = own.keys() & (starts.keys() | self._columns.keys())
        if twice:
            raise ValueError(
                f"{self.name}: the name {min(twice)} is used twice; rename the parameter"
            )
        return own | starts

    @property
    def output(self) -> str:
        """Unit of the outputs, "-" if they are divided by scales."""
        return NO_UNIT if self.scales else self._output_units[0]

    @property
    def derived(self) -> Mapping[str, tuple[str, Callable[[Array], Array]]]:
        """Unit of each quantity and its function of parameter rows, by name."""
        names = list(self.parameters)

        def of_rows(quantity: Declared) -> Callable[[Array], Array]:
            return lambda thetas: np.asarray(quantity(dict(zip(names, thetas.T, strict=True))))

        declared = map(Declared.of, self.quantities)
        return {
            q.name.replace("_", " "): (self.units.get(q.name, q.unit), of_rows(q)) for q in declared
        }

    @cached_property
    def equations(self) -> Equations:
        """Equations of the declared functions."""
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
        """Equations for the machine, None if NumPy or SciPy solves them."""
        return self.equations.taped if self.solver == RUNGE_KUTTA else None

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Return the outputs (n, N) of parameter rows (n, d) at input columns (N,)."""
        course = self._course(inputs)
        out = np.empty((len(thetas), inputs[0].size))
        if self._taped is not None:
            self._taped.solve(np.array(thetas, dtype=float, order="C"), course, out)
        else:
            every = np.arange(len(thetas))
            for rows in [every] if self.solver == RUNGE_KUTTA else every[:, None]:
                out[rows] = self._along(course, Values(self.equations, thetas[rows].T.copy())).T
        out[~np.isfinite(out)] = np.nan
        return out

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Return the derivatives of the outputs (N, d), by the sensitivity equations."""
        course, theta = self._course(inputs), np.array(theta, dtype=float)
        if self._taped is not None:
            out = np.empty((inputs[0].size, theta.size))
            self._taped.derive(theta, course, out)
        else:
            scale = np.maximum(np.abs(theta), SMALLEST)
            out = self._along(course, Sensitivities(self.equations, theta, scale))
        out[~(np.abs(out) < LARGEST)] = np.nan
        return out

    def _along(self, course: Course, motion: Motion) -> Array:
        """Return the observed values of a motion at the rows of data."""
        if self.solver == RUNGE_KUTTA:
            return along(course, motion, runge_kutta(course, motion))
        return along(course, motion, stiff(course, motion, self.solver, self.tolerance))

    def remarks(self, theta: Array, noise: float | Array, *inputs: Array) -> list[str]:
        """Return a sentence if a halved step would change parameters noticeably."""
        if self.solver != RUNGE_KUTTA:
            return []
        return time_step_remarks(self, ORDER, theta, noise, *inputs)

    def _course(self, inputs: tuple[Array, ...]) -> Course:
        """Return the course of columns (N,), cached for the same read-only columns."""
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
        """The latest columns and their course; keeping the columns keeps their ids valid."""
        return [(), None]


def _agreeing(stated: Mapping[str, str], groups: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """Return the units of all names, stated or declared by any function with this argument."""
    units: dict[str, str] = {}
    for group in groups:
        for name, declared in group.items():
            for unit in (declared, stated.get(name, NO_UNIT)):
                known = units.get(name, NO_UNIT)
                if NO_UNIT not in (unit, known) and differ(unit, known):
                    both = f"{known!r} and {unit!r}"
                    raise ValueError(f"argument {name} has the units {both}; give it one unit")
                units[name] = unit if known == NO_UNIT else known
    return units
