"""R8: objectives that give no usable value, to every optimizer of conf/optimizer."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from omegaconf import OmegaConf

from experiments.app.instantiation import MissingLibraryError, instantiate
from miho.optim import (
    Budget,
    LeastSquaresProblem,
    Optimizer,
    Oracle,
    Outcome,
    RandomSearch,
    minimize,
)
from miho.optim.problem import mean_square
from miho.quantities import Array
from miho.testing import DecayFit
from tests.faults.conftest import Figures

Bad = NDArray[np.bool_]

CONF = Path(__file__).parents[2] / "conf" / "optimizer"
EVALUATIONS, FEW = 200, 40
SLOW = ("dehb", "ngopt", "optuna_cmaes", "optuna_tpe")
"""Methods that take milliseconds for each evaluation; they make few."""

SCREEN = 20
"""Of local methods, in place of 500 draws: within 200 evaluations they come to their solver."""

FIRST = 20


@dataclass(frozen=True)
class Fault:
    """Which rows are bad, given them and how many were asked before, and what is then given.

    `whole`: one bad row spoils the answer to its batch, as an exception or a wrong type does.
    """

    bad: Callable[[Array, int], Bad]
    given: Callable[[Array], Any]
    whole: bool = False


def _everywhere(thetas: Array, asked: int) -> Bad:
    return np.ones(len(thetas), bool)


def _nowhere(thetas: Array, asked: int) -> Bad:
    return np.zeros(len(thetas), bool)


def _half(thetas: Array, asked: int) -> Bad:
    return np.asarray(thetas[:, 0] < 0)


def _thirty_percent(thetas: Array, asked: int) -> Bad:
    """By the digits of the parameters, so that a row always has the same fate."""
    return np.asarray(np.modf(np.abs(thetas).sum(axis=1) * 1e6)[0] < 0.3)


def _first(thetas: Array, asked: int) -> Bad:
    return np.arange(asked, asked + len(thetas)) < FIRST


def _raise(values: Array) -> Any:
    raise ArithmeticError("no value here")


FAULTS: Mapping[str, Fault] = {
    "NaN": Fault(_everywhere, lambda values: values * np.nan),
    "+inf": Fault(_everywhere, lambda values: np.full_like(values, np.inf)),
    "-inf": Fault(_everywhere, lambda values: np.full_like(values, -np.inf)),
    "None": Fault(_half, lambda values: None, whole=True),
    "str": Fault(_half, lambda values: "low", whole=True),
    "complex": Fault(_half, lambda values: values + 1e-3j, whole=True),
    "array": Fault(_half, lambda values: np.stack([values, values], axis=-1), whole=True),
    "raise": Fault(_half, _raise, whole=True),
    "first generation": Fault(_first, lambda values: np.full_like(values, np.inf)),
    "30 % NaN": Fault(_thirty_percent, lambda values: values * np.nan),
    "NaN half-space": Fault(_half, lambda values: values * np.nan),
    "huge": Fault(_nowhere, lambda values: values),
    "denormal": Fault(_nowhere, lambda values: values),
}
SCALES = {"huge": 1e150, "denormal": 1e-160}
"""Of the residuals: losses are about 1e300, and 1e-320, which is below the smallest normal one."""


@dataclass
class Spoilt(LeastSquaresProblem):
    """The decay of the conformance suite with a fault; it keeps its own books.

    `spent` counts evaluations and `bad` the unusable answers. The oracle asks again, row by row,
    where an answer to a batch is unusable as a whole, so only the answers that say something of
    single rows are counted.
    """

    fault: Fault
    scale: float = 1.0
    spent: float = 0.0
    bad: int = 0
    name: str = "spoilt"
    asked: int = 0
    decay: DecayFit = field(default_factory=DecayFit)

    def __post_init__(self) -> None:
        self.space, self.linear = self.decay.space, self.decay.linear

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,), or what the fault makes of them."""
        values = mean_square(self.scale * self._errors(thetas))
        return self._answer(thetas, values, fidelity)

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Residuals (17,), or what the fault makes of them."""
        return self._answer(theta[None], self.scale * self._errors(theta[None])[0], 1.0)

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives (17, 2), or what the fault makes of them."""
        derivatives = self.scale * self.decay.jacobian(theta)
        self.spent += 2
        if not self.fault.bad(theta[None], self.asked)[0]:
            return derivatives
        self.bad += 1
        return cast(Array, self.fault.given(derivatives))

    def _errors(self, thetas: Array) -> Array:
        t, y = self.decay.t, self.decay.y
        return np.asarray(thetas[:, :1] * np.exp(-thetas[:, 1:] * t) - y)

    def _answer(self, thetas: Array, values: Array, fidelity: float) -> Array:
        bad = self.fault.bad(thetas, self.asked)
        spoilt = bool(bad.any())
        if spoilt and self.fault.whole and len(thetas) > 1:
            return cast(Array, self.fault.given(values))
        self.asked += len(thetas)
        self.spent += len(thetas) * fidelity
        self.bad += int(bad.sum())
        if not spoilt:
            return values
        if len(thetas) == 1:
            return cast(Array, self.fault.given(values))
        return np.where(bad, self.fault.given(values), values)


