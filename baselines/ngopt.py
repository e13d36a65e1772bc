"""NGOpt of Nevergrad, which selects a method by dimension and budget."""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from miho.methods.unit_box import UnitOracle, global_generator
from miho.optim import Optimizer, Oracle
from miho.validate import whole

try:
    import nevergrad
    from nevergrad.optimization import metamodel
except ModuleNotFoundError as error:
    raise ImportError(
        f"ngopt needs a library that is missing ({error.name}); pip install 'miho[rivals]'"
    ) from error

LEVEL = 1e3
"""Scaled first loss: the CMA-ES among its methods restarts at 1e-14 of it."""


def _number(value: object) -> float:
    return float(np.asarray(value).item())


# Nevergrad 1.0.12 converts predictions of shape (1,) by float(), which NumPy 2.4 refuses.
vars(metamodel)["float"] = _number


@dataclass(frozen=True)
class NGOpt(Optimizer):
    """`nevergrad.optimizers.NGOpt` (Meunier et al., IEEE Trans. Evol. Comput. 26, 2022).

    It selects and combines methods by the dimension and the number of planned evaluations, and
    repeats until the run ends. If the time limit of the run cuts a plan short, the plan was wrong:
    another method would have been selected. The first plan starts at the first common initial
    configuration, later ones at new draws. The search is over the search coordinates scaled to the
    unit box. Each step of the library takes 5 to 80 ms, more for larger plans: it is designed for
    losses that take seconds, not microseconds.

    Parameters
    ----------
    plan : int, optional
        Evaluations to plan for, at most the remaining ones; by default all remaining evaluations.

    Raises
    ------
    ValueError
        If a setting is out of its range, or `plan` is None in a run without a limit of evaluations.
    """

    plan: int | None = None

    def __post_init__(self) -> None:
        whole("plan", self.plan, 1, none=True)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Plan and search until the budget ends."""
        losses = UnitOracle(oracle, 1, LEVEL)
        start = losses.start[0]
        with _quiet(), global_generator(rng):
            while True:
                plan = self._planned(oracle.remaining)
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

    def _planned(self, remaining: float) -> int:
        """The number of evaluations to plan for."""
        evaluations = remaining if self.plan is None else min(self.plan, remaining)
        if math.isinf(evaluations):
            raise ValueError(
                "plan is None, but the run has no limit of evaluations; "
                "expected a whole number; set plan, or budget.evaluations"
            )
        return max(1, math.ceil(evaluations))


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress warnings of the libraries, also from their threads, but no others."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module=r"(nevergrad|cma|scipy|sklearn|bayes_opt)(\.|$)")
        yield
