"""Brackets of Gauss-Newton descents, for problems whose residuals come from Python.

A bracket is divided at its evaluations: the steps request the next ones, the problem makes them,
and the steps take the results. Steps ignore overflow, as the machine does; the problem does not.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from miho.compiled.gauss_newton import (
    Work,
    after_evaluation,
    is_free,
    prepare,
    refold,
    solve_linear,
    take_factor,
    to_units,
)
from miho.compiled.gauss_newton_bracket import GNRules, next_phase, rules_of
from miho.compiled.gauss_newton_candidates import (
    ACTIVE,
    ENTER,
    RECORD,
    SLOPES,
    TRIED,
    UNUSABLE,
    GNCandidates,
)
from miho.compiled.triangular import square_sum
from miho.optim.meter import BudgetExhausted, UnusableValueError
from miho.optim.miho_gn_state import MIHOGNState
from miho.optim.oracle import Oracle
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.parallel.rows import Ahead

Need = tuple[int, Array]
"""A candidate and the configuration (d,) at which it needs an evaluation."""


class Round(NamedTuple):
    """Independent evaluations, about this number, which workers start `ahead`."""

    evaluations: int
    ahead: Ahead


def rounds(oracle: Oracle, state: MIHOGNState) -> Iterator[Round]:
    """Run a bracket to its end round by round, with evaluations by the problem.

    Yields a round when it has started; the request for the next one makes it. If this raises, new
    rounds continue from the state that is left.
    """
    while True:
        yield from _Phase.of(oracle, state).rounds()
        with np.errstate(all="ignore"):
            if not next_phase(
                state.with_derivatives, state.place, state.order, state.box, state.level_rows,
                state.minima, state.settings,
            ):  # fmt: skip
                return


@dataclass(frozen=True, eq=False)
class _Phase:
    """Steps of the candidates of a phase, whose record `c` includes derivatives."""

    oracle: Oracle
    state: MIHOGNState
    c: GNCandidates
    rules: GNRules
    w: Work
    fidelity: float

    @classmethod
    def of(cls, oracle: Oracle, state: MIHOGNState) -> _Phase:
        """The phase of a bracket."""
        d, m, level_rows = state.d, state.rows, state.level_rows
        rules = rules_of(state.place, level_rows, d, state.settings)
        fidelity = 1.0 if rules.last else m / int(level_rows[-1])
        return cls(
            oracle, state, state.with_derivatives, rules, Work.of(d, m, level_rows.size), fidelity
        )

    def rounds(self) -> Iterator[Round]:
        """Give each candidate its steps; a round has one evaluation of each that needs one."""
        # Candidates that enter a level form one batch, which is faster for models on arrays.
        if not (self.rules.last and self.rules.steps):
            entrants = self._entering()
            if entrants:
                thetas = np.array([theta for _, theta in entrants])
                ahead = self.oracle.workers.ahead(thetas, self.fidelity, "residuals")
                yield Round(len(entrants), ahead)
                self._enter([i for i, _ in entrants], thetas)
        while True:
            needs = self._needs()
            if not needs and self.state.turn == 0:
                return
            if needs:
                yield self._begun(needs)
            for self.state.turn, theta in needs:
                self._evaluate(self.state.turn, theta)
            self.state.turn = 0

    @np.errstate(all="ignore")
    def _entering(self) -> list[Need]:
        """First evaluations of candidates without projection."""
        c = self.c
        active = range(int(self.state.place[ACTIVE]))
        index = [i for i in active if c.stage[i] == ENTER and not c.projects[i]]
        return [(i, self._at(c.trial[i])) for i in index]

    @np.errstate(all="ignore")
    def _needs(self) -> list[Need]:
        """Next evaluation of each candidate that needs one, from the one in turn on."""
        c, state, needs = self.c, self.state, []
        for i in range(state.turn, int(state.place[ACTIVE])):
            if prepare(c, i, state.box, state.rows, state.minima, self.rules, self.w):
                trial = c.stage[i] in (ENTER, TRIED)
                needs.append((i, self._at(c.trial[i] if trial else c.x[i])))
        return needs

    def _at(self, x: Array) -> Array:
        """Configuration in units (d,) at unit coordinates (d,)."""
        theta = np.empty(x.size)
        to_units(x, self.state.box, theta)
        return theta

    def _begun(self, needs: Sequence[Need]) -> Round:
        """Start evaluations that candidates need on workers."""
        c, oracle = self.c, self.oracle
        looks: list[Array] = []
        slopes: list[Array] = []
        for i, theta in needs:
            if c.stage[i] == SLOPES:
                slopes.append(theta)
                looks += [theta] * (not c.derivatives.shape[2])
            else:
                looks.append(theta)
                if c.projects[i] and c.stage[i] != RECORD:
                    looks += [self._probe(theta, k) for k in self.state.box.linear]
        begun = oracle.workers.ahead(np.array(slopes), self.fidelity, "jacobian")
        begun += oracle.workers.ahead(np.array(looks), self.fidelity, "residuals")
        return Round(len(slopes) * oracle.traits.jacobian_cost + len(looks), begun)

    def _evaluate(self, i: int, theta: Array) -> None:
        """Make the next evaluation of candidate i, at theta (d,), and advance it."""
        oracle, c, stage = self.oracle, self.c, self.c.stage[i]
        project = bool(c.projects[i]) and stage != RECORD
        cost = self.state.box.linear.size + 1 if project else 1
        if stage == SLOPES:
            cost = oracle.traits.jacobian_cost + (not c.derivatives.shape[2])
        if not oracle.affords(
            cost * (1.0 if self.rules.last else oracle.traits.cost(self.fidelity))
        ):
            raise BudgetExhausted
        try:
            if stage == SLOPES:
                self._evaluate_slopes(i, theta)
            elif project:
                self._advance(i, self._evaluate_projected(i, theta))
            else:
                self._take([i], oracle.residuals(theta, self.fidelity)[None])
        except UnusableValueError:
            if stage == SLOPES:
                c.stage[i] = UNUSABLE
            else:
                self._advance(i, math.inf)
        c.spent[i] += self.state.rows * cost

    def _enter(self, index: list[int], thetas: Array) -> None:
        """Evaluate the candidates that enter a level at thetas (k, d)."""
        m = self.state.rows
        while index:
            r = self.oracle.residual_rows(thetas, self.fidelity)
            k = len(r)
            if r.shape[1] != m:  # all of them raised
                r = np.full((k, m), math.nan)
            self._take(index[:k], r)
            self.c.spent[index[:k]] += m
            index, thetas = index[k:], thetas[k:]

    @np.errstate(all="ignore")
    def _take(self, index: Sequence[int], r: Array) -> None:
        """Pass the residuals r (k, m) of the candidates `index` (k,) to the steps."""
        order, w, m = self.oracle.traits.order, self.w, r.shape[1]
        r = np.array(r, dtype=float, order="C")
        by_level = r if self.fidelity < 1.0 or order is None else np.take(r, order, axis=1)
        for i, residuals, ordered in zip(index, r, by_level, strict=True):
            w.residuals[:] = residuals
            w.sums[:] = [square_sum(ordered, min(rows, m)) for rows in self.state.level_rows]
            self._advance(i, square_sum(w.residuals, m) / m)

    @np.errstate(all="ignore")
    def _advance(self, i: int, loss: float) -> None:
        """Advance candidate i after an evaluation with this loss."""
        state = self.state
        best = self.oracle.best
        after_evaluation(self.c, i, loss, state.box, state.rows, self.rules, best, self.w)

    def _evaluate_slopes(self, i: int, theta: Array) -> None:
        """Evaluate the derivatives at candidate i, in the column order of `take_factor`.

        Without room for them the residuals are evaluated again, and nothing is stored.
        """
        c, box, d, m = self.c, self.state.box, theta.size, self.state.rows
        width = box.width * np.where(box.log, theta, 1.0)
        columns = self.oracle.jacobian(theta, self.fidelity).T * width[:, None]
        order = np.arange(d)
        if c.projects[i]:
            order = np.array([*(k for k in box.linear if is_free(c.x[i, k])), *box.nonlinear])
        stored = c.derivatives[i]
        if not stored.shape[1]:
            stored = np.empty((d + 1, m))
            stored[d] = self.oracle.residuals(theta, self.fidelity, goes_on=True)
        stored[: order.size] = columns[order]
        with np.errstate(all="ignore"):
            refold(stored, order.size, stored[-1], m, self.w)
            take_factor(c, i, box, self.w)

    def _evaluate_projected(self, i: int, theta: Array) -> float:
        """Loss at the best linear parameters for theta (d,), infinite if unusable.

        Leaves the residuals of that solution in the work array. Costs p + 1 evaluations.
        """
        box, w, m = self.state.box, self.w, self.state.rows
        r = w.residuals
        r[:] = self.oracle.residuals(theta, self.fidelity)
        if not np.isfinite(r).all():
            return math.inf
        p = box.linear.size
        columns = np.empty((p, m))
        for column, k in enumerate(box.linear):
            probe = self._probe(theta, k)
            scale = (box.high[k] - box.low[k]) / (probe[k] - theta[k])
            probe_residuals = self.oracle.residuals(probe, self.fidelity, goes_on=True)
            columns[column] = (probe_residuals - r) * scale
        with np.errstate(all="ignore"):
            w.theta[:] = theta
            refold(columns, p, r, m, w)
            loss = solve_linear(self.c, i, box, m, w)
        r += w.step[:p] @ columns
        return loss

    def _probe(self, theta: Array, k: int) -> Array:
        """Configuration that determines the effect of the linear parameter k.

        It is as far away as the bounds allow: a wide difference is more accurate.
        """
        box, probe = self.state.box, theta.copy()
        up = box.high[k] - theta[k] >= theta[k] - box.low[k]
        probe[k] = box.high[k] if up else box.low[k]
        return probe
