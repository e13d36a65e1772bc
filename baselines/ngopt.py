"""NGOpt, Nevergrad's choice of a method by dimension and budget."""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from baselines.unit_oracle import UnitOracle
from miho.optim import Optimizer, Oracle
from miho.optim.validate import whole

try:
    import nevergrad
    from nevergrad.optimization import metamodel
except ModuleNotFoundError as error:
    raise ImportError(
        f"ngopt needs a library that is missing ({error.name}); pip install 'miho[rivals]'"
    ) from error


def _number(value: object) -> float:
    return float(np.asarray(value).item())


# Nevergrad 1.0.12 converts predictions of shape (1,) by float(), which NumPy 2.4 refuses.
vars(metamodel)["float"] = _number


@dataclass(frozen=True)
class NGOpt(Optimizer):
    """`nevergrad.optimizers.NGOpt` (Meunier et al., IEEE Trans. Evol. Comput. 26, 2022).

    It picks and combines methods by the dimension and by the evaluations it is told to plan for:
    those that the run has left, or `budget` where the run has no such limit, and then again until
    the run ends. It begins at the first common initial configuration (later plans at a fresh draw)
    and searches the search coordinates scaled to the unit box. Each of its own steps takes
    5 to 80 ms, more for larger plans: made for losses that take seconds, not microseconds.
    """

    budget: int = 10_000

    def __post_init__(self) -> None:
        whole("budget", self.budget, 1)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Plan and search until the budget ends."""
        losses = UnitOracle(oracle, 1)
        start = losses.start[0]
        with _quiet(), _global_generator(int(rng.integers(2**32))):
            while True:
                left = oracle.remaining
                plan = max(1, math.ceil(left)) if math.isfinite(left) else self.budget
                box = nevergrad.p.Array(
                    init=start, lower=np.zeros_like(start), upper=np.ones_like(start)
                )
                box.random_state = np.random.RandomState(rng.integers(2**32))
                method = nevergrad.optimizers.NGOpt(parametrization=box, budget=plan)
                method.suggest(start)
                for _ in range(plan):
                    candidate = method.ask()
                    method.tell(candidate, float(losses(candidate.value[None])[0]))
                start = losses.fresh(1, rng)[0]


@contextlib.contextmanager
def _global_generator(seed: int) -> Iterator[None]:
    """Seed NumPy's global generator, which some of the methods draw from, and put it back after."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Drop the warnings of the libraries, which also come from their threads, but no others."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module=r"(nevergrad|cma|scipy|sklearn|bayes_opt)(\.|$)")
        yield
