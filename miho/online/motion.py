"""One step of a differential equation as a formula of one row, which a tracker can follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeGuard

import numpy as np

from miho.data.dataset import Dataset
from miho.identification.curve_fit import CurveFit
from miho.models import Model, Trajectory
from miho.models.equations import NO_UNIT
from miho.models.layout import OUTPUT
from miho.models.symbolic import Symbol, trace
from miho.models.tied import Tied, tie
from miho.models.traced import TracedExpression
from miho.online.method import Rows, numbers_of, rows_of
from miho.online.outputs import NEXT, TIME
from miho.optim.space import Space
from miho.quantities import Array
from miho.units import UNITS

STEP = "step"
"""Column of the duration of a step, in the unit of the trajectory's time."""
LONGEST = 5.0
"""Longest step, in medians of the steps in the data; a longer one separates two motions."""
GAPS = 3
"""Number of steps too long, and none short enough, at which rows are refused."""


def one_step(problem: CurveFit) -> tuple[CurveFit, ...]:
    """Return one problem for each state of a `Trajectory`: the state one step later.

    One step of the classical Runge-Kutta method, without substeps, starts from the measured states
    of a row. The inputs of its formula are the duration `step` in the unit of time, the inputs of
    the equation at the start and at the end of the step (`steering`, `steering_next`), and the
    states. Its output is a state at the end, such as `vy_next`. A tracker needs the noise of the
    measured states as `input_noise`.

    Parameters
    ----------
    problem : CurveFit
        A problem whose model is a `Trajectory` with all states as outputs.

    Returns
    -------
    tuple of CurveFit
        A problem for each state, with the parameters of the right-hand side.

    Raises
    ------
    ValueError
        If the outputs are not all states, if the right-hand side is not a formula or depends on
        time, or if parameters are fixed or tied and initial states are identified.

    Examples
    --------
    >>> import numpy as np
    >>> import miho
    >>> def decay(x: "V", *, a: "1/s"):
    ...     return -a * x
    >>> model = miho.models.Trajectory(decay, states={"x": 2.0}, outputs=["x"])
    >>> t = np.linspace(0, 1, 11)
    >>> data = miho.Dataset("cooling", {"t": t, "x": 2 * np.exp(-t)}, {"t": "s", "x": "V"}, "x")
    >>> space = miho.Space((miho.Parameter("a", "1/s", 0, 5),))
    >>> [after] = one_step(miho.CurveFit(model, data, space, sigma=0.01))
    >>> after.dataset.output, list(after.model.inputs)
    ('x_next', ['step', 'x'])
    >>> x_next = after.model.predict(np.array([[1.0]]), np.array([0.1]), np.array([2.0]))
    >>> round(float(x_next[0, 0]), 6)
    1.809675
    """
    trajectory = _trajectory(problem)
    rows = StepRows.of_problem(problem).take(measured_motion(problem))
    complete = np.isfinite(list(rows.values())).all(axis=0)
    scales = dict(zip(trajectory.outputs, trajectory.equations.scales, strict=True))
    sigma = problem.scale
    if sigma is None and trajectory.scales:
        sigma = 1.0
    tied, own = isinstance(problem.model, Tied), trajectory.equations.rhs.parameters
    space = Space(tuple(p for p in problem.space.parameters if tied or p.name in own))
    problems = []
    for state in trajectory.states:
        model: Model = OneStep(trajectory, state)
        units = {**model.inputs, state + NEXT: model.output}
        columns = {name: rows[name][complete] for name in units}
        data = Dataset(f"{problem.name}_{state}", columns, units, state + NEXT)
        if isinstance(problem.model, Tied):
            model = tie(model, problem.model.ties)
        error = None if sigma is None else sigma * scales[state]
        known = problem.sigma_known or bool(trajectory.scales)
        problems.append(CurveFit(model, data, space, sigma=error, sigma_known=known))
    return tuple(problems)


def is_motion(problem: object) -> TypeGuard[CurveFit]:
    """Whether a problem has a `Trajectory` as its model."""
    return isinstance(problem, CurveFit) and isinstance(problem.model.whole, Trajectory)


@dataclass(frozen=True)
class OneStep(TracedExpression):
    """A state after one step of the classical Runge-Kutta method from the states of a row."""

    trajectory: Trajectory
    state: str

    @cached_property
    def inputs(self) -> Mapping[str, str]:
        """Units of the step, of the inputs at its start and end, and of the states."""
        time = self.trajectory.inputs[self.trajectory.time]
        equations = self.trajectory.equations
        ends = ("",) if self.trajectory.interpolation == "hold" else ("", NEXT)
        driven = {u + end: self.trajectory.inputs[u] for end in ends for u in equations.inputs}
        return {STEP: time} | driven | {state: self._unit(state) for state in equations.states}

    @cached_property
    def parameters(self) -> Mapping[str, str]:
        """Units of the parameters of the right-hand side."""
        own = self.trajectory.equations.rhs.parameters
        return {name: unit for name, unit in self.trajectory.parameters.items() if name in own}

    @property
    def output(self) -> str:
        """Unit of the state."""
        return self._unit(self.state)

    @property
    def name(self) -> str:
        """Name of the state one step later."""
        return self.state + NEXT

    def _unit(self, state: str) -> str:
        declared = self.trajectory.equations.rhs.columns.get(state, NO_UNIT)
        return self.trajectory.units.get(state, declared)

    @cached_property
    def graph(self) -> Symbol:
        """Graph of the state one step later."""
        return trace(self._after)

    def _after(self) -> Any:
        equations = self.trajectory.equations
        row = dict(zip(self.inputs, self.columns, strict=True))
        theta = dict(zip(self.parameters, self.arguments, strict=True))
        start = [row[state] for state in equations.states]
        place, rates = equations.states.index(self.state), [0.0] * len(start)
        change = 0.0
        for share, weight in ((0.0, 1 / 6), (0.5, 1 / 3), (0.5, 1 / 3), (1.0, 1 / 6)):
            driven = {u: row[u] + share * (row.get(u + NEXT, row[u]) - row[u])
                      for u in equations.inputs}  # fmt: skip
            states = [x + share * row[STEP] * dx for x, dx in zip(start, rates, strict=True)]
            motion = dict(zip(equations.states, states, strict=True))
            rates = list(equations.rates_of({**driven, **motion, **theta}))
            change = change + weight * rates[place]
        return start[place] + row[STEP] * change


