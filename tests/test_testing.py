"""The conformance suite catches what it is there to catch."""

import re
import signal
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from miho import AskTell, Budget, Optimizer, Oracle, Space, minimize
from miho.models import Model
from miho.testing import (
    CHECKS,
    ConformanceError,
    DecayFit,
    check_model,
    check_optimizer,
    run_check,
)
from miho.vehicle.models import Pacejka

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sound(AskTell[dict[str, Any]]):
    """Random search in small batches, with a fault to be switched on."""

    fault: str = ""

    def init(self, space: Space, rng: np.random.Generator) -> dict[str, Any]:
        batch = space.sample(7, rng) if self.fault == "own start" else space.initial(7)
        return {"space": space, "rng": rng, "batch": batch, "told": 0}

    def ask(self, state: dict[str, Any]) -> Array:
        if self.fault == "asks for nothing":
            return np.empty((0, 2))
        if self.fault == "ask moves":
            state["batch"] = state["batch"] * 0.999
        if self.fault == "leaves the box":
            return state["space"].decode(state["batch"]) * 10
        return state["space"].decode(state["batch"])

    def tell(self, state: dict[str, Any], thetas: Array, losses: Array) -> None:
        rng = np.random if self.fault == "global randomness" else state["rng"]
        if self.fault == "edits its batch":
            thetas += 1
        if self.fault == "chokes on infinity" and not np.isfinite(losses).all():
            raise FloatingPointError("inf")
        low, high = state["space"].bounds
        state["batch"] = low + (high - low) * rng.random((7, len(low)))

    def done(self, state: dict[str, Any]) -> bool:
        return False


@dataclass(frozen=True)
class Swallows(Optimizer):
    """Hides the end of the budget and goes on for a while."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        theta = oracle.space.decode(oracle.space.initial(1))
        for _ in range(1000):
            try:
                oracle(theta)
            except Exception:  # noqa: BLE001
                oracle.meter.evaluations -= 1


@dataclass(frozen=True)
class Boasts(Optimizer):
    """Ends its descents where it has never been."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        losses = oracle(oracle.space.decode(oracle.space.initial(10)))
        oracle.starts.add(float(losses[0]), 0.9 * float(losses.min()))


@dataclass(frozen=True)
class Waits(Optimizer):
    """Waits for what never comes."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        threading.Event().wait()


@dataclass(frozen=True)
class Silent(Optimizer):
    """Searches without asking, sooner or later."""

    asks: int = 0

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        for _ in range(self.asks):
            oracle(oracle.space.decode(oracle.space.initial(1)))
        while True:
            rng.random()


@dataclass(frozen=True)
class Raises(Optimizer):
    """Has a mistake."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        oracle(oracle.space.decode(oracle.space.initial(1)))
        np.linalg.inv(np.zeros((2, 2)))  # the line of the mistake


