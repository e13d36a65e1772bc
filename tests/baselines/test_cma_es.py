import numpy as np
import pytest

from baselines.cma_es import CMAES
from miho import Budget, Parameter, Problem, Space, minimize
from miho.optim.seeds import stream
from miho.testing import DecayFit

SPACE = Space(tuple(Parameter(name, "", -5.0, 5.0) for name in "abc"))


def batches(method: CMAES, evaluations: int) -> list[int]:
    """Sizes of the batches on a loss that is the same everywhere, so that it restarts often."""
    state = method.init(SPACE, stream("restarts"))
    sizes: list[int] = []
    while sum(sizes) < evaluations:
        thetas = method.ask(state)
        sizes.append(len(thetas))
        method.tell(state, thetas, np.zeros(len(thetas)))
    return sizes


def test_it_reaches_the_optimum(optimum: float) -> None:
    """To rounding: it goes on until losses agree to 1e-12."""
    record = minimize(CMAES(), DecayFit(), Budget(evaluations=1500), seed=1)
    assert record.loss == pytest.approx(optimum, rel=1e-12)


def test_it_follows_a_valley_beside_missing_values(valley: Problem) -> None:
    record = minimize(CMAES(), valley, Budget(evaluations=2000), seed=1)
    assert record.loss < 1e-12
    assert record.theta == pytest.approx([1, 1], abs=1e-5)
    assert record.rejected["loss is nan"] > 0


def test_ipop_doubles_the_population_at_every_restart() -> None:
    """4 + floor(3 ln 3) = 7 at first (Hansen, arXiv:1604.00772, Eq. 48)."""
    sizes = list(dict.fromkeys(batches(CMAES(restarts="ipop"), 5_000)))
    assert len(sizes) > 4
    assert sizes == [1, 7, 14, 28, 56, 112, 224, 448][: len(sizes)]


def test_bipop_spends_alike_on_large_and_small_populations() -> None:
    """Small ones have from the default to half of the largest (Hansen, GECCO 2009)."""
    sizes = batches(CMAES(restarts="bipop"), 10_000)
    large = [n for n in sizes if n in {7 * 2**k for k in range(1, 12)}]
    small = [n for n in sizes[1:] if n not in set(large)]
    assert 0.3 < sum(large) / sum(sizes) < 0.8
    assert min(small) == 7
    assert 7 < max(small) <= max(large) / 2


def test_unusable_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="restarts is 'none'; expected one of ipop, bipop"):
        CMAES(restarts="none")
    with pytest.raises(ValueError, match="growth is 1"):
        CMAES(growth=1)