@dataclass
class StepRows:
    """Consecutive rows of a motion, of states and inputs by `names`, as rows of one step each.

    After a step above `longest`, or a `time` that goes back, the motion starts anew. `unit` is the
    unit of both [s].
    """

    names: tuple[str, ...]
    time: str
    longest: float
    unit: float
    _last: Array = field(init=False, repr=False)
    _gaps: float = field(init=False, repr=False, default=0.0)

    def __post_init__(self) -> None:
        self._last = np.empty((0, 1 + len(self.names)))

    @classmethod
    def of_problem(cls, problem: CurveFit) -> StepRows:
        """Return the steps of the motion of a problem, which has seen no row."""
        trajectory = _trajectory(problem)
        equations = trajectory.equations
        times = np.unique(problem.dataset[trajectory.time])
        longest = LONGEST * float(np.median(np.diff(times)))
        unit = UNITS.get(trajectory.inputs[trajectory.time], UNITS["s"]).factor
        return cls((*equations.states, *equations.inputs), trajectory.time, longest, unit)

    def anew(self) -> StepRows:
        """Return the same, without the last row."""
        return replace(self)

    def noise(self, sigma: Array) -> dict[str, float]:
        """Return the noise of the states by name; `sigma` is the noise of each one step later."""
        return dict(zip(self.names, sigma.tolist(), strict=False))

    def take(self, rows: Rows) -> dict[str, Array]:
        """Return the steps that end in these rows, by column; a step may begin in the last row."""
        columns: Mapping[str, Any] = rows.columns if isinstance(rows, Dataset) else rows
        if self.time not in columns and TIME in columns:
            columns = {**columns, self.time: numbers_of(TIME, columns[TIME]) / self.unit}
        block = rows_of(columns, (self.time, *self.names), 0.0, 0.0)[:, :-1]
        block = np.vstack([self._last, block])
        self._last = block[-1:]
        step = np.diff(block[:, 0])
        joined = (step > 0) & (step <= self.longest)
        self._gaps += -np.inf if joined.any() else np.sum(step > self.longest)
        if self._gaps >= GAPS:
            raise ValueError(
                f"rows: {self.time} increases by {np.nanmax(step):g} from row to row, and in the "
                f"data by {self.longest / LONGEST:g}; give times in the unit of the data"
            )
        now, after = block[:-1][joined].T, block[1:][joined].T
        ends = {name + NEXT: column for name, column in zip(self.names, after[1:], strict=True)}
        starts = dict(zip(self.names, now[1:], strict=True))
        return {TIME: self.unit * after[0], STEP: step[joined], **starts, **ends}


def _trajectory(problem: CurveFit) -> Trajectory:
    """The trajectory of a problem; raises ValueError if one step of it is no formula of a row."""
    trajectory = problem.model.whole
    if not isinstance(trajectory, Trajectory):
        raise ValueError(f"problem is {problem.name}; expected the problem of a Trajectory")
    equations, name = trajectory.equations, problem.name
    unseen = [state for state in trajectory.states if state not in trajectory.outputs]
    if unseen:
        raise ValueError(
            f"problem: the state {unseen[0]!r} of {name} is not measured; expected all states as "
            "outputs"
        )
    if any(not isinstance(output, str) for output in trajectory.outputs):
        raise ValueError(f"problem: {name} has a function as an output; expected states only")
    if trajectory.time in equations.rhs.columns:
        raise ValueError(
            f"problem: the right-hand side of {name} depends on {trajectory.time!r}; expected "
            "states, inputs and parameters only"
        )
    if not equations.traced:
        raise ValueError(
            f"problem: the right-hand side of {name} is not a formula; expected arithmetic and "
            "NumPy's elementwise functions"
        )
    own = equations.rhs.parameters
    if isinstance(problem.model, Tied) and set(trajectory.parameters) != set(own):
        raise ValueError(
            f"problem: {name} fixes or ties parameters and identifies initial states; expected "
            "measured initial states"
        )
    taken = {STEP, TIME} & {*equations.states, *equations.inputs}
    if taken:
        raise ValueError(f"problem: {name} has a column {min(taken)!r}; rename it")
    return trajectory


def measured_motion(problem: CurveFit) -> dict[str, Array]:
    """Return time, inputs and states by column; NaN if a state was not measured at a time."""
    trajectory, data = _trajectory(problem), problem.dataset
    equations = trajectory.equations
    t, first = np.unique(data[trajectory.time], return_index=True)
    several = len(trajectory.outputs) > 1
    kind = data[OUTPUT] if several else np.zeros(len(data))
    columns = {trajectory.time: t, **{u: data[u][first] for u in equations.inputs}}
    for k, (state, scale) in enumerate(zip(trajectory.outputs, equations.scales, strict=True)):
        own, columns[str(state)] = kind == k, np.full(t.size, np.nan)
        at = np.searchsorted(t, data[trajectory.time][own])
        columns[str(state)][at] = scale * data[data.output][own]
    return columns
