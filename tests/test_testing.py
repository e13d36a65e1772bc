"""The conformance suite catches what it is there to catch."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from miho import AskTell, Optimizer, Oracle, Space
from miho.testing import CHECKS, ConformanceError, check_optimizer, run_check

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sound(AskTell[dict[str, Any]]):
    """Random search in small batches, with a fault to be switched on."""

    fault: str = ""

    def init(self, space: Space, rng: np.random.Generator) -> dict[str, Any]:
        batch = space.sample(7, rng) if self.fault == "own start" else space.initial(7)
        return {"space": space, "rng": rng, "batch": batch, "told": 0}

    def ask(self, state: dict[str, Any]) -> Array:
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


class Plain(Optimizer):
    """Not a dataclass."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        oracle(oracle.space.decode(oracle.space.initial(1)))


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
    ],
)
def test_a_fault_is_caught(fault: str, check: str) -> None:
    with pytest.raises(ConformanceError, match=check):
        run_check(check, Sound(fault), {})


def test_a_declared_failure_must_fail() -> None:
    run_check("stays_in_the_box", Sound("leaves the box"), {"stays_in_the_box": "by design"})
    with pytest.raises(ConformanceError, match="remove the declared failure"):
        run_check("stays_in_the_box", Sound(), {"stays_in_the_box": "by design"})


def test_hiding_the_budget_is_caught() -> None:
    with pytest.raises(ConformanceError, match="keeps_the_budget_exactly"):
        run_check("keeps_the_budget_exactly", Swallows(), {})


def test_a_plain_class_is_caught() -> None:
    with pytest.raises(ConformanceError, match="not a frozen dataclass"):
        check_optimizer(Plain())


def test_every_check_has_a_sentence() -> None:
    assert all(check.__doc__ for check in CHECKS.values())
