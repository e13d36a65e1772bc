"""Evaluations of a run by workers: begun before a method asks for their values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from miho.optim.meter import Meter
from miho.optim.problem import Problem, Traits, least_squares, part_of
from miho.optim.usable_values import read_only
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.parallel import Ahead, Evaluations
    from miho.parallel.usage import Usage

Kind = Literal["loss", "residuals", "jacobian"]


class Distribution:
    """The workers of a run, `Oracle.workers`; without any, the oracle makes all evaluations.

    Parameters
    ----------
    problem : Problem
        The problem.
    traits : Traits
        Its properties.
    evaluations : Evaluations or None
        Makes the evaluations.
    meter : Meter
        Counts of the run.
    limit : float
        Largest number of evaluations of the run.
    """

    def __init__(
        self,
        problem: Problem,
        traits: Traits,
        evaluations: Evaluations | None,
        meter: Meter,
        limit: float,
    ) -> None:
        self._problem, self._traits, self._evaluations = problem, traits, evaluations
        self._meter, self._limit = meter, limit

    @property
    def count(self) -> int:
        """Largest number of simultaneous evaluations a method should ask for.

        It is 1 until evaluations are known to be expensive enough for one worker each, then the
        number of workers, also in a resumed run.
        """
        meter, evaluations = self._meter, self._evaluations
        if evaluations is not None:
            if meter.at_a_time == 1 and evaluations.worth_one:
                meter.at_a_time = evaluations.workers
            evaluations.usage.at_a_time = meter.at_a_time
        return meter.at_a_time

    @property
    def spreads(self) -> bool:
        """Whether workers evaluate batches: true once evaluations are known to be expensive."""
        return self._evaluations is not None and self._evaluations.spreads

    @property
    def usage(self) -> Usage | None:
        """Use of the workers, None without any."""
        return None if self._evaluations is None else self._evaluations.usage

    @property
    def busy(self) -> int:
        """Number of busy workers."""
        return 0 if self._evaluations is None else self._evaluations.busy

    def ahead(self, thetas: Array, fidelity: float = 1.0, kind: Kind = "loss") -> Ahead:
        """Start to evaluate rows (n, d): losses, residuals or derivatives.

        This counts and records nothing; the later request for the values does. Only as many
        evaluations start as the budget allows.
        """
        cost = self._traits.cost(fidelity)
        if kind == "jacobian":
            cost *= self._traits.jacobian_cost
        affordable = (self._limit - self._meter.evaluations) / cost
        rows = read_only(thetas if affordable >= len(thetas) else thetas[: int(affordable)])
        part = part_of(fidelity)

        def ask() -> None:
            if kind == "loss" and len(rows):
                self._problem.loss(rows, *part)
            elif kind == "residuals" and len(rows):
                least_squares(self._problem).residual_rows(rows, *part)
            elif kind == "jacobian":
                for theta in rows:
                    least_squares(self._problem).jacobian(theta, *part)

        if self._evaluations is not None:
            return self._evaluations.ahead(ask)
        from miho.parallel import Ahead

        return Ahead([], ask)

    def first_ready(self, needs: Sequence[Ahead]) -> int:
        """Position of the first of these evaluations that is complete; waits for one of them.

        It is 0 without workers.
        """
        if len(needs) == 1 or self._evaluations is None:
            return 0
        return self._evaluations.first_ready(needs)
