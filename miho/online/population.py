"""The population of hypotheses, and its update by one row in NumPy.

`miho/core/track.c` does the same on the machine of formulas.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miho.core import machine
from miho.online.hypothesis import LARGEST_NOISE, SMALLEST, Hypothesis
from miho.online.rules import PLACE, Layout, Rules
from miho.online.slopes import RowFormula, TapedFormula
from miho.online.state import Change
from miho.quantities import Array

EMPTY = -1e9
"""Logarithm of the weight of a slot without a hypothesis."""
LEAST_WEIGHT = -1e6
MOST_TRACKED = 64
"""Largest number of hypotheses, parameters, outputs or inputs in the machine, as in track.h."""
OVER = 0.01
"""Share of the drift of a fresh hypothesis, or of an inlier, that no longer counts."""
RISE = 1.02
"""Largest rise of a parameter's best information by one row: a wrong input must not set it."""


class Population:
    """Hypotheses, each with parameters, covariance, weight, drift, and values at birth.

    `formula` has the outputs of a row and their derivatives. The machine of formulas updates, if it
    can and `by_machine` holds.
    """

    def __init__(
        self, layout: Layout, rules: Rules, formula: RowFormula, by_machine: bool = True
    ) -> None:
        memory = np.zeros(layout.size)
        self.layout, self.rules, self.formula, self.memory = layout, rules, formula, memory
        views = layout.views(memory)
        self.numbers, self.theta, self.P, self.share = (
            views[name] for name in ("numbers", "theta", "P", "share")
        )
        self.weight, self.drift, self.calm, self.born, self.was = (
            views[name] for name in ("weight", "drift", "calm", "born", "was")
        )
        self.peak, self.informed, self.mean, self.variance, self.last, self.repeats = (
            views[name] for name in ("peak", "informed", "mean", "variance", "last", "repeats")
        )
        self.measured = views["measured"]
        d, self.unit = layout.d, np.append(rules.unit, rules.noise[: layout.n])
        self.parameters, self.variances = self.theta[:, :d], self.P[:, :d, :d]
        self.hypotheses = [
            Hypothesis(*each, self.unit, d, rules)
            for each in zip(self.theta, self.P, self.weight[:, None], strict=True)
        ]
        sizes = layout.K, d, layout.m, layout.p, layout.q, layout.n
        able = by_machine and max(sizes) <= MOST_TRACKED
        tape = formula.tape.in_machine if isinstance(formula, TapedFormula) and able else None
        self._machine = (
            None if tape is None else (machine().update_population, tape, sizes, rules.packed)
        )

    def begin(self, theta: Array, covariance: Array, peak: Array) -> None:
        """Set three hypotheses, of long, middle and short memory, at the prior."""
        rules = self.rules
        self.memory[:] = 0.0
        self.parameters[:] = self.was[:] = theta
        self.share[:], self.weight[:], self.born[:] = 1.0, EMPTY, -1.0
        self.variances[:3] = covariance / np.outer(rules.unit, rules.unit)
        self.drift[:3] = self.calm[:3] = rules.long, rules.middle, rules.short
        self.weight[:3] = 0.0, -1.5, -3.0
        self.peak[:], self.informed[:] = peak, -math.inf
        self.last[:] = self.measured[:] = math.nan
        self.variance[:] = math.inf
        self["since"], self["quiet_until"], self["last_time"] = -1.0, -math.inf, math.nan
        self["odds"] = LEAST_WEIGHT

    def __reduce__(self) -> tuple[Any, ...]:
        """Return all that changes; the form in the machine is created again."""
        return _population, (self.layout, self.rules, self.formula, self.memory.copy())

    def __getitem__(self, name: str) -> float:
        return float(self.numbers[PLACE[name]])

    def __setitem__(self, name: str, value: float) -> None:
        self.numbers[PLACE[name]] = value

    def update(self, row: Array) -> Array:
        """Take one row, and return the estimate, (layout.estimate_size,).

        A row has p inputs, the first q of which have noise, m outputs, and the time [s].
        """
        if self._machine is None:
            self._take(row)
            return self.estimate()
        track, tape, sizes, rules = self._machine
        estimate = np.empty(self.layout.estimate_size)
        track(tape, sizes, rules, row, self.memory, estimate)
        return estimate

    def estimate(self) -> Array:
        """Return the estimate, (layout.estimate_size,)."""
        estimate = np.empty(self.layout.estimate_size)
        self._estimate(estimate)
        return estimate

    def _take(self, numbers: Array) -> None:
        x, y = numbers[: -1 - self.layout.m], numbers[-1 - self.layout.m : -1]
        seconds = self._pass(float(numbers[-1]))
        usable = self._usable(x, y)
        self["gain"], self["alarm"] = 0.0, 0.0
        living = np.flatnonzero(self.weight > EMPTY)
        grown = self._drift(living, seconds)
        y = np.where(usable, y, math.nan)
        if usable.any():
            row, noise = self._smoothed(x, seconds)
            began = self._begin_states(x, row, noise)
        self.measured[:] = y[: self.layout.n]
        if usable.any():
            with np.errstate(over="ignore", invalid="ignore"):
                teaches, outliers = self._learn(living, grown, row, noise, y)
        best, first = self._judge(living)
        if usable.any() and self["row"] % self.rules.every == 0 and teaches[best]:
            self._bear_both(best, first)
        if usable.any():  # a state that an outlier began, at either end of the row, begins again
            self.measured[began & outliers] = math.nan
        self["row"] += 1

    def _pass(self, time: float) -> float:
        """Advance the clock; time that goes back does not count, and a gap counts up to a limit."""
        passed = time - self["last_time"]
        passed = min(max(passed, 0.0), self.rules.gap) if passed == passed else 0.0
        self["last_time"] = time
        self["clock"] += passed
        return passed

    def _usable(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Outputs (m,) that are finite and do not repeat, in a row whose inputs are so too."""
        q = self.layout.q
        values = np.concatenate([x[:q], y])
        self.repeats[:] = np.where(values == self.last, self.repeats + 1, 0.0)
        self.last[:] = values
        good = np.isfinite(values) & (self.repeats < self.rules.repeats)
        return np.asarray(good[q:] & bool(good[:q].all() and np.isfinite(x).all()))

    def _smoothed(self, x: Array, seconds: float) -> tuple[Array, Array]:
        """The inputs (p,) shrunk to their running mean by the share of noise in their variance.

        This regression calibration (Carroll et al., Measurement Error in Nonlinear Models, 2006,
        Ch. 4) keeps noise of an input from attenuating the slope. Returns the noise left (q,) too.
        """
        q, rules = self.layout.q, self.rules
        row = x.copy()
        b = max(min(seconds / rules.smooth, 1.0), 1 / (self["row"] + 1))
        away = x[:q] - self.mean
        unseen = np.isinf(self.variance) | (b >= 1)
        self.mean[:] = np.where(unseen, x[:q], self.mean + b * away)
        seen = (1 - b) * (np.where(unseen, 0.0, self.variance) + b * away**2)
        self.variance[:] = np.where(unseen, LARGEST_NOISE * rules.noise**2, seen)
        shrunk = np.minimum(rules.noise**2 / np.maximum(self.variance, SMALLEST), 1.0)
        row[:q] -= shrunk * (x[:q] - self.mean)  # exact with a mean far away
        return row, rules.noise * np.sqrt(1 - shrunk)

    def _drift(self, living: NDArray[np.intp], seconds: float) -> Array:
        """Widen hypotheses by their drift; returns the share (K, d) of the variance that is new.

        The burst of a fresh one widens watched parameters only.
        """
        grown, rules = np.zeros((self.layout.K, self.layout.d)), self.rules
        for s in living:
            P, calm, burst = self.variances[s], self.calm[s], self.drift[s] - self.calm[s]
            rate = np.where(rules.watched > 0, self.drift[s], calm)
            more = np.where(P.diagonal() < rules.cap, rate**2 * seconds, 0.0)
            P[np.diag_indices_from(P)] += more
            grown[s] = more / np.maximum(P.diagonal(), SMALLEST)
            burst *= math.exp(-seconds / rules.settle)
            self.drift[s] = calm + (burst if burst > OVER * rules.burst else 0.0)
        return grown

    def _begin_states(self, x: Array, row: Array, noise: Array) -> NDArray[np.bool_]:
        """Begin states (n,) that the last row did not measure; all, if one value differs."""
        began = np.asarray(x[: self.layout.n] != self.measured)
        began |= bool(np.isfinite(self.measured[began]).any())
        for c in np.flatnonzero(began).tolist():
            for hypothesis in self.hypotheses:
                hypothesis.set_state(c, row[c], (noise[c] / self.rules.noise[c]) ** 2)
        return began

    def _learn(
        self, living: NDArray[np.intp], grown: Array, row: Array, noise: Array, y: Array
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Weigh and improve each hypothesis.

        Returns those (K,) that a watched parameter learns, and the states (n,) whose measured value
        is an outlier to the best one.
        """
        rules, d, n = self.rules, self.layout.d, self.layout.n
        rows = np.tile(row, (self.layout.K, 1))
        rows[:, :n] = self.theta[:, d:]
        slopes = self.formula.at(self.parameters, rows)
        J = np.concatenate([slopes.parameters, slopes.inputs[:, :, :n]], axis=2) * self.unit
        noisy = (slopes.inputs * noise) ** 2
        information = np.sqrt(np.sum((J[:, :, :d] / rules.sigma[:, None, None]) ** 2, axis=0))
        best, weights = living[np.argmax(self.weight[living])], self.weight.copy()
        self._note(information[best])
        # A row that informs no watched parameter says nothing on its change.
        watched = rules.watched > 0
        informs = (information[best] >= rules.use * self.peak) & watched
        counts = bool(informs.any() or not watched.any())
        enough = information >= rules.use * self.peak
        free, grown = enough | ~watched, np.where(enough, grown, 0.0)
        outliers = np.zeros(n, dtype=bool)
        for s in living:
            if not (np.isfinite(slopes.values[:, s]).all() and np.isfinite(J[:, s]).all()):
                self.weight[s] += math.log(SMALLEST)
                for c in range(n):
                    self.hypotheses[s].set_state(c, self.measured[c], 1.0)
                continue
            taught, gain, inliers = self.hypotheses[s].correct(
                slopes.values[:, s], J[:, s], noisy[:, s], free[s], y
            )
            if not counts:
                self.weight[s] = weights[s]
            self.share[s] *= (1 - grown[s]) * (1 - taught)
            self.share[s] += taught
            if s == best:
                self["gain"], outliers = gain, inliers[:n] < OVER
        # Rows with wrong inputs may fit a change alone, so a row says only so much.
        most = self.weight[best] - weights[best] - math.log(rules.wrong)
        self.weight[living] = np.minimum(self.weight[living], weights[living] + most)
        return np.asarray((free & watched).any(axis=1)), outliers

    def _note(self, information: Array) -> None:
        """Note the information (d,) of a row, and the parameters that it informs."""
        if np.isfinite(information).all():
            raised = np.where(self.peak > 0, np.minimum(information, RISE * self.peak), information)
            self.peak[:] = np.maximum(self.peak, raised)
            informs = (information >= self.rules.use * self.peak) & (information > 0)
            self.informed[informs] = self["clock"]

    def _judge(self, living: NDArray[np.intp]) -> tuple[int, int]:
        """Weigh a change against none; returns the best hypothesis, and the best of no change."""
        rules, weight = self.rules, self.weight
        best = int(living[np.argmax(weight[living])])
        weight[living] = np.maximum(weight[living] - weight[best], LEAST_WEIGHT)
        late = self.born > self["since"]
        away = np.abs(self.parameters - self.was) > rules.near * rules.unit
        changed = late & (away & (rules.watched > 0)).any(axis=1)
        odds = np.exp(weight)
        new, old = odds[changed].sum() + SMALLEST, odds[~changed].sum() + SMALLEST
        self["odds"] = math.log(new / old)
        if self["clock"] < self["quiet_until"]:
            self["since"] = self["row"]
        elif self["odds"] > rules.threshold:
            self["alarm"] = 1.0
            self["quiet_until"] = self["clock"] + rules.hold
        early = np.flatnonzero(~late & (weight > EMPTY))
        return best, int(early[np.argmax(weight[early])]) if early.size else best

    def _bear_both(self, best: int, first: int) -> None:
        """Put a fresh hypothesis of a jump, and one of a drift unless one as likely lives.

        Long and middle memory alternate after jumps. A drift begins where the best one stands.
        """
        rules = self.rules
        drifting = (self.drift == rules.middle) & (self.weight >= math.log(rules.onset))
        due = self.calm[best] == rules.long and not drifting.any()
        self._bear(best, first, True, rules.middle if self["turn"] % 2 else rules.long)
        if due:
            self._bear(best, first, False, rules.middle)
        self["turn"] += 1

    def _bear(self, best: int, first: int, jumps: bool, memory: float) -> None:
        """Put a fresh hypothesis in the place of the least likely one.

        It is a copy of the best one with another memory, whose watched parameters jump or not.
        """
        rules = self.rules
        able = self["row"] - self.born > rules.every
        able[[best, first]] = False
        if not able.any():
            return
        slot = int(np.flatnonzero(able)[np.argmin(self.weight[able])])
        own = self.born[best] <= self["since"]
        self.was[slot] = self.parameters[best] if own else self.was[best]
        self.theta[slot], self.P[slot], self.share[slot] = self.theta[best], self.P[best], 1.0
        if jumps:
            self.variances[slot].flat[:: self.layout.d + 1] += rules.watched
            for c in range(self.layout.n):
                self.hypotheses[slot].set_state(c, self.measured[c], 1.0)
        self.calm[slot] = memory
        self.drift[slot] = memory + (rules.burst if jumps else 0.0)
        self.born[slot] = self["row"]
        self.weight[slot] = math.log(rules.hazard if jumps else rules.onset)

    def changed(self) -> Change:
        """The change that the hypotheses born since the last alarm describe."""
        theta, P = self.parameters, self.variances
        away = np.abs(theta - self.was) > self.rules.near * self.rules.unit
        late = (self.born > self["since"]) & (away & (self.rules.watched > 0)).any(axis=1)
        weights = np.where(late, np.exp(self.weight), 0.0)
        weights /= weights.sum()
        before, after = weights @ self.was, weights @ theta
        variance = weights @ ((theta - after) / self.rules.unit) ** 2
        variance += weights @ P.diagonal(axis1=1, axis2=2)
        early = np.flatnonzero(~late & (self.weight > EMPTY))
        first = early[np.argmax(self.weight[early])] if early.size else int(np.argmax(weights))
        errors = [self.rules.unit * np.sqrt(v) for v in (P[first].diagonal(), variance)]
        return Change(before, after, *errors)

    def _estimate(self, numbers: Array) -> None:
        """Write mean, covariance and distribution of the parameters.

        The drift of a long memory is a way to forget, not a belief: its variance counts by `share`,
        which lacks the drift except while rows teach a parameter nothing.
        """
        mean, covariance, mixture = self.layout.estimate(numbers)
        mixture.weights[:] = np.exp(self.weight) / np.exp(self.weight).sum()
        long = (self.drift <= self.rules.long)[:, None]
        roots = self.rules.unit * np.sqrt(np.where(long, self.share, 1.0))
        theta, P = self.parameters, self.variances
        mean[:] = mixture.weights @ theta
        away = theta - mean
        covariance[:] = np.einsum("s,sij,si,sj->ij", mixture.weights, P, roots, roots)
        covariance += (away.T * mixture.weights) @ away
        mean[:] = np.clip(mean, self.rules.low, self.rules.high)  # a mean of bounds is rounded
        mixture.means[:] = theta
        mixture.deviations[:] = roots * np.sqrt(np.maximum(P.diagonal(axis1=1, axis2=2), 0.0))


def _population(layout: Layout, rules: Rules, formula: RowFormula, memory: Array) -> Population:
    """A population with this memory."""
    population = Population(layout, rules, formula)
    population.memory[:] = memory
    return population
