"""Constraints against rejection sampling, closed forms along their edges, and free fits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.stats import t as student

import miho
from miho import Parameter, Space
from miho.identification.constraints import constrained, free_values
from miho.identification.refit import refit
from miho.identification.stated import whole_values
from miho.models.tied import Ties

EQUAL: dict[str, Any] = {"a": (0, 10), "b": (0, 10), "c": (0, 10)}
UNEQUAL: dict[str, Any] = {"a": (-3, 5), "b": (1, 10), "c": (2, 4)}
LOG = {"low": 1e-2, "high": 1e2, "scale": "log"}
PROFILE = 2e-3
"""Ends of a profile are found to 0.005 of a root of about 2, so to that share of a half width."""


def space_of(box: dict[str, Any]) -> Space:
    return Space(
        tuple(
            Parameter(n, "", **p) if isinstance(p, dict) else Parameter(n, "", *p)
            for n, p in box.items()
        )
    )


def ties_of(space: Space) -> Ties:
    """The parameters but for shares, as they follow from the free ones."""
    held = {p.name: p.tied or p.fixed for p in space.parameters if not p.free}
    names = tuple(p.name for p in space.parameters if p.stands_for is None)
    ties = {name: tie for name, tie in held.items() if tie}
    return Ties(names, dict.fromkeys(space.free.names, ""), ties, radial=space.radial)


CASES: list[tuple[dict[str, Any], list[str], Any]] = [
    (EQUAL, ["a < b"], lambda a, b, c: [b - a]),
    (EQUAL, ["c < a < b"], lambda a, b, c: [a - c, b - a]),
    (UNEQUAL, ["a < b", "a < c"], lambda a, b, c: [b - a, c - a]),
    (UNEQUAL, ["a + 1 < b", "b - c < 2"], lambda a, b, c: [b - a - 1, 2 - b + c]),
    (UNEQUAL, ["a + b + 2 * c > 15"], lambda a, b, c: [a + b + 2 * c - 15]),
    (UNEQUAL, ["-2 < a - b < 2", "a < 3 <= c"], lambda a, b, c: [2 - abs(a - b), 3 - a, c - 3]),
    ({"a": LOG, "b": LOG, "c": LOG}, ["a < b < c"], lambda a, b, c: [b - a, c - b]),
    (EQUAL | {"c": {"fixed": 4.0}}, ["a < c", "b > a"], lambda a, b, c: [c - a, b - a]),
]
"""A box, constraints, and what must not be below 0."""
ROUNDING = 1e-12
"""Of numbers up to 100, with a factor of 100."""


@pytest.mark.parametrize("case", range(len(CASES)))
def test_the_whole_set_is_searched_and_nothing_else(case: int) -> None:
    """Configurations that are drawn free keep the constraints, and of those that are drawn in the
    box all that keep them are reached."""
    box, texts, slack = CASES[case]
    plain, rng = space_of(box), np.random.default_rng(case)
    space = constrained(plain, texts)
    ties, free = ties_of(space), space.free
    drawn = ties.whole(free.decode(free.sample(2000, rng, "uniform")))
    assert np.min(slack(*drawn.T)) >= -ROUNDING
    assert (drawn >= plain.low - ROUNDING).all()
    assert (drawn <= plain.high + ROUNDING).all()
    reached = 0
    for theta in plain.free.decode(plain.free.sample(500, rng, "uniform")):
        point = {"c": 4.0, **dict(zip(plain.free.names, theta.tolist(), strict=True))}
        try:
            shares = free_values(free, ties, point)
        except ValueError:
            shares = np.full(len(free), np.inf)
        inside = bool(free.contains(shares[None])[0])
        assert inside == (min(slack(**point)) >= 0)
        if inside:
            reached += 1
            whole = dict(zip(ties.parameters, ties.whole(shares[None])[0], strict=True))
            assert whole == pytest.approx({name: point[name] for name in whole}, rel=1e-9, abs=1e-9)
    assert reached > 10


def test_shares_of_a_whole_are_a_simplex() -> None:
    space = constrained(space_of(dict.fromkeys("abc", (0, 1))), "a + b + c = 1")
    assert [p.tied for p in space.parameters] == [None, "(1 - a) * b_share", None, "1 - a - b"]
    free = space.free
    whole = ties_of(space).whole(free.decode(free.sample(500, np.random.default_rng(0), "uniform")))
    assert whole.sum(axis=1) == pytest.approx(1.0)
    assert (whole >= -1e-15).all()


def test_starts_are_spread_about_the_middle_of_a_chain() -> None:
    """The point farthest from all sides of 0 < x1 < ... < x4 < 1 has even steps of 1/5."""
    box = {f"x{k}": (0, 1) for k in range(4)}
    space = constrained(space_of(box), "x0 < x1 < x2 < x3")
    theta = np.array([p.mean for p in space.free.parameters], dtype=float)
    assert ties_of(space).whole(theta[None])[0] == pytest.approx([0.2, 0.4, 0.6, 0.8])


@pytest.mark.parametrize(
    ("box", "texts", "message"),
    [
        (EQUAL, ["a < b", "b < c", "c < a"], "no values satisfy a < b, b < c, c < a; remove one"),
        (EQUAL, ["a < b", "a < c", "b < a"], "no values satisfy a < b, b < a; remove one"),
        ({"a": (5, 10), "b": (0, 4)}, ["a < b"], "of a from 5 to 10, b from 0 to 4 satisfy a < b"),
        (EQUAL, ["a + b = 30", "c < 3"], "no values of a from 0 to 10, b .* satisfy a \\+ b = 30"),
        (EQUAL, ["a < bb"], "'bb' uses an unknown parameter bb; did you mean b"),
        (EQUAL, ["a * b < 3"], "'a \\* b' is not linear; tie a parameter to others"),
        (EQUAL, ["a"], "expected linear relations, .* 'b - a < 5'; got 'a'"),
        (EQUAL, ["a <"], "got 'a <'"),
        (EQUAL, [3], "got 3"),
        (EQUAL, 3, "got 3"),
        (EQUAL, ["1 < 2"], "has a part without free parameters"),
        (EQUAL, ["a < b.real"], "is not allowed"),
        (EQUAL, ["a / 0 < b"], "is not linear"),
        (EQUAL | {"c": {"tied": "2 * a"}}, ["c < b"], "has c, which is tied to '2 \\* a'"),
    ],
)
def test_what_leaves_nothing_or_says_nothing_is_refused(box, texts, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        constrained(space_of(box), texts)
    assert "\n" not in str(caught.value)


def dense(size: int, rng: np.random.Generator) -> tuple[dict[str, Any], list[str], Any, Any]:
    """A box of x0, x1, ..., and as many inequalities of all of them: texts and A @ x < b."""
    A = rng.normal(size=(size, size)).round(6)
    b = (A.sum(axis=1) / 2 + 0.3 * np.abs(A).sum(axis=1) * rng.random(size)).round(6)
    rows = [" + ".join(f"{a!r} * x{k}" for k, a in enumerate(row)) for row in A.tolist()]
    texts = [f"{row} < {end!r}" for row, end in zip(rows, b.tolist(), strict=True)]
    return {f"x{k}": (0, 1) for k in range(size)}, texts, A, b


def test_dense_inequalities_are_searched_along_rays() -> None:
    """Their elimination has no end: 20 of 20 parameters took longer than anybody waits."""
    rng = np.random.default_rng(0)
    box, texts, A, b = dense(20, rng)
    space = constrained(space_of(box), texts)
    ties, free = ties_of(space), space.free
    shares = free.sample(500, rng, "uniform")
    drawn = ties.whole(shares)
    assert (A @ drawn.T - b[:, None]).max() <= ROUNDING * 100  # rounding by the room of a side
    assert drawn.min() >= 0 <= 1 - drawn.max()
    for point, share in zip(drawn[:20], shares, strict=False):
        values = dict(zip(ties.names, point, strict=True))
        assert free_values(free, ties, values) == pytest.approx(share, abs=1e-9)
    step = 1e-7  # differences are good to 1e-7 but for rounding, 1e-16 / 1e-7
    for share, slopes in zip(shares[:5], ties.value_slopes(shares[:5]), strict=True):
        for k, move in enumerate(step * np.eye(20)):
            ahead, behind = ties.values(np.stack([share + move, share - move]))
            assert slopes[:, k] == pytest.approx((ahead - behind) / (2 * step), abs=1e-5)
    centre, corner = ties.values(np.zeros((1, 20)))[0], np.ones(20)
    assert (A @ centre < b).all()
    assert np.isfinite(ties.value_slopes(np.zeros((1, 20)))).all()
    with pytest.raises(ValueError, match=r"start: x0 = 1, .*x19 = 1 violate .* < "):
        free_values(free, ties, dict(zip(ties.names, corner, strict=True)))


def test_a_fit_that_dense_inequalities_leave_alone_is_that_without() -> None:
    """Its optimum is that of the linear least squares, which keeps them and the box."""
    rng = np.random.default_rng(3)
    box, texts, A, b = dense(6, rng)
    X = rng.random((40, 6))
    y = X @ np.full(6, 0.5) + 0.01 * rng.standard_normal(40)
    best = np.linalg.lstsq(X, y)[0]
    assert (A @ best < b).all()

    def plane(c0, c1, c2, c3, c4, c5, x0, x1, x2, x3, x4, x5):
        return c0 * x0 + c1 * x1 + c2 * x2 + c3 * x3 + c4 * x4 + c5 * x5

    fit = miho.fit(plane, tuple(X.T), y, box, constraints=texts, compiled=False)
    assert list(fit.values.values()) == pytest.approx(best, rel=1e-5)
    assert list(fit.parameters["status"]) == ["free"] * 6
    covariance = np.linalg.inv(X.T @ X) * np.sum((y - X @ best) ** 2) / 34
    errors = fit.parameters["standard_error"].to_numpy()
    assert errors == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-4)


def test_a_descent_ends_where_several_dense_inequalities_meet() -> None:
    """There the downhill direction is a sum of the normals of sides (Karush, Kuhn and Tucker)."""
    rng = np.random.default_rng(5)
    box, texts, A, b = dense(6, rng)
    X = rng.standard_normal((60, 6))
    y = X @ (0.5 + 2 * np.linalg.pinv(A) @ np.ones(6)) + 0.01 * rng.standard_normal(60)
    names = [f"c{k}" for k in range(6)]
    data = miho.Dataset(
        "d", dict(zip(names, X.T, strict=True)) | {"y": y}, dict.fromkeys([*names, "y"], ""), "y"
    )

    def plane(c0, c1, c2, c3, c4, c5, *, x0, x1, x2, x3, x4, x5):
        return c0 * x0 + c1 * x1 + c2 * x2 + c3 * x3 + c4 * x4 + c5 * x5

    problem = miho.CurveFit(plane, data, constrained(space_of(box), texts), compiled=False)
    end = refit(problem, np.full(6, 0.1))
    point = np.array([whole_values(problem, end.theta)[f"x{k}"] for k in range(6)])
    normals = np.vstack([A, np.eye(6), -np.eye(6)])
    rooms = np.concatenate([b, np.ones(6), np.zeros(6)]) - normals @ point
    assert rooms.min() >= -1e-9
    active = normals[rooms < 1e-6]
    assert len(active) >= 2
    downhill = X.T @ (y - X @ point)
    left = nnls(active.T, downhill)[1]
    assert left < 1e-4 * np.linalg.norm(downhill)  # the solver ends by gains of 1e-14, its square


t = np.linspace(0, 2, 80)


def two(t, a, b, c, d):
    return a * np.exp(-b * t) + c * np.exp(-d * t)


def test_an_order_that_holds_anyway_changes_no_result() -> None:
    """Without the order there are two optima, one the other with its terms swapped."""
    y = two(t, 1, 0.7, 2, 4) + 0.02 * np.random.default_rng(0).standard_normal(80)
    box = {"a": (0, 5), "b": (0, 20), "c": (0, 5), "d": (0, 20)}
    start = {"a": 1, "b": 1, "c": 1, "d": 5}
    plain = miho.fit(two, t, y, box, start=start, compiled=False)
    for keywords in ({}, {"start": start}):
        fit = miho.fit(two, t, y, box, constraints="b < d", compiled=False, **keywords)
        assert fit.values == pytest.approx(plain.values, rel=1e-5)
        table, expected = fit.parameters, plain.parameters
        assert list(table.index) == list("abcd")
        assert list(table["status"]) == ["free"] * 4
        for column in ("standard_error", "low", "high"):
            assert table[column].to_numpy() == pytest.approx(expected[column].to_numpy(), rel=1e-4)
    report, reference = fit.report(), plain.report()
    assert report.correlation.to_numpy() == pytest.approx(
        reference.correlation.to_numpy(), abs=1e-4
    )
    half = reference.at.quantile() * reference.at.standard_errors
    for end in ("profile low", "profile high"):
        off = report.parameters[end].to_numpy() - reference.parameters[end].to_numpy()
        assert (np.abs(off) < PROFILE * half).all()
    assert report.notes == reference.notes
    with pytest.raises(ValueError, match=r"start: d is 0\.5; expected 1 to 20"):
        miho.fit(two, t, y, box, constraints="b < d", start={**start, "d": 0.5})


@pytest.mark.parametrize("seed", [1, 2])
def test_profiles_follow_an_order_that_holds_parameters_back(seed: int) -> None:
    """y = a x + b z with a < b: with one of them given, the best other one is that of least
    squares, or the nearest that the order allows."""
    A = np.random.default_rng(3).random((50, 2))
    truth = [0.5, 0.5] if seed == 1 else [0.5, 0.52]
    y = A @ truth + 0.05 * np.random.default_rng(seed).standard_normal(50)
    fit = miho.fit(
        lambda x, z, a, b: a * x + b * z, tuple(A.T), y, {"a": (0, 1), "b": (0, 1)},
        constraints="a < b", compiled=False,
    )  # fmt: skip

    def cost(value: float, k: int) -> float:
        own, other = A[:, k], A[:, 1 - k]
        best = other @ (y - value * own) / (other @ other)
        best = max(best, value) if k == 0 else min(best, value)
        return float(np.sum((y - value * own - best * other) ** 2))

    grid = np.linspace(0.4, 0.6, 4001)
    report = fit.report()
    held = int(fit.uncertainty.at_bound.sum())
    assert held == (1 if seed == 1 else 0)
    assert ("b ends at a constraint" in fit.optimum) == bool(held)
    freedom = 48 + held
    for k, row in enumerate(report.parameters.to_dict("records")):
        costs = np.array([cost(value, k) for value in grid])
        assert costs.min() == pytest.approx(50 * fit.error**2, rel=1e-6)
        allowed = costs.min() * (1 + student.ppf(0.975, freedom) ** 2 / freedom)
        inside = grid[costs <= allowed]
        ends = [row["profile low"], row["profile high"]]
        assert ends == pytest.approx([inside[0], inside[-1]], abs=1.5e-4)


def test_joint_and_many_fits_take_constraints() -> None:
    line = np.linspace(0, 1, 30)
    y = np.stack([1 + 2 * line, 3 + 1 * line, 1 + 1 * line])
    table = miho.fit_many(
        lambda t, a, b: a + b * t, line, y, {"a": (0, 5), "b": (0, 5)}, constraints="a < b"
    )
    assert "b_share" not in table and "b_share_error" not in table
    assert table.loc[0, ["a", "b"]].tolist() == pytest.approx([1, 2], rel=1e-5)
    best = (1 + line) @ y[1] / ((1 + line) @ (1 + line))  # on the edge a = b
    assert table.loc[1, ["a", "b"]].tolist() == pytest.approx([best, best], rel=1e-4)
    noise = 0.01 * np.random.default_rng(0).standard_normal((2, 30))
    parts = {
        name: miho.Part(lambda t, a, b: a + b * t, line, y[k] + noise[k])
        for k, name in enumerate(("left", "right"))
    }
    box = {"a": (0, 5), "b": (0, 5)}
    fit = miho.fit_joint(parts, box, local=["a", "b"], constraints="a_left < a_right")
    free = miho.fit_joint(parts, box, local=["a", "b"])
    assert fit.values == pytest.approx(free.values, rel=1e-5)
    right = fit.part("right").parameters["standard_error"].to_numpy()
    assert right == pytest.approx(
        free.part("right").parameters["standard_error"].to_numpy(), rel=1e-3
    )


def test_an_order_changes_no_errors_of_a_fit_without_bounds() -> None:
    """The ranges are a million times the start, so that any value is near their ends."""
    t = np.linspace(0.0, 5.0, 40)
    y = np.exp(-t) + 2 * t + 0.05 * np.random.default_rng(0).standard_normal(40)
    results = [
        miho.fit(
            lambda t, a, b: a * np.exp(-t) + b * t, t, y, start={"a": 1, "b": 1.5},
            constraints=constraints,
        )
        for constraints in ((), "a < b", "a > 0")
    ]  # fmt: skip
    errors = [result.uncertainty.standard_errors[0] for result in results]
    np.testing.assert_allclose(errors[1:], errors[0], rtol=1e-4)
    for result in results:
        assert not result.uncertainty.at_bound.any()
        assert "ends at a constraint" not in str(result)


def test_a_limit_and_an_order_have_the_optimum_of_the_limit() -> None:
    """Where the order holds nothing back: along the limit, which is curved over its shares."""
    t = np.linspace(0.0, 5.0, 40)
    y = np.exp(-t) + 2 * t + 0.05 * np.random.default_rng(0).standard_normal(40)
    fits = [
        miho.fit(
            lambda t, a, b: a * np.exp(-t) + b * t, t, y,
            {"a": (0, 10), "b": (0, 10), "s": {"low": 0, "high": 2.9}},
            tied={"s": "a + b"}, constraints=constraints, compiled=False,
        )
        for constraints in ((), "a < b")
    ]  # fmt: skip
    exact = fits[0].values["a"]
    for a in np.linspace(0.88, 0.91, 7):  # from several places along the limit
        start = np.array([a, (2.9 - 1e-9 - 2 * a) / (10 - a)])
        end = refit(fits[1].problem, start)
        assert whole_values(fits[1].problem, end.theta)["a"] == pytest.approx(exact, rel=1e-5)


def test_dense_inequalities_need_no_bounds_beside_a_start() -> None:
    """With ranges of a million times the start descents ended short of it, by 2 in one value.

    Where the optimum is too far from the start, a sentence asks for bounds.
    """
    rng = np.random.default_rng(4)
    _, texts, A, b = dense(6, rng)
    X = rng.random((40, 6))
    corner = np.linalg.pinv(A) @ (0.1 * A @ np.full(6, 0.5) + 0.9 * (b - 0.02))
    assert (A @ corner < b).all()
    start = {f"x{k}": value for k, value in enumerate(corner)}
    columns = tuple(X.T)

    def plane(c0, c1, c2, c3, c4, c5, x0, x1, x2, x3, x4, x5):
        return c0 * x0 + c1 * x1 + c2 * x2 + c3 * x3 + c4 * x4 + c5 * x5

    y = X @ np.full(6, 0.5) + 0.01 * rng.standard_normal(40)
    best = np.linalg.lstsq(X, y)[0]
    assert (A @ best < b).all(), "or this tests nothing"
    settings: dict[str, Any] = {"constraints": texts, "start": start, "compiled": False}
    fit = miho.fit(plane, columns, y, **settings)
    assert list(fit.values.values()) == pytest.approx(best, rel=1e-5)
    far = X @ (0.5 - 100 * np.linalg.pinv(A) @ np.ones(6))
    with pytest.raises(ValueError, match=r"constraints: x\d ends at .* its start; give bounds"):
        miho.fit(plane, columns, far, **settings)


def test_a_model_that_fails_far_from_a_start_is_tried_out_near_it() -> None:
    """Shares of ranges of a million times the start were tried out all over: a row was blamed."""
    t = np.linspace(0.0, 5.0, 40)
    y = 0.5 * np.exp(0.6 * t) + 0.05 * np.random.default_rng(0).standard_normal(40)

    def growth(t, a, b):
        return a * np.exp(b * t)

    start = {"a": 0.4, "b": 0.7}
    for scale in ("linear", "log"):
        settings = {"start": start, "compiled": False}
        box = {name: {"scale": scale} for name in start}
        plain = miho.fit(growth, t, y, box, **settings)
        fit = miho.fit(growth, t, y, box, constraints="a < b", **settings)
        assert fit.values == pytest.approx(plain.values, rel=1e-5)
    settings["start"] = {"a": 0.7, "b": 0.4}
    with pytest.raises(ValueError, match=r"start: b is 0\.4; expected 0\.7 to"):
        miho.fit(growth, t, y, constraints="a < b", **settings)


def test_remarks_on_the_errors_hold_at_the_optimum_of_an_order() -> None:
    """The model depends on free shares: at reported values the errors are of another curve."""
    t = np.linspace(0, 5, 60)

    def two(t: Any, a: Any, k: Any, b: Any, m: Any) -> Any:
        return a * np.exp(-k * t) + b * np.exp(-m * t)

    y = two(t, 2, 3, 1, 0.3) + 0.02 * np.random.default_rng(0).standard_normal(60)
    bounds: dict[str, Any] = {"a": (0, 10), "k": (0, 20), "b": (0, 10), "m": (0, 20)}
    for prior in ({}, {"m": {"low": 0, "high": 20, "prior": (0.3, 0.05)}}):
        fit = miho.fit(two, t, y, bounds | prior, constraints="m < k")
        report = fit.report(profiles=False)
        assert not report.uneven
        assert not any("neighbouring rows" in note for note in report.notes)
