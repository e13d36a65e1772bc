"""DEHB: differential evolution on the rungs of Hyperband."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass

import numpy as np

from miho.methods.unit_box import UnitOracle
from miho.optim import Optimizer, Oracle
from miho.optim.space import LARGEST_BATCH
from miho.validate import at_least, one_of, positive, whole

try:
    import dehb
    import loguru
except ModuleNotFoundError as error:
    raise ImportError(
        f"dehb needs a library that is missing ({error.name}); pip install 'miho[rivals]'"
    ) from error

STRATEGIES = tuple(
    f"{base}_{crossover}"
    for base in ("rand1", "rand2", "rand2dir", "best1", "best2", "currenttobest1", "randtobest1")
    for crossover in ("bin", "exp")
)


@dataclass(frozen=True)
class DEHB(Optimizer):
    """DEHB (Awad, Mallik and Hutter, IJCAI 2021), by the authors' library, with one worker.

    Every rung of Hyperband, with rows of data as the resource as in `miho.methods.Hyperband`, has a
    population that evolves by differential evolution with parents from the rung below. Only the
    last rung uses all rows, and only its losses can become best. Populations start at the common
    initial configurations, the first of which is evaluated first, on all rows. The search is over
    the search coordinates scaled to the unit box, until the budget ends. The library counts rungs
    in floating point: (243, 3) and (1000, 10) have one fewer than Hyperband.

    Parameters
    ----------
    R : int
        Ratio of the largest resource to the smallest.
    eta : int
        Ratio of the resources of two consecutive rungs.
    mutation_factor : float
        Mutation factor.
    crossover_prob : float
        Crossover probability.
    strategy : str
        Strategy, one of `STRATEGIES`.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    R: int = 81
    eta: int = 3
    mutation_factor: float = 0.5
    crossover_prob: float = 0.5
    strategy: str = "rand1_bin"

    def __post_init__(self) -> None:
        whole("eta", self.eta, 2)
        whole("R", self.R, self.eta, LARGEST_BATCH)
        positive("mutation_factor", self.mutation_factor)
        at_least("crossover_prob", self.crossover_prob, 0)
        if self.crossover_prob > 1:
            raise ValueError(f"crossover_prob is {self.crossover_prob!r}; expected at most 1")
        one_of("strategy", self.strategy, STRATEGIES)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Ask and tell until the budget ends."""
        search = self._search(len(oracle.space), int(rng.integers(2**32)))
        largest = max(len(rung.population) for rung in search.de.values())
        losses = UnitOracle(oracle, 1)
        losses(losses.start)
        initial = losses.common(largest)
        for rung in search.de.values():
            rung.population = initial[: len(rung.population)].copy()
        while True:
            job = search.ask()
            loss = float(losses(job["config"][None], float(job["fidelity"]) / self.R)[0])
            search.tell(job, {"fitness": loss, "cost": 0.0})
            # The library keeps finished brackets and searches all of them.
            search.active_brackets = [b for b in search.active_brackets if not b.is_bracket_done()]

    def _search(self, d: int, seed: int) -> dehb.DEHB:
        """The library's optimizer, without the log file and the console output that it opens."""
        with tempfile.TemporaryDirectory() as folder:
            loguru.logger.disable("dehb")
            search = dehb.DEHB(
                f=None,
                dimensions=d,
                mutation_factor=self.mutation_factor,
                crossover_prob=self.crossover_prob,
                strategy=self.strategy,
                min_fidelity=1,
                max_fidelity=self.R,
                eta=self.eta,
                min_clip=None,
                max_clip=None,
                seed=seed,
                boundary_fix_type="random",
                n_workers=1,
                save_freq="end",
                output_path=folder,
            )
            loguru.logger.remove()
        return search
