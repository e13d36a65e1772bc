"""The result of a fit: parameters with standard errors, predictions, figures and report."""

from __future__ import annotations

import contextlib
import math
import os
import sys
import time
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from miho.fitting.arguments import inputs_of, signed_model
from miho.identification.curve_fit import CurveFit
from miho.identification.refit import Refit
from miho.models.traced import Remade
from miho.optim import Descents, Minimum, in_optimum
from miho.parallel.worth import is_expensive
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from miho.identification.conclusion import Conclusion
    from miho.identification.report import Report
    from miho.identification.uncertainty import Linearised

SAME = 1e-9
"""Relative difference of two errors, in terms of the largest output, up to which the model is
unchanged: rounding on another machine differs by 1e-16 to 1e-15 in each operation."""


class Prediction(NamedTuple):
    """Predicted curve and the ends of its confidence interval, (N,) each.

    The interval covers the curve, not new measurements.
    """

    value: Array
    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class Fit(Remade):
    """Result of `miho.fit`: the optimum of a problem, its uncertainty and its evidence.

    Use it in this order: print it, read `parameters` and `caveats`, then `predict`, `plot` and
    `report`. Properties are computed at their first use. A fit can be pickled if its model can.
    Unpickling evaluates the model and reports on stderr if the error has changed.

    Parameters
    ----------
    problem : CurveFit
        Model, data and space.
    theta : ndarray of shape (f,)
        The free parameters at the optimum, in their units.
    run : ndarray of shape (f,)
        The end of the search, from which a descent leads to `theta`.
    descents : Descents, optional
        Summary of the descents of the search; None without a search.
    level : float, optional
        Level of confidence intervals.
    moving : int, optional
        Evaluations after which the descent to `theta` was still improving; 0 if it converged.
    found_by : str, optional
        The step after the search that found this optimum, for example a profile; empty if the
        search found it.
    minima : tuple of Minimum, optional
        Other optima within the noise, found by a report.

    Examples
    --------
    >>> import numpy as np
    >>> import miho
    >>> t = np.linspace(0, 2, 50)
    >>> y = 2 * np.exp(-1.5 * t) + 0.05 * np.random.default_rng(1).standard_normal(50)
    >>> fit = miho.fit(lambda t, a, b: a * np.exp(-b * t), t, y, {"a": (0, 5), "b": (0, 10)})
    >>> fit.parameters[["value", "standard_error"]].round(3)
       value  standard_error
    a  2.020           0.021
    b  1.524           0.024
    >>> fit.caveats
    []
    >>> fit.predict([0.0, 1.0]).value.round(3)
    array([2.02, 0.44])
    """

    problem: CurveFit
    theta: Array
    run: Array
    descents: Descents | None = None
    level: float = 0.95
    moving: int = 0
    found_by: str = ""
    minima: tuple[Minimum, ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        """Fields, and the error at the optimum."""
        return super().__getstate__() | {"error": self.error}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the fields; a changed error of the model is reported on stderr."""
        before = state.pop("error", None)
        vars(self).update(state)
        if before is None:  # stored by an older version
            return
        dataset = self.problem.dataset
        close = SAME * float(np.abs(dataset[dataset.output]).max())
        try:
            if np.isclose(self.error, before, rtol=SAME, atol=close, equal_nan=True):
                return
            now = f"its error at the optimum is {self.error:.9g}"
        except Exception as error:  # noqa: BLE001 -- whatever the model raises
            from miho.parallel.remote import Raised

            now = f"it raises {Raised.of(error).line}"
        sys.stderr.write(
            f"miho: {self.problem.name}: the model has changed since this fit was stored: {now}, "
            f"not {before:.9g}; fit again, or restore the model\n"
        )

    @cached_property
    def uncertainty(self) -> Linearised:
        """Uncertainty of `theta`, that is of shares of constrained parameters: see `covariance`.

        It allows for correlated errors of neighbouring rows. Raises ValueError if rows are too few.
        """
        from miho.identification.uncertainty import linearised

        return linearised(self.problem, self.theta, neighbours=True)

    @cached_property
    def _optima(self) -> tuple[Linearised, ...]:
        """Uncertainties at all optima within the noise, this optimum first."""
        from miho.identification.alternatives import optima_within_noise
        from miho.identification.uncertainty import linearised

        here = self.uncertainty
        minima = self.minima + (() if self.descents is None else self.descents.minima)
        if not minima:
            return (here,)
        best = Refit(self.theta, float(np.sum(self.problem.residuals(self.theta) ** 2)))
        within = optima_within_noise(self.problem, best, minima, self.level)
        others = [fit.theta for fit in within if fit is not best]
        return (here, *(linearised(self.problem, theta, neighbours=True) for theta in others))

    @cached_property
    def alternatives(self) -> pd.DataFrame:
        """Optima that the data cannot distinguish from this one, a row each, this one first.

        The table is empty if there is only one optimum. Chi-squared of each row exceeds the
        smallest by no more than an interval of `level` allows; if the noise is unknown, the
        residuals estimate its variance. Raises ValueError if rows are too few.

        Returns
        -------
        DataFrame
            Columns `optimum` (from 1, this fit), `excess` (of chi-squared over the first), the
            parameters and the derived quantities of the model. The intervals of `parameters` span
            all optima.
        """
        from miho.identification.alternatives import optima_table

        return optima_table(self.problem, self._optima)

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """Table of all parameters with their values, standard errors and confidence intervals.

        Returns
        -------
        DataFrame
            A row per parameter, with columns `value`, `standard_error`, `low`, `high`, `unit` and
            `status`. Intervals are linearised at `level`. If the data cannot distinguish several
            optima (`alternatives`), the intervals span all of them, and standard errors refer to
            this one. Standard errors are NaN if rows are too few: no more than parameters, or
            fewer with a known `sigma`.
        """
        import pandas as pd

        from miho.identification.alternatives import hull
        from miho.identification.stated import stated_intervals, stated_parameters

        try:
            optima = self._optima
        except ValueError:  # too few rows: values without errors
            frame = pd.DataFrame({"value": self.values})
            return frame.assign(standard_error=math.nan, low=math.nan, high=math.nan)
        tables, ends = [], []
        for at in optima:
            stated, slopes = stated_parameters(self.problem, at)
            tables.append(pd.DataFrame(stated).set_index("name").rename_axis(None))
            ends.append(stated_intervals(stated, slopes, at, self.level))
        frame = tables[0]
        frame["low"], frame["high"] = hull([table["value"].to_numpy() for table in tables], ends).T
        return frame[["value", "standard_error", "low", "high", "unit", "status"]]

    @property
    def covariance(self) -> pd.DataFrame:
        """Covariance of all parameters by name, with zeros for fixed ones.

        NaN marks parameters without a finite standard error. Raises ValueError if rows are too few.
        """
        import pandas as pd

        from miho.identification.stated import stated_parameters

        stated, slopes = stated_parameters(self.problem, self.uncertainty)
        covariance = slopes @ self.uncertainty.covariance @ slopes.T
        lost = ~np.isfinite([p.standard_error for p in stated])
        covariance[lost], covariance[:, lost] = math.nan, math.nan
        names = [p.name for p in stated]
        return pd.DataFrame(covariance, names, names)

    @property
    def values(self) -> dict[str, float]:
        """Values of all parameters by name, in their units."""
        from miho.identification.stated import whole_values

        return whole_values(self.problem, self.theta)

    @cached_property
    def error(self) -> float:
        """Root-mean-square error, in the unit of the output."""
        return float(np.sqrt(np.mean(self.problem.errors(self.theta) ** 2)))

    @property
    def optimum(self) -> str:
        """The evidence that this is the global optimum, or the reason for doubt, in sentences."""
        from miho.identification.stated import at_limits

        limits = (f"{limit}." for limit in at_limits(self.problem, self.theta))
        return " ".join([self._conclusion.statement, *limits])

    @cached_property
    def _conclusion(self) -> Conclusion:
        """Evidence for the optimum, or doubt about it, as in the report."""
        from miho.identification.conclusion import conclusion_on

        searches = () if self.descents is None else (self.descents,)
        started = time.perf_counter()
        self.problem.loss(self.theta[None])
        at = None
        # Whether a parameter has an effect elsewhere takes many evaluations.
        if not is_expensive(time.perf_counter() - started):
            with contextlib.suppress(ValueError):  # too few rows
                at = self.uncertainty
        return conclusion_on(
            self.problem, self.theta, self.run, searches, at=at, moving=self.moving,
            found_by=self.found_by,
        )  # fmt: skip

    @cached_property
    def caveats(self) -> list[str]:
        """Sentences on the limits of the results; `print` shows them below the table.

        They name parameters at a bound or not identifiable, optima that the data cannot
        distinguish, and an uncertain optimum. `notes` has all remarks, and takes longer.
        """
        from miho.fitting.printed_fit import caveats

        return caveats(self)

    def report(self, **settings: Any) -> Report:
        """Full report, with profile intervals; takes up to some seconds.

        If the report finds a better optimum, the fit moves to it, so that both agree.

        Parameters
        ----------
        **settings
            Settings of `miho.identification.make_report`.

        Returns
        -------
        Report
            The report; print it, or write it as a page.
        """
        from miho.identification.report_steps import make_report

        settings = {
            "descents": self.descents, "level": self.level, "optimum": self.theta,
            "moving": self.moving, "found_by": self.found_by, "minima": self.minima, **settings,
        }  # fmt: skip
        report = make_report(self.problem, self.run, **settings)
        self._adopt(report)
        return report

    def _adopt(self, report: Report) -> None:
        """Take over the optimum of a report, and its statement on the optimum.

        This is the optimum of the fit, a better one, or the same one to more digits. In the last
        case the other optima within the noise stay the same and are not searched again.
        """
        if not np.array_equal(report.at.theta, self.theta):
            from miho.identification.alternatives import minima_at

            before, after = self.problem.loss(np.stack([self.theta, report.at.theta]))
            known = in_optimum(after, before, self.problem.resolution) and "_optima" in vars(self)
            others = self._optima[1:] if known else ()
            for name in ("uncertainty", "_optima", "alternatives", "parameters", "error", "notes"):
                vars(self).pop(name, None)
            minima = minima_at(self.problem, report.others)
            vars(self).update(theta=report.at.theta, found_by=report.found_by, minima=minima)
            if known:
                vars(self)["_optima"] = (self.uncertainty, *others)
        vars(self).pop("caveats", None)
        vars(self).update(moving=report.moving, _conclusion=report.conclusion)

    @cached_property
    def notes(self) -> list[str]:
        """All remarks of the report on search, data and model, a sentence each."""
        return self.report().notes

    def predict(self, x: Any, level: float | None = None) -> Prediction:
        """Predict the curve at given inputs, with its confidence interval.

        Parameters
        ----------
        x : array_like, tuple, mapping or DataFrame
            Input columns, (N,) each, as in `miho.fit`; for a tire in ISO-W signs.
        level : float, optional
            Confidence level between 0 and 1; the level of the fit, 0.95, by default.

        Returns
        -------
        Prediction
            `value`, `low` and `high`, (N,) each, in the unit of the output. The ends are NaN if
            standard errors are.

        Raises
        ------
        ValueError
            If most Fz of a tire are negative, or `level` is not between 0 and 1.
        """
        level = self.level if level is None else level
        if not 0 < level < 1:
            raise ValueError(f"level is {level!r}; expected a number between 0 and 1")
        inputs = inputs_of(self.problem.model, x)
        signed = signed_model(self.problem.model.whole)
        if signed is not None:
            signed.check_signs(inputs)
        columns = np.broadcast_arrays(*(np.atleast_1d(c).astype(float) for c in inputs.values()))
        if not self.problem.model.ordered:
            value, reach = self._band(*columns, level=level)
        else:
            from miho.models.time_step import finer

            more, rows = finer(self.problem.model.whole, self.problem.inputs, columns)
            value, reach = (values[rows] for values in self._band(*more, level=level))
        return Prediction(value, value - reach, value + reach)

    def to_tir(self, path: str | os.PathLike[str]) -> None:
        """Write a fitted tire as a property file; all other entries of its file are kept.

        Raises TypeError if the model is not a tire.
        """
        from miho.fitting.protocols import Writable

        model = self.problem.model.whole
        if not isinstance(model, Writable):
            raise TypeError("only a fit of a tire can be written as a property file")
        model.write(self.values, path)

    def posterior(self, **settings: Any) -> Any:
        """Sample the posterior distribution as an ArviZ object (needs the extra `posterior`).

        Parameters
        ----------
        **settings
            Settings of `miho.identification.sample_posterior`.
        """
        from miho.identification.posterior import sample_posterior

        return sample_posterior(self.problem, self.theta, **settings)

    def _band(self, *columns: Array, level: float | None = None) -> tuple[Array, Array]:
        """Curve at input columns (N,), and the half width of its interval."""
        try:
            at = self.uncertainty
        except ValueError:  # too few rows
            value = self.problem.model.predict(self.theta[None], *columns)[0]
            return value, np.full(value.shape, np.nan)
        return at.band(self.problem.model, level or self.level, *columns)

    def plot(self, ax: Axes | None = None) -> Figure:
        """Plot the data and the curve with its interval.

        With several inputs the figure shows measured over predicted values, unless the model is a
        simulation over time.

        Parameters
        ----------
        ax : Axes, optional
            Axes to draw into; by default a new figure has them.

        Returns
        -------
        Figure
            The figure of the axes.
        """
        from miho.fitting.printed_fit import figure_of

        return figure_of(self, ax)

    def __str__(self) -> str:
        """The parameters, the error, the evidence for the optimum, and the caveats."""
        from miho.fitting.printed_fit import printed
        from miho.identification.line_wrapping import wrapped

        table, lines = printed(self)
        return "\n".join([table, *map(wrapped, lines)])

    def __repr__(self) -> str:
        """The printed form, for interpreters."""
        return str(self)

    def _repr_html_(self) -> str:
        """The form shown in a notebook."""
        from miho.fitting.printed_fit import printed
        from miho.identification.line_wrapping import with_digits

        table = with_digits(self.parameters, "standard_error").to_html(float_format="{:.5g}".format)
        return table + "".join(f"<p>{escape(line)}</p>" for line in printed(self)[1])