class Plain(Optimizer):
    """Not a dataclass."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        oracle(oracle.space.decode(oracle.space.initial(1)))


@pytest.mark.slow
def test_a_sound_method_passes() -> None:
    check_optimizer(Sound())


@pytest.mark.parametrize(
    ("fault", "check"),
    [
        ("own start", "starts_at_the_common_start"),
        ("ask moves", "asks_without_side_effects"),
        ("leaves the box", "stays_in_the_box"),
        ("global randomness", "uses_no_global_randomness"),
        ("global randomness", "repeats_with_the_same_seed"),
        ("edits its batch", "asks_without_side_effects"),
        ("chokes on infinity", "survives_unusable_values"),
        ("asks for nothing", "keeps_the_budget_exactly"),
    ],
)
def test_a_fault_is_caught(fault: str, check: str) -> None:
    with pytest.raises(ConformanceError, match=check):
        run_check(check, Sound(fault), {}, 2000)


def test_a_declared_failure_must_fail() -> None:
    leaves = Sound("leaves the box")
    run_check("stays_in_the_box", leaves, {"stays_in_the_box": "by design"}, 2000)
    with pytest.raises(ConformanceError, match="remove the declared failure"):
        run_check("stays_in_the_box", Sound(), {"stays_in_the_box": "by design"}, 2000)


def test_hiding_the_budget_is_caught() -> None:
    with pytest.raises(ConformanceError, match="keeps_the_budget_exactly"):
        run_check("keeps_the_budget_exactly", Swallows(), {})


def test_an_end_that_was_not_seen_is_caught() -> None:
    with pytest.raises(ConformanceError, match="ends_descents_at_losses_it_has_seen: a descent"):
        run_check("ends_descents_at_losses_it_has_seen", Boasts(), {})


@pytest.mark.parametrize("asks", [0, 3])
@pytest.mark.parametrize("check", ["keeps_the_budget_exactly", "repeats_with_the_same_seed"])
def test_a_method_that_asks_for_nothing_is_ended(
    monkeypatch: pytest.MonkeyPatch, asks: int, check: str
) -> None:
    """Directly, and in a run whose failures are caught."""
    monkeypatch.setattr("miho.testing.decay_fit.PATIENCE", 0.05)
    with pytest.raises(ConformanceError, match=f"{check}: NoEvaluation: it (computed|waited) for"):
        run_check(check, Silent(asks), {})
    assert signal.getitimer(signal.ITIMER_VIRTUAL) == (0.0, 0.0)


def test_a_method_that_only_waits_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("miho.testing.decay_fit.PATIENCE", 0.2)
    with pytest.raises(ConformanceError, match="NoEvaluation: it waited for"):
        run_check("keeps_the_budget_exactly", Waits(), {})
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_where_a_method_raises_is_said() -> None:
    lines = Path(__file__).read_text(encoding="utf-8").splitlines()
    (line,) = (i for i, text in enumerate(lines, 1) if text.endswith("# the line of the mistake"))
    message = f"LinAlgError: Singular matrix (test_testing.py:{line})"
    with pytest.raises(ConformanceError, match=re.escape(f"keeps_the_budget_exactly: {message}")):
        check_optimizer(Raises())
    record = minimize(Raises(), DecayFit(), Budget(evaluations=10))
    assert record.error is not None
    assert record.error.splitlines()[-1] == f"numpy.linalg.{message}"


def test_why_a_run_failed_is_in_the_message() -> None:
    check = "says_when_nothing_is_finite"
    with pytest.raises(ConformanceError, match=f"{check}: the outcome is failed: .*Singular"):
        run_check(check, Raises(), {})


def test_a_method_outside_of_the_box_is_counted() -> None:
    record = minimize(Sound("leaves the box"), DecayFit(), Budget(evaluations=700))
    problem = DecayFit()
    minimize(Sound("leaves the box"), problem, Budget(evaluations=700))
    thetas = np.array(problem.thetas)
    assert record.outside == np.count_nonzero(~problem.space.contains(thetas)) > 100
    assert minimize(Sound(), DecayFit(), Budget(evaluations=700)).outside == 0


def test_a_plain_class_is_caught() -> None:
    with pytest.raises(ConformanceError, match="not a frozen dataclass"):
        check_optimizer(Plain())


class Decay(Model):
    """y = a exp(-b t), with a fault to be switched on."""

    inputs, parameters, output = {"t": "s"}, {"a": "V", "b": "1/s"}, "V"

    def __init__(self, fault: str = "") -> None:
        self.fault = fault

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        a, b = thetas.T[:, :, None]
        y = np.asarray(a * np.exp(-b * inputs[0]))
        return y - y.mean(axis=0) if self.fault == "batch" and len(y) > 2 else y

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        decay = np.exp(-theta[1] * inputs[0])
        sign = 1 if self.fault == "sign" else -1
        return np.stack([decay, sign * theta[0] * inputs[0] * decay], axis=1)


def test_models_are_checked() -> None:
    thetas, t = np.array([[2.0, 1.5], [1.0, 0.3], [0.5, 4.0]]), np.linspace(0, 2, 50)
    check_model(Decay(), thetas, t)
    check_model(Pacejka(), np.array([[12.0, 1.4, 3000.0, 0.01, 80.0]]), np.linspace(-0.2, 0.2, 41))
    with pytest.raises(ConformanceError, match="respect to b is not the derivative"):
        check_model(Decay("sign"), thetas, t)
    with pytest.raises(ConformanceError, match="depends on the batch"):
        check_model(Decay("batch"), thetas, t)


def test_linear_parameters_are_checked() -> None:
    thetas, t = np.array([[2.0, 1.5], [0.0, 0.3]]), np.linspace(0, 2, 50)

    class Declared(Decay):
        def __init__(self, *linear: str) -> None:
            super().__init__()
            self.linear = linear

    class Product(Declared):
        """y = a (t + b): linear in a and in b, but not in both."""

        def predict(self, thetas: Array, *inputs: Array) -> Array:
            a, b = thetas.T[:, :, None]
            return np.asarray(a * (inputs[0] + b))

        def jacobian(self, theta: Array, *inputs: Array) -> Array:
            return np.stack([inputs[0] + theta[1], np.full_like(inputs[0], theta[0])], axis=1)

    for right in (Declared("a"), Product("a"), Product("b")):
        check_model(right, thetas, t)
    with pytest.raises(ConformanceError, match="linear names b and b, but predict is not linear"):
        check_model(Declared("b"), thetas, t)
    with pytest.raises(ConformanceError, match="linear names a and b"):
        check_model(Product("a", "b"), thetas, t)
    with pytest.raises(ConformanceError, match="linear names 'c'; parameters are a, b"):
        check_model(Declared("c"), thetas, t)


def test_every_check_has_a_sentence() -> None:
    assert all(check.__doc__ for check in CHECKS.values())
