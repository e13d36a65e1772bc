"""R18: the table of brackets and rungs, and what a run of it costs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from miho.methods.hyperband import Hyperband
from miho.optim import (
    MIHO,
    Budget,
    Optimizer,
    Outcome,
    Parameter,
    Problem,
    Space,
    hyperband_table,
    minimize,
)
from miho.optim.schedule import Rung
from tests.faults.conftest import Figures

Sizes = list[tuple[int, int, int, int]]

ETAS, POWERS, RANDOM = range(2, 11), range(13), 1000
RUNS, LARGEST = 20, 40


class Line(Problem):
    """|x|; the share of the data changes nothing."""

    name = "line"
    space = Space((Parameter("x", "-", -1.0, 1.0, sigma_max=0.1),))

    def loss(self, thetas: NDArray[np.float64], fidelity: float = 1.0) -> NDArray[np.float64]:
        """Losses (n,) of rows (n, 1)."""
        return np.abs(thetas[:, 0])


@pytest.mark.slow
@pytest.mark.fault(
    row="R18",
    fault="schedules: eta 2 to 10 with R = eta^k, k 0 to 12, and 1,000 random (R, eta)",
    promise="all sizes equal an integer reference, nothing spends more than its budget",
    quick=True,
)
def test_schedule(tmp_path: Path, measured: Figures) -> None:
    tables, differing, overspent, wrong = schedules(RUNS)
    measured(
        f"{tables} tables: {differing} differ, {overspent} have a bracket above its "
        f"budget; {3 * RUNS} runs: {wrong} with another count than the table or the budget says"
    )
    assert differing == overspent == wrong == 0


def test_the_reference_gives_the_published_table() -> None:
    """Li et al. (2018), Table 1: R = 81, eta = 3."""
    brackets = {
        4: [(81, 1), (27, 3), (9, 9), (3, 27), (1, 81)],
        3: [(34, 3), (11, 9), (3, 27), (1, 81)],
        2: [(15, 9), (5, 27), (1, 81)],
        1: [(8, 27), (2, 81)],
        0: [(5, 81)],
    }
    for s, expected in brackets.items():
        found = [(n, r) for bracket, _, n, r in published(81, 3, "floor") if bracket == s]
        assert found == expected


def test_a_lost_bracket_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def one_short(R: int, eta: int, rounding: str = "ceil") -> tuple[Rung, ...]:
        rows = published(R, eta, rounding)
        return tuple(Rung(*size) for size in rows if size[0] or len(rows) == 1)

    monkeypatch.setattr("tests.faults.test_schedule.hyperband_table", one_short)
    _, differing, _, _ = schedules(1)
    assert differing > 0


def schedules(runs: int) -> tuple[int, int, int, int]:
    """All (eta, R = eta^k) and 1,000 random pairs, against integers; some pairs are run.

    How many tables, how many of them differ or have a bracket above its budget, and how many
    brackets of runs cost something else.
    """
    rng = np.random.default_rng(18)
    pairs = [(eta**k, eta) for eta in ETAS for k in POWERS]
    pairs += [
        (int(rng.integers(1, 10**digits)), int(rng.integers(2, 11)))
        for digits in rng.integers(1, 10, RANDOM).tolist()
    ]
    differing = overspent = 0
    for R, eta in pairs:
        for rounding in ("floor", "ceil"):
            table = hyperband_table(R, eta, rounding)
            found = [(rung.s, rung.j, rung.n, rung.mutations) for rung in table]
            differing += found != published(R, eta, rounding)
            overspent += any(spent > _brackets(found) * R for spent in _costs(found))
    drawn = [(int(rng.integers(1, LARGEST)), int(rng.integers(2, 6))) for _ in range(runs)]
    wrong = sum(_costs_wrongly(R, eta, rng) for R, eta in drawn)
    return 2 * len(pairs), differing, overspent, wrong


def published(R: int, eta: int, rounding: str) -> Sizes:
    """(s, i, n_i, r_i) of Li et al. (JMLR 18, 2018), Alg. 1, by repeated whole divisions.

    "floor" is the published s_max, the number of times that eta divides into R before nothing is
    left; "ceil" is one more where that leaves a remainder. Dividing by eta many times with
    remainders dropped is the floor of dividing by its power, so n_i = floor(n eta^-i) and
    r_i = floor(R eta^(i - s)) need no power of eta and no fraction.
    """
    s_max = len(_divided(R, eta)) - 1
    exact = all(left % eta == 0 for left in _divided(R, eta)[:-1]) and _divided(R, eta)[-1] == 1
    s_max += rounding == "ceil" and not exact
    rows: Sizes = []
    for s in reversed(range(s_max + 1)):
        n = s_max + 1
        for _ in range(s):
            n *= eta
        whole, rest = divmod(n, s + 1)
        configurations, resources = whole + (rest > 0), [R]
        for _ in range(s):
            resources.append(resources[-1] // eta)
        for i in range(s + 1):
            rows.append((s, i, configurations, resources[s - i]))
            configurations //= eta
    return rows


def _divided(R: int, eta: int) -> list[int]:
    """R, R / eta, ... with remainders dropped, down to the last that is not zero."""
    left = [R]
    while left[-1] >= eta:
        left.append(left[-1] // eta)
    return left


def _brackets(rows: Sizes) -> int:
    """B / R of line 1."""
    return rows[0][0] + 1


def _costs(rows: Sizes) -> list[int]:
    """What each bracket spends, in units of the resource."""
    return [sum(n * r for s, _, n, r in rows if s == bracket) for bracket in range(_brackets(rows))]


def _costs_wrongly(R: int, eta: int, rng: np.random.Generator) -> int:
    """Of a whole run of MIHO, one cut anywhere and one of Hyperband, how many miscount.

    MIHO pays one evaluation for each fresh configuration and then its mutations, and ends by
    itself; Hyperband pays r / R for each configuration, which floating-point sums hold to 1e-9, and
    has no best value if it is cut before it comes to all data.
    """
    rows = published(R, eta, "ceil")
    total = sum(n for _, i, n, _ in rows if i == 0) + sum(_costs(rows))
    limit = int(rng.integers(1, total + 1))
    whole = _spent(MIHO(R=R, eta=eta), total + 1) != (total, Outcome.CONVERGED)
    cut = _spent(MIHO(R=R, eta=eta), limit)[0] != limit
    spent, outcome = _spent(Hyperband(R=R, eta=eta), limit)
    ended = outcome in (Outcome.BUDGET, Outcome.NO_FINITE_VALUE)
    return whole + cut + (not ended or not limit - 1 < spent <= limit * (1 + 1e-9))


def _spent(optimizer: Optimizer, evaluations: int) -> tuple[float, Outcome]:
    record = minimize(optimizer, Line(), Budget(evaluations=evaluations))
    return record.evaluations, record.outcome
