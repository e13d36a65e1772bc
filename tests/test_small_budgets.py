"""The smallest budgets give the best configuration so far, and say that its optimum is in doubt."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import miho
from miho.fitting.named import METHODS
from miho.optim import AsynchronousMIHOGN, Budget, Optimizer
from miho.optim.meter import Meter
from tests.printed import flat

T = np.arange(65) / 10
TRUTH = 1.31, 0.43, 0.63, 0.6, 0.75, 0.9, 1.37, 4.8, 2.4, 4.6, 5.7


def osborne_2(
    t: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any, i: Any, j: Any, k: Any
) -> Any:
    """Osborne's second problem: a decay and three peaks."""
    peaks = [(b, f, i), (c, g, j), (d, h, k)]
    return a * np.exp(-t * e) + sum(p * np.exp(-q * (t - s) ** 2) for p, q, s in peaks)


def two_decays(t: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    return a * np.exp(-b * t) + c * np.exp(-d * t)


NOISE = np.random.default_rng(0).normal(0, 0.02, T.size)
PROBLEMS: dict[str, tuple[Callable[..., Any], Any, Any, dict[str, tuple[int, int]]]] = {
    "osborne_2": (
        osborne_2,
        T,
        osborne_2(T, *TRUTH) + NOISE,
        dict.fromkeys("abcdefghijk", (0, 10)),
    ),
    "two_decays": (
        two_decays,
        T,
        two_decays(T, 2, 1, 1, 0.2) + NOISE,
        dict.fromkeys("abcd", (0, 9)),
    ),
}


@pytest.mark.parametrize("evaluations", [1, 2, 5, 60])
@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("method", [*METHODS, AsynchronousMIHOGN()], ids=str)
def test_every_method_gives_a_result_within_the_smallest_budgets(
    method: Optimizer | str, problem: str, evaluations: int
) -> None:
    fit = miho.fit(*PROBLEMS[problem], method=method, budget=Budget(evaluations=evaluations))
    assert math.isfinite(fit.error)
    assert all(0 <= value <= 10 for value in fit.values.values())


@pytest.mark.parametrize("evaluations", [1, 2, 5])
def test_a_search_that_was_hardly_begun_says_so(evaluations: int) -> None:
    fit = miho.fit(*PROBLEMS["osborne_2"], budget=Budget(evaluations=evaluations))
    assert fit.optimum.startswith("In doubt: no independent search finished within the budget")
    assert "the optimum is in doubt: no independent search finished within the budget" in flat(fit)


def test_a_compiled_search_gives_the_best_on_few_rows_too() -> None:
    fit = miho.fit(*PROBLEMS["two_decays"], budget=Budget(evaluations=1), compiled=True)
    assert math.isfinite(fit.error)


def test_more_rows_count_before_a_lower_loss() -> None:
    meter, thetas = Meter(), np.array([[1.0], [2.0], [3.0]])
    meter.note(0.25, np.array([np.inf, 3.0, 4.0]), thetas)
    meter.note(0.5, np.array([9.0, 8.0]), thetas[:2])
    meter.note(0.25, np.array([1.0]), thetas[2:])
    assert meter.provisional is not None
    assert meter.provisional[:2] == (0.5, 8.0)
    assert meter.provisional.theta == 2.0


def test_a_run_says_which_configuration_is_only_provisional() -> None:
    problem = miho.fit(*PROBLEMS["osborne_2"], budget=Budget(evaluations=1)).problem
    run = miho.minimize(miho.MIHOGN(), problem, Budget(evaluations=2))
    assert run.theta is None
    assert run.provisional is not None
    longer = miho.minimize(miho.MIHOGN(), problem, Budget(evaluations=500))
    assert longer.theta is not None
    assert longer.provisional is None


def test_a_model_without_a_finite_value_is_refused_with_the_reason() -> None:
    def nowhere(t: Any, a: Any) -> Any:
        return a * np.log(-1.0 - t)

    with np.errstate(all="ignore"), pytest.raises(ValueError, match="finite"):
        miho.fit(nowhere, T, T, {"a": (0, 1)}, budget=Budget(evaluations=60))
