"""Spaces: what they draw, where they start, what they refuse."""

import numpy as np
import pytest
from scipy import stats

from miho import Parameter, Space
from miho.optim.seeds import stream

SPACE = Space(
    (
        Parameter("a", "V", -1.0, 3.0, mean=0.0, std=2.0, sigma_max=0.5),
        Parameter("b", "1/s", 0.01, 100.0, scale="log"),
    )
)


@pytest.mark.parametrize("sampling", ["normal", "uniform", "uniform_plus_noise"])
def test_a_shorter_draw_is_the_head_of_a_longer_one(sampling: str) -> None:
    assert np.array_equal(SPACE.initial(5, sampling), SPACE.initial(500, sampling)[:5])


def test_start_depends_on_the_seed_alone() -> None:
    assert np.array_equal(SPACE.seeded("p", 1).initial(3), SPACE.seeded("p", 1).initial(3))
    assert not np.array_equal(SPACE.seeded("p", 1).initial(3), SPACE.seeded("p", 2).initial(3))
    assert not np.array_equal(SPACE.seeded("p", 1).initial(3), SPACE.seeded("q", 1).initial(3))


def test_normal_is_scipys_truncated_normal() -> None:
    draws = SPACE.sample(20_000, stream("test"))
    a = stats.truncnorm(-0.5, 1.5, loc=0.0, scale=2.0)
    assert stats.kstest(draws[:, 0], a.cdf).pvalue > 0.01
    low, high = np.log([0.01, 100.0])
    b = stats.truncnorm(-2, 2, loc=0.0, scale=(high - low) / 4)
    assert stats.kstest(draws[:, 1], b.cdf).pvalue > 0.01
    assert SPACE.contains(SPACE.decode(draws)).all()


def test_uniform_plus_noise_leaves_the_box_by_sigma_max() -> None:
    draws = SPACE.sample(20_000, stream("test"), "uniform_plus_noise")
    assert not SPACE.contains(SPACE.decode(draws)).all()
    variance = 4.0**2 / 12 + 0.5**2
    assert draws[:, 0].var() == pytest.approx(variance, rel=0.03)


def test_search_coordinates() -> None:
    thetas = np.array([[0.5, 0.1], [1.0, 10.0]])
    assert np.allclose(SPACE.encode(thetas)[:, 1], np.log([0.1, 10.0]))
    assert np.allclose(SPACE.decode(SPACE.encode(thetas)), thetas, rtol=1e-15)
    assert thetas[0, 1] == 0.1, "the caller's array is left alone"


def test_defaults_follow_from_the_range() -> None:
    space = Space((Parameter("a", "V", 0.0, 8.0),))
    sigma_max, sigma_min = space.sigma
    assert sigma_max == [0.8]
    assert sigma_min == [0.0]
    assert space.sample(50_000, stream("t")).mean() == pytest.approx(4.0, abs=0.05)


def test_a_fixed_value_may_leave_its_bounds_by_rounding() -> None:
    assert Parameter("k", "", 0.0, 0.3, fixed=0.1 + 0.2).fixed == 0.1 + 0.2
    assert Parameter("k", "", low=0.0, fixed=3.0).fixed == 3.0
    with pytest.raises(ValueError, match="fixed is -1e-09"):
        Parameter("k", "", low=0.0, fixed=-1e-9)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"low": 3.0, "high": 2.0}, "low < high"),
        ({"low": float("nan")}, "finite bounds"),
        ({"high": float("inf")}, "finite bounds"),
        ({"scale": "cubic"}, "one of linear, log"),
        ({"low": 0.0, "scale": "log"}, "above 0 on the log scale"),
        ({"mean": 7.0}, "within the range"),
        ({"std": 0.0}, "above 0"),
        ({"sigma_max": 0.1, "sigma_min": 0.2}, "sigma_min <= sigma_max"),
        ({"sigma_min": -0.1}, "0 <= sigma_min"),
        ({"fixed": 4.0}, r"fixed is 4.0, but low is -1.0 and high is 3.0; correct one of them"),
        ({"unit": 0}, "unit is 0; expected a text such as 'V' or '-'"),
    ],
)
def test_bad_parameters(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        Parameter(**{"name": "a", "unit": "V", "low": -1.0, "high": 3.0} | settings)
    assert "'a'" in str(error.value)


def test_bad_spaces() -> None:
    with pytest.raises(ValueError, match="at least one parameter"):
        Space(())
    with pytest.raises(ValueError, match=r"at least one parameter.* got \[\('a', 0, 1\)\]"):
        Space([("a", 0, 1)])  # type: ignore[arg-type, list-item]
    with pytest.raises(ValueError, match="must differ"):
        Space((Parameter("a", "V", 0, 1), Parameter("a", "V", 0, 1)))
