"""The tracker: parameters that change while rows arrive, with intervals and an alarm."""

from __future__ import annotations

import contextlib
import copy
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from miho.data.dataset import Dataset
from miho.identification.report import Report
from miho.models.identified import Identified
from miho.online.calibration import Calibration, calibration, fitted_to
from miho.online.informative import InformativeRows
from miho.online.method import OnlineMethod, Problems, Rows, Running, numbers_of
from miho.online.motion import StepRows, is_motion, one_step
from miho.online.outputs import TIME, Output, System, system_of
from miho.online.population import Population
from miho.online.present import present_parameters
from miho.online.prior import place_of, start_of
from miho.online.rules import Layout, Rules
from miho.online.slopes import row_formula
from miho.online.state import Alarm, Change, TrackerState, alarm_of
from miho.quantities import Array
from miho.validate import at_least, between_0_and_1, number_or_infinity, positive, whole

JUMP = 0.35
"""Share of its value by which a parameter may jump, unless `changes` says otherwise."""
RECENT = 2.0
"""Time for which a row counts as recent [s]."""
Prior = Report | Mapping[str, tuple[float, float]] | None


@dataclass(frozen=True)
class TrackerSettings(OnlineMethod):
    """Settings of a tracker.

    Drifts are standard deviations of a random walk over one second, in jumps of the parameter.

    Parameters
    ----------
    hazard : float, optional
        Probability of a fresh hypothesis of a jump.
    outliers : float, optional
        Share of rows that are outliers. The odds of a change rise by at most one over this share
        in a row with one output, so a smaller share gives a quicker alarm.
    width : float, optional
        Variance of outliers, in variances of the noise.
    threshold : float, optional
        Logarithm of the odds of a change that raise the alarm.
    near : float, optional
        Smallest change that the alarm counts, in jumps.
    drifts : tuple of float, optional
        Drifts of hypotheses of long, middle and short memory.
    use : float, optional
        A row teaches a watched parameter if its information is at least this share of the best
        row's.
    smooth : float, optional
        Memory of the mean and variance of inputs with noise [s].
    hold : float, optional
        Time after an alarm in which there is no other [s].
    repeats : int, optional
        An output that repeats this number of times to the last digit is frozen.
    gap : float, optional
        Longest time between two rows that counts as drift [s].
    every : int, optional
        Number of rows from one fresh hypothesis to the next.
    slots : int, optional
        Number of hypotheses.
    cap : float, optional
        Drift widens a parameter up to this variance, in squared jumps.
    kept : int, optional
        Number of informative rows to keep, see `Tracker.dataset`.
    step_error : float, optional
        Standard deviation of a model's error in one step of a state, in that of the measured state.
    burst : float, optional
        Further drift of the watched parameters in a fresh hypothesis, because a jump takes a while.
    settle : float, optional
        Time in which this further drift decays [s].

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    hazard: float = 8e-4
    outliers: float = 0.02
    width: float = 400.0
    threshold: float = 3.0
    near: float = 1 / 7
    drifts: tuple[float, float, float] = (0.002, 0.15, 0.43)
    use: float = 0.27
    smooth: float = 2.0
    hold: float = 1.5
    repeats: int = 2
    gap: float = 10.0
    every: int = 3
    slots: int = 16
    cap: float = 0.75
    kept: int = 500
    step_error: float = 0.05
    burst: float = 2.0
    settle: float = 0.1

    def __post_init__(self) -> None:
        for name in ("hazard", "outliers"):
            between_0_and_1(name, getattr(self, name))
        for name in ("width", "near", "use", "smooth", "gap", "cap", "settle"):
            positive(name, getattr(self, name))
        for name in ("hold", "step_error", "burst"):
            at_least(name, getattr(self, name), 0.0)
        number_or_infinity("threshold", self.threshold)
        whole("repeats", self.repeats, 1)
        whole("every", self.every, 1)
        whole("kept", self.kept, 1)
        whole("slots", self.slots, 4, 64)
        drifts = tuple(self.drifts)
        if len(drifts) != 3 or not all(0 <= drift < math.inf for drift in drifts):
            raise ValueError(f"drifts is {self.drifts!r}; expected three numbers of at least 0")
        object.__setattr__(self, "drifts", drifts)

    def start(
        self,
        problem: Problems,
        prior: Prior = None,
        changes: Mapping[str, float] | None = None,
        input_noise: Mapping[str, float] | None = None,
        period: float = 0.02,
    ) -> Tracker:
        """Return a tracker that has seen no row; see `Tracker`."""
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        return Tracker(problem, prior, changes, input_noise, period, **own)


class Tracker(Running):
    """Parameters of a model that change while rows arrive, with intervals and an alarm.

    A population of hypotheses, each of which is an estimate with its covariance and its time of
    birth, is improved by one Gauss-Newton step per row and weighted by its predictive likelihood.
    Fresh hypotheses are born from the best one with the variance of a jump, so a jump is found
    within a few rows. The alarm is the odds of the hypotheses born since the last alarm.

    Parameters
    ----------
    problem : CurveFit or sequence of CurveFit or Report
        The model of each output, its bounds, and the standard deviation of its errors; or the
        report of its fit, which is then the prior too. The rows of its data give the largest
        information of a row on each parameter. The problem of a `Trajectory` becomes one problem
        for each state (`miho.online.one_step`); `update` then takes measured states and inputs.
    prior : Report or mapping of str to (value, standard deviation), optional
        Knowledge from before; by default the middle of the bounds and a share of their width.
    changes : mapping of str to float, optional
        Parameters that may jump, and the share of their value by which they may; by default each
        free parameter by 0.35. The alarm watches them.
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
    ['a fell by 39 ± 2 % at 2.0 s']
    >>> bool(abs(states[-1].values["a"] - 1.2) < 0.05)
    True
    """

    def __init__(
        self,
        problem: Problems | Report,
        prior: Prior = None,
        changes: Mapping[str, float] | None = None,
        input_noise: Mapping[str, float] | None = None,
        period: float = 0.02,
        **settings: Any,
    ) -> None:
        if isinstance(problem, Report):
            prior = problem if prior is None else prior
            problem = problem.problem
        self.settings = _settings(settings)
        positive("period", period)
        for name, given in (("changes", changes), ("input_noise", input_noise)):
            if given is not None and not isinstance(given, Mapping):
                raise ValueError(f"{name} is {given!r}; expected a number for each name")
        self.period = float(period)
        noise = prior.at.noise if isinstance(prior, Report) else None
        self._motion = problem if is_motion(problem) else None
        self._steps: StepRows | None = None
        if self._motion is not None:
            self._steps, problem = StepRows.of_problem(self._motion), one_step(self._motion)
        self.system = system_of(problem, noise)
        if self._steps is not None and input_noise is None:
            input_noise = self._steps.noise(self.system.sigma)
        deviations = _noise_of(self.system, input_noise or {})
        self._main = self.system.outputs[0].column
        # States come first, then the other inputs with noise.
        states = self.system.states(deviations)
        self.system = self.system.with_first(states)
        deviations = {name: deviations[name] for name in dict.fromkeys((*states, *deviations))}
        self.columns = (*deviations, *(n for n in self.system.inputs if n not in deviations))
        theta, covariance = start_of(self.system, prior)
        self._rules = _rules(self.settings, self.system, theta, covariance, changes, deviations)
        self._scale = 1.0
        formula = row_formula(self.system, self.columns, self._rules.noise)
        d, m, n = len(self.system.names), len(self.system.outputs), len(states)
        layout = Layout(self.settings.slots, d, m, len(self.columns), len(deviations), n)
        self._population = Population(layout, self._rules, formula)
        self._population.begin(theta, covariance, _peak(self.system, self._rules, theta))
        self._names = [*self.columns, *(output.column for output in self.system.outputs)]
        self._bounds = self._rules.low, self._rules.high
        self._change: tuple[Change, float] | None = None
        self._informative = InformativeRows(self.settings.kept, len(self._names) + 1)
        self._state: TrackerState | None = None

    @property
    def state(self) -> TrackerState:
        """The state after the last row."""
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
            estimate = population.update(row)
            if population["alarm"]:
                change = population.changed()
                alarm = alarm_of(change, float(row[-1]), self.system.names, self._rules.watched)
                self._change = change, alarm.time
                population["since"] = population["row"] - 1
                self._informative.clear()
            self._informative.note(row, population["gain"], population["clock"])
        if estimate is None:  # a motion starts
            self._state = replace(self.state, alarm=None)
            return self._state
        self._state = self._snapshot(estimate, alarm, time.perf_counter() - began)
        return self._state

    @property
    def change(self) -> Alarm | None:
        """The last alarm with the estimates of now, which know its size better; None before it."""
        if self._change is None:
            return None
        change, at = self._change
        now = change._replace(after=self.state.theta, after_errors=self.state.deviations)
        return alarm_of(now, at, self.system.names, self._rules.watched)

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
        return present_parameters(self.system, own, self.state, level, self._motion)

    def calibrate(self, rows: Rows) -> Calibration:
        """Set the scale of intervals and the threshold of the alarm from a quiet record.

        Errors of neighbouring rows may depend on each other, for example if the model leaves out an
        effect that lasts: intervals for independent errors are then too narrow.
        The scale compares the estimates of the watched parameters with the best fit of the record,
        in which nothing may change. The threshold is at least the record's largest odds plus 1.

        Parameters
        ----------
        rows : Dataset or mapping of str
            A record that is long compared with the memory of the tracker: a minute or more.

        Returns
        -------
        Calibration
            Scale and threshold, which the tracker now uses. Its parameters do not change.

        Raises
        ------
        ValueError
            If the record does not inform a watched parameter.
        """
        trial = copy.copy(self)
        trial._population = copy.copy(self._population)
        trial._informative = copy.deepcopy(self._informative)
        trial._scale, trial._steps = 1.0, None
        if self._steps is not None:
            rows = self._steps.anew().take(rows)
        numbers, population = self._rows(rows), self._population
        columns = [*self._names, TIME]
        states = [trial.update(dict(zip(columns, row, strict=True))) for row in numbers.tolist()]
        theta, covariance = self.state.theta, self.state.covariance
        best = fitted_to(numbers, population.formula, self._rules, theta, covariance)
        found = calibration(states, best, self._rules.watched > 0, self.settings.threshold)
        self._scale = found.scale
        self._population = population.with_threshold(found.threshold)
        self._state = replace(self.state, scale=found.scale)
        return found

    def _output(self, column: str | None) -> Output:
        outputs = {output.column: output for output in self.system.outputs}
        if column is not None and column not in outputs:
            raise ValueError(f"output is {column!r}; expected one of {', '.join(outputs)}")
        return outputs[self._main if column is None else column]

    def _rows(self, rows: Rows) -> Array:
        """Rows (n, p + m + 1) of inputs, outputs and time."""
        columns: Mapping[str, Any] = rows.columns if isinstance(rows, Dataset) else rows
        last = self._population["last_time"]
        first = 0.0 if math.isnan(last) else last + self.period
        try:
            numbers = [columns[name] for name in self._names]
        except KeyError as error:
            raise ValueError(
                f"rows: no column {error.args[0]!r}; expected {', '.join(self._names)}, and NaN "
                "for a missing value"
            ) from None
        except (TypeError, IndexError):
            kind = type(rows).__name__
            raise ValueError(f"rows is a {kind}; expected a Dataset, or columns by name") from None
        single = [*numbers, columns.get(TIME, first)]
        if all(isinstance(number, float | int) for number in single):
            with contextlib.suppress(OverflowError):
                return np.array([single], dtype=float)
        values = [numbers_of(*pair) for pair in zip(self._names, numbers, strict=True)]
        count = values[0].size
        values.append(numbers_of(TIME, columns.get(TIME, first + self.period * np.arange(count))))
        for name, column in zip([*self._names, TIME], values, strict=True):
            if column.shape != (count,):
                raise ValueError(
                    f"rows: column {name!r} has the shape {column.shape}; expected ({count},)"
                )
        return np.column_stack(values)

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
            scale=self._scale,
            bounds=self._bounds,
        )


def _settings(settings: Mapping[str, Any]) -> TrackerSettings:
    known = [field.name for field in fields(TrackerSettings)]
    for name in settings:
        if name not in known:
            raise ValueError(f"Tracker: no setting {name!r}; expected one of {', '.join(known)}")
    return TrackerSettings(**settings)


def _noise_of(system: System, noise: Mapping[str, float]) -> dict[str, float]:
    """Standard deviations of inputs with noise."""
    for name, deviation in noise.items():
        if name not in system.inputs:
            raise ValueError(
                f"input_noise: no input {name!r}; expected one of {', '.join(system.inputs)}"
            )
        at_least(f"input_noise.{name}", deviation, 0.0)
    return {name: float(deviation) for name, deviation in noise.items() if deviation > 0}


def _rules(
    settings: TrackerSettings,
    system: System,
    theta: Array,
    covariance: Array,
    changes: Mapping[str, float] | None,
    noise: Mapping[str, float],
) -> Rules:
    if changes is None:
        changes = dict.fromkeys(system.names, JUMP)
    deviations = np.sqrt(np.diag(covariance))
    unit, watched = deviations.copy(), np.zeros(theta.size)
    for name, share in changes.items():
        k = place_of("changes", name, system.names)
        positive(f"changes.{name}", share)
        watched[k], unit[k] = 1.0, share * abs(theta[k]) or deviations[k]
    names = ("hazard", "outliers", "width", "threshold", "near", "use", "smooth", "hold", "gap",
             "every", "repeats", "cap", "step_error", "burst", "settle")  # fmt: skip
    return Rules(
        **{name: float(getattr(settings, name)) for name in names},
        **dict(zip(("long", "middle", "short"), settings.drifts, strict=True)),
        unit=unit,
        low=system.space.low,
        high=system.space.high,
        watched=watched,
        sigma=system.sigma,
        noise=np.array([*noise.values()], dtype=float),
    )


def _peak(system: System, rules: Rules, theta: Array) -> Array:
    """The largest information (d,) of a row of the offline data on each parameter."""
    peak = np.zeros(theta.size)
    for output in system.outputs:
        own = [system.names.index(name) for name in output.parameters]
        slopes = np.abs(output.model.jacobian(theta[own], *output.examples()))
        largest = np.where(np.isfinite(slopes), slopes, 0.0).max(axis=0) * rules.unit[own]
        peak[own] = np.hypot(peak[own], largest / output.sigma)
    return peak
