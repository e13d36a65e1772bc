import numpy as np
import optuna
import pytest

from baselines.optuna_samplers import OptunaCMAES, OptunaTPE
from miho import Budget, minimize
from miho.testing import DecayFit


def test_tpe_starts_at_the_common_configurations_and_then_beats_them(optimum: float) -> None:
    problem = DecayFit()
    record = minimize(OptunaTPE(n_startup_trials=10), problem, Budget(evaluations=120), seed=2)
    reference = DecayFit()
    space = reference.space.seeded(reference.name, 2)
    start = space.decode(space.initial(10))
    assert np.array_equal(problem.thetas[-120:-110], start)
    assert optimum < record.loss < 1.5 * optimum
    assert record.loss < 0.1 * reference.loss(start).min()


def test_tpe_writes_down_the_defaults_of_the_library() -> None:
    """A new default would change what the name stands for."""
    method, sampler = OptunaTPE(), optuna.samplers.TPESampler()
    assert method.n_startup_trials == sampler._n_startup_trials
    assert method.n_ei_candidates == sampler._n_ei_candidates
    assert method.constant_liar == sampler._constant_liar
    assert method.group == sampler._group
    assert method.multivariate == sampler._is_multivariate(optuna.create_study())


def test_cmaes_reaches_the_optimum_and_restarts_with_a_larger_population(
    optimum: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To rounding: the losses of a finished study agree to 1e-12 of their size."""
    populations = []
    sampler = optuna.samplers.CmaEsSampler

    def watched(**settings: object) -> optuna.samplers.CmaEsSampler:
        populations.append(settings["popsize"])
        return sampler(**settings)

    monkeypatch.setattr(optuna.samplers, "CmaEsSampler", watched)
    record = minimize(OptunaCMAES(), DecayFit(), Budget(evaluations=700), seed=1)
    assert record.loss == pytest.approx(optimum, rel=1e-12)
    assert populations == [6, 12]  # 4 + floor(3 ln 2), doubled


def test_unusable_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="group is True"):
        OptunaTPE(multivariate=False, group=True)
    with pytest.raises(ValueError, match="n_startup_trials is 0"):
        OptunaTPE(n_startup_trials=0)
    with pytest.raises(ValueError, match="inc_popsize is 1"):
        OptunaCMAES(inc_popsize=1)
