"""The tracker: parameters that change while rows arrive, with intervals and an alarm."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from miho.data.dataset import Dataset
from miho.identification.report import Report, Reporting
from miho.models.identified import Identified
from miho.online.method import Problems, Rows, Running, rows_of
from miho.online.motion import StepRows, is_motion, one_step
from miho.online.outputs import TIME, Output, noise_of, noise_of_fits, problem_of, system_of
from miho.online.population import Population
from miho.online.present import present_parameters, reported_change, reported_state
from miho.online.prior import start_of
from miho.online.rules import Layout, peak_of, rules_of
from miho.online.settings import Prior, settings_of
from miho.online.slopes import row_formula
from miho.online.state import Alarm, Change, TrackerState, alarm_of
from miho.quantities import Array
from miho.validate import positive

RECENT = 2.0
"""Time for which a row counts as recent [s]."""


class Tracker(Running):
    """Parameters of a model that change while rows arrive, with intervals and an alarm.

    The tracker has a population of hypotheses: estimates with a covariance and a time of birth. One
    Gauss-Newton step per row improves each of them, and its predictive likelihood is its weight.
    Fresh hypotheses begin at the best one with the variance of a jump, so the tracker finds a jump
    within a few rows. The alarm follows the odds of the hypotheses born since the last alarm.

    Parameters
    ----------
    problem : CurveFit or sequence of CurveFit or Report or Fit
        The model of each output, its bounds, and the standard deviation of its errors; or its fit,
        or the report of its fit, which is then the prior too. The rows of its data give the largest
        information of a row on each parameter. The problem of a `Trajectory` becomes one problem
        for each state (`miho.online.one_step`); `update` then takes measured states and inputs.
    prior : Report or Fit or mapping of str to (value, standard deviation), optional
        Knowledge from before; by default the middle of the bounds and a share of their width.
    changes : mapping of str to float, optional
        Parameters that may jump, and the share of their value by which they may, or of their bounds
        if the value may be 0; by default each free parameter by 0.35. The alarm watches them.
    input_noise : mapping of str to float, optional
        Standard deviation of the noise of input columns, in their units. By default inputs have no
        noise, and the states of a `Trajectory` that of its outputs. An input `vy` with noise is a
        state if `vy_next` is an output: it is estimated together with the parameters.
    period : float, optional
        Time between two rows [s], for rows without a column "time".
    **settings
        Fields of `TrackerSettings`.

    Raises
    ------
    ValueError
        If problem, prior and settings do not fit together.

    Examples
    --------
    >>> import numpy as np
    >>> import miho
    >>> rng = np.random.default_rng(0)
    >>> x = rng.uniform(0.5, 1.5, 200)
    >>> y = np.where(np.arange(200) < 100, 2.0, 1.2) * x + 0.05 * rng.standard_normal(200)
    >>> data = miho.Dataset("line", {"x": x[:50], "y": y[:50]}, {"x": "", "y": ""}, "y")
    >>> space = miho.Space((miho.Parameter("a", "", 0, 5),))
    >>> problem = miho.CurveFit(lambda x, *, a: a * x, data, space, sigma=0.05)
    >>> tracker = miho.Tracker(problem, prior={"a": (2.0, 0.05)})
    >>> states = [tracker.update({"x": x[k], "y": y[k]}) for k in range(200)]
    >>> [str(state.alarm) for state in states if state.alarm]
    ['a fell by 38 ± 2 % at 2.1 s']
    >>> bool(abs(states[-1].values["a"] - 1.2) < 0.05)
    True
    """

    def __init__(
        self,
        problem: Problems | Report | Reporting,
        prior: Prior | Reporting = None,
        changes: Mapping[str, float] | None = None,
        input_noise: Mapping[str, float] | None = None,
        period: float = 0.02,
        **settings: Any,
    ) -> None:
        problem = problem.report() if isinstance(problem, Reporting) else problem
        prior = prior.report() if isinstance(prior, Reporting) else prior
        noise = noise_of_fits(each for each in (problem, prior) if isinstance(each, Report))
        if isinstance(problem, Report):
            prior = problem if prior is None else prior
            problem = problem_of(problem)
        self.settings = settings_of(settings)
        positive("period", period)
        for name, values in (("changes", changes), ("input_noise", input_noise)):
            if values is not None and not isinstance(values, Mapping):
                raise ValueError(f"{name} is {values!r}; expected a number for each name")
        self.period = float(period)
        self._motion = problem if is_motion(problem) else None
        self._steps: StepRows | None = None
        if self._motion is not None:
            self._steps, problem = StepRows.of_problem(self._motion), one_step(self._motion)
        self._longest = math.inf if self._steps is None else self._steps.longest * self._steps.unit
        self.system = system_of(problem, noise)
        if self._steps is not None and input_noise is None:
            input_noise = self._steps.noise(self.system.sigma)
        deviations = noise_of(self.system, input_noise or {})
        self._main = self.system.outputs[0].column
        # States come first, then the other inputs with noise.
        states = self.system.states(deviations)
        self.system = self.system.with_first(states)
        deviations = {name: deviations[name] for name in dict.fromkeys((*states, *deviations))}
        self.columns = (*deviations, *(n for n in self.system.inputs if n not in deviations))
        theta, covariance = start_of(self.system, prior)
        self._rules = rules_of(self.settings, self.system, theta, covariance, changes, deviations)
        formula = row_formula(self.system, self.columns, self._rules.noise)
        d, m, n = len(self.system.names), len(self.system.outputs), len(states)
        layout = Layout(self.settings.slots, d, m, len(self.columns), len(deviations), n)
        self._population = Population(layout, self._rules, formula)
        self._population.begin(theta, covariance, peak_of(self.system, self._rules, theta))
        self._names = [*self.columns, *(output.column for output in self.system.outputs)]
        self._bounds = self._rules.low, self._rules.high
        self._change: tuple[Change, float] | None = None
        self._informative = InformativeRows(self.settings.kept, len(self._names) + 1)
        self._state: TrackerState | None = None

    @property
    def state(self) -> TrackerState:
        """The state after the last row."""
        return reported_state(self.system, self._present)

    @property
    def _present(self) -> TrackerState:
        """The state in the parameters of the problem."""
        if self._state is None:
            self._state = self._snapshot(self._population.estimate(), None, 0.0)
        return self._state

    def update(self, rows: Rows) -> TrackerState:
        """Take one or several rows, and return the state after the last of them.

        Parameters
        ----------
        rows : Dataset or mapping of str
            Columns by name: numbers for one row, arrays for several. The inputs and outputs of
            the problem are needed, NaN or masked for a missing value; "time" [s] is optional.
            With a `Trajectory`, the time, states and inputs of consecutive rows are needed.

        Returns
        -------
        TrackerState
            Its alarm is the last one that these rows raised.

        Raises
        ------
        ValueError
            If a column is missing or not of numbers, or columns differ in length.
        """
        began = time.perf_counter()
        alarm, estimate, population = None, None, self._population
        if self._steps is not None:
            rows = self._steps.take(rows)
        for row in self._rows(rows):
            if not 0 <= float(row[-1]) - population["last_time"] <= self._longest:
                population.measured[:] = math.nan  # another motion begins
            estimate = population.update(row)
            if population["alarm"]:
                change = population.changed()
                alarm = self._alarm(change, float(row[-1]))
                self._change = change, alarm.time
                population["since"] = population["row"] - 1
                self._informative.clear()
            self._informative.note(row, population["gain"], population["clock"])
        if estimate is None:  # a motion starts
            self._state = replace(self._present, alarm=None)
        else:
            self._state = self._snapshot(estimate, alarm, time.perf_counter() - began)
        return self.state

    @property
    def change(self) -> Alarm | None:
        """The last alarm with the present estimates, which give its size better; None before it."""
        if self._change is None:
            return None
        change, at = self._change
        state = self._present
        return self._alarm(change._replace(after=state.theta, after_errors=state.deviations), at)

    def _alarm(self, change: Change, time: float) -> Alarm:
        change = reported_change(self.system, change)
        return alarm_of(change, time, self.system.reported.names, self._rules.watched)

    def dataset(self, output: str | None = None) -> Dataset:
        """Return the rows since the last alarm that inform the parameters most, for an offline fit.

        Parameters
        ----------
        output : str, optional
            Column of the output; by default the first one.

        Returns
        -------
        Dataset
            At most `kept` rows, in order of time, with inputs, the output and "time".

        Raises
        ------
        ValueError
            If there is no such output, or no informative row yet.
        """
        own = self._output(output)
        names = [*self._names, TIME]
        rows = self._informative.rows
        rows = rows[np.isfinite(rows[:, names.index(own.column)])]
        if not len(rows):
            raise ValueError(f"dataset: no row has informed {own.column!r} since the last alarm")
        units = {**self.system.inputs, own.column: own.unit, TIME: "s"}
        chosen = [*own.model.inputs, own.column, TIME]
        columns = {name: rows[:, names.index(name)] for name in chosen}
        units = {name: units[name] for name in columns}
        return Dataset(f"tracked_{own.column}", columns, units, own.column)

    def parameters(self, output: str | None = None, level: float = 0.95) -> Identified:
        """Return the model of an output with its present parameters, as in `parameters.json`.

        Parameters
        ----------
        output : str, optional
            Column of the output; by default the first one.
        level : float, optional
            Confidence level of the intervals.

        Returns
        -------
        Identified
            Tied parameters follow from the present free ones.
            `miho.models.identified.parameters_text` writes it.

        Raises
        ------
        ValueError
            If there is no such output, or `level` is not between 0 and 1.
        """
        own = self._output(output)
        return present_parameters(self.system, own, self._present, level, self._motion)

    def _output(self, column: str | None) -> Output:
        outputs = {output.column: output for output in self.system.outputs}
        if column is not None and column not in outputs:
            raise ValueError(f"output is {column!r}; expected one of {', '.join(outputs)}")
        return outputs[self._main if column is None else column]

    def _rows(self, rows: Rows) -> Array:
        """Rows (n, p + m + 1) of inputs, outputs and time."""
        last = self._population["last_time"]
        first = 0.0 if math.isnan(last) else last + self.period
        return rows_of(rows, self._names, first, self.period)

    def _snapshot(self, estimate: Array, alarm: Alarm | None, seconds: float) -> TrackerState:
        population = self._population
        theta, covariance, mixture = population.layout.estimate(estimate)
        return TrackerState(
            time=population["last_time"],
            names=self.system.names,
            theta=theta,
            covariance=covariance,
            identifiable=population["clock"] - population.informed <= RECENT,
            alarm=alarm,
            odds=population["odds"],
            rows=int(population["row"]),
            seconds=seconds,
            mixture=mixture,
            bounds=self._bounds,
        )


FADING = 60.0
"""Time in which the information of a row counts less by a factor e [s]."""


class InformativeRows:
    """At most `most` rows (n, width) with the largest information, of which old ones count less."""

    def __init__(self, most: int, width: int) -> None:
        self._rows = np.zeros((most, width))
        self._keys = np.full(most, -math.inf)
        self._place, self._least = 0, -math.inf

    def note(self, row: Array, information: float, clock: float) -> None:
        """Keep a row in the place of the one with the least information, if it has more."""
        if information <= 0:
            return
        key = math.log(information) + clock / FADING
        if key > self._least:
            self._rows[self._place] = row
            self._keys[self._place] = key
            self._place = int(np.argmin(self._keys))
            self._least = float(self._keys[self._place])

    def clear(self) -> None:
        """Forget all rows, which describe the time before a change."""
        self._keys[:] = self._least = -math.inf

    @property
    def rows(self) -> Array:
        """The rows, in order of their last number, the time."""
        rows = self._rows[np.isfinite(self._keys)]
        return np.asarray(rows[np.argsort(rows[:, -1], kind="stable")])
