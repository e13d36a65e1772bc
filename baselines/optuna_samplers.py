"""Two samplers of Optuna: tree-structured Parzen estimators, and CMA-ES."""

from __future__ import annotations

import math
import warnings
from collections import deque
from dataclasses import dataclass

import numpy as np
import optuna

from miho.methods.unit_box import UNUSABLE
from miho.optim import Optimizer, Oracle, Space
from miho.validate import positive, whole

optuna.logging.set_verbosity(optuna.logging.WARNING)


@dataclass(frozen=True)
class OptunaTPE(Optimizer):
    """`optuna.samplers.TPESampler` (Bergstra et al., NeurIPS 2011; Watanabe, arXiv:2304.11127).

    The run continues until the budget ends, in memory. A suggestion searches all earlier trials, so
    the time of n trials is proportional to n^2 (milliseconds each after some hundreds): the method
    is designed for losses that take seconds, not microseconds.

    Parameters
    ----------
    n_startup_trials : int
        Initial trials, which are the common initial configurations.
    n_ei_candidates : int
        Candidates of a later trial; the best by expected improvement is evaluated.
    multivariate, group, constant_liar : bool
        See `optuna.samplers.TPESampler`.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    n_startup_trials: int = 10
    n_ei_candidates: int = 24
    multivariate: bool = True
    group: bool = False
    constant_liar: bool = True

    def __post_init__(self) -> None:
        whole("n_startup_trials", self.n_startup_trials, 1)
        whole("n_ei_candidates", self.n_ei_candidates, 1)
        if self.group and not self.multivariate:
            raise ValueError("group is True; expected False unless multivariate is True")

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """One study until the budget ends."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            sampler = optuna.samplers.TPESampler(
                n_startup_trials=self.n_startup_trials,
                n_ei_candidates=self.n_ei_candidates,
                seed=int(rng.integers(2**31)),
                multivariate=self.multivariate,
                group=self.group,
                constant_liar=self.constant_liar,
            )
        study = _study(sampler, oracle.space, self.n_startup_trials)
        while True:
            _trial(study, oracle)


@dataclass(frozen=True)
class OptunaCMAES(Optimizer):
    """`optuna.samplers.CmaEsSampler`, restarted with larger populations.

    The first trial is the first common initial configuration. The first distribution is centred in
    the box with a sixth of its width (the sampler's defaults); restarts are centred anywhere in it.
    Optuna 5 no longer restarts itself: when the losses of the last 10 + ceil(30 d / population)
    generations agree to `tolerance` (the duration is Hansen's, arXiv:1604.00772, B.3), a new study
    begins, as with its former `restart_strategy="ipop"` (Auger and Hansen, CEC 2005). The run
    continues until the budget ends, in memory.

    Parameters
    ----------
    inc_popsize : int
        Growth of the population at a restart.
    tolerance : float
        A study ends when recent losses differ by less than this share of their size.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    loads = ("cmaes",)
    inc_popsize: int = 2
    tolerance: float = 1e-12

    def __post_init__(self) -> None:
        whole("inc_popsize", self.inc_popsize, 2)
        positive("tolerance", self.tolerance)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Run studies until the budget ends."""
        space = oracle.space
        d = len(space)
        popsize = 4 + math.floor(3 * math.log(d))
        study = _study(_cma(rng, popsize, None), space, 1)
        while True:
            recent: deque[float] = deque(maxlen=popsize * (10 + math.ceil(30 * d / popsize)))
            while len(recent) < (recent.maxlen or 0) or (
                max(recent) - min(recent) > self.tolerance * abs(max(recent))
            ):
                recent.append(_trial(study, oracle))
            popsize *= self.inc_popsize
            x0 = dict(zip(space.names, space.sample(1, rng, "uniform")[0].tolist(), strict=True))
            study = _study(_cma(rng, popsize, x0), space, 0)


def _cma(
    rng: np.random.Generator, popsize: int, x0: dict[str, float] | None
) -> optuna.samplers.CmaEsSampler:
    with warnings.catch_warnings():
        # x0 is deprecated in favour of a sampler outside of Optuna.
        warnings.simplefilter("ignore", FutureWarning)
        return optuna.samplers.CmaEsSampler(
            x0=x0,
            n_startup_trials=1,
            warn_independent_sampling=False,
            seed=int(rng.integers(2**31)),
            popsize=popsize,
        )


def _study(sampler: optuna.samplers.BaseSampler, space: Space, initial: int) -> optuna.Study:
    """A study in memory whose first trials are the common initial configurations."""
    study = optuna.create_study(study_name="in memory", sampler=sampler)
    for p in space.initial(initial).tolist():
        study.enqueue_trial(dict(zip(space.names, p, strict=True)))
    return study


def _trial(study: optuna.Study, oracle: Oracle) -> float:
    """The loss of the study's next trial, over the search coordinates."""
    space = oracle.space
    trial = study.ask(
        {
            name: optuna.distributions.FloatDistribution(low, high)
            for name, low, high in zip(space.names, *space.bounds, strict=True)
        }
    )
    p = np.array([trial.params[name] for name in space.names])
    loss = min(float(oracle(space.decode(p[None]))[0]), UNUSABLE)
    study.tell(trial, loss)
    return loss