def complaint(optimizer: Optimizer, name: str, evaluations: int = EVALUATIONS) -> str:
    """What is wrong with a run of this method under this fault, "" if nothing is."""
    scale = SCALES.get(name, 1.0)
    problem = Spoilt(FAULTS[name], scale)
    try:
        with warnings.catch_warnings(action="ignore"):  # solvers square what is huge
            record = minimize(optimizer, problem, Budget(evaluations=evaluations), seed=3)
    except Exception as error:  # noqa: BLE001 -- any exception is what is looked for
        return f"raised {type(error).__name__}: {error}"
    if record.outcome is Outcome.FAILED:
        return f"failed: {(record.error or '').strip().splitlines()[-1]}"
    spent, bad = problem.spent, problem.bad
    counted, trace = sum(record.rejected.values()), record.trace
    if not math.isclose(record.evaluations, spent, rel_tol=1e-9) or record.evaluations > (
        evaluations * (1 + 1e-9)
    ):
        return f"counted {record.evaluations:g} evaluations of {spent:g}"
    if counted != bad or not all(record.rejected):
        return f"recorded {counted} of {bad} bad values: {dict(record.rejected)}"
    if record.outcome is Outcome.NO_FINITE_VALUE:
        return "claims a best value" if record.theta is not None or len(trace) else ""
    if not isinstance(record.loss, float) or not math.isfinite(record.loss):
        return f"ended as {record.outcome} with the best {record.loss!r}"
    falling = all(b < a for a, b in zip(trace.loss, trace.loss[1:], strict=False))
    later = all(b >= a for a, b in zip(trace.evaluations, trace.evaluations[1:], strict=False))
    if not falling or not later:
        return "its curve is not monotone"
    clean = Spoilt(Fault(_nowhere, lambda values: values), scale)
    true = clean.loss(np.asarray(record.theta)[None])[0] if record.theta is not None else math.nan
    return "" if record.loss == true else f"its best is {record.loss}, where the loss is {true}"


def optimizers() -> tuple[dict[str, Optimizer], list[str]]:
    """Every method of conf/optimizer by name, and the names of those not to be had here."""
    found: dict[str, Optimizer] = {}
    missing = []
    for path in sorted(CONF.glob("*.yaml")):
        node = cast(dict[str, Any], OmegaConf.to_container(OmegaConf.load(path)))
        if "screen" in node:
            node["screen"] = SCREEN
        try:
            found[path.stem] = instantiate(node, "optimizer", Optimizer)
        except MissingLibraryError:
            missing.append(path.stem)
    return found, missing


@pytest.mark.slow
@pytest.mark.fault(
    row="R8",
    fault=f"{len(FAULTS)} objectives that give NaN, infinities, wrong types, exceptions or "
    "extremes",
    promise="no method raises; best finite or none; exact count; monotone; bad values recorded",
)
def test_objectives(tmp_path: Path, measured: Figures) -> None:
    """The battery against every method, 200 evaluations a run, of slow ones 40."""
    methods, missing = optimizers()
    wrong = [
        f"{method}, {name}: {fault}"
        for method, optimizer in methods.items()
        for name in FAULTS
        if (fault := complaint(optimizer, name, FEW if method in SLOW else EVALUATIONS))
    ]
    without = f" without {', '.join(missing)}" * bool(missing)
    measured(
        f"{len(methods) * len(FAULTS)} runs of {len(methods)} methods{without}: {len(wrong)} wrong"
        + "".join(f"; {line}" for line in wrong[:3])
    )
    assert not wrong


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("method", ["random", "miho", "pso_100", "cma_es"])
def test_quick_methods_withstand(method: str, fault: str) -> None:
    assert complaint(optimizers()[0][method], fault) == ""


class Fragile(Optimizer):
    """Takes the first losses for numbers."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        while True:
            losses = oracle(oracle.space.decode(oracle.space.sample(10, rng)))
            if np.isinf(losses).any():
                raise ArithmeticError("inf")


class Generous(Optimizer):
    """Asks the problem behind the oracle's back."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        oracle._values._problem.loss(oracle.space.decode(oracle.space.sample(10, rng)))
        RandomSearch().run(oracle, rng)


def test_faults_of_methods_are_found() -> None:
    assert "failed: ArithmeticError: inf" in complaint(Fragile(), "NaN half-space")
    assert complaint(Generous(), "huge") == "counted 200 evaluations of 210"
