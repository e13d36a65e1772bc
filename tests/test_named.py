"""Methods and losses by name in scripts: those of the command line, and what is none."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

import miho
from miho.fitting.named import METHODS, loss_of, method_of
from miho.fitting.progress import pace_line
from miho.identification import CurveFit
from miho.identification.residuals import Square
from miho.identification.robust_loss import Cauchy, Huber
from miho.methods import DifferentialEvolution, LeastSquares
from miho.optim.pace import LOGGED

CONF = Path(__file__).parents[1] / "conf" / "optimizer"
t = np.linspace(0.0, 2.0, 12)
y = 1.0 + 0.5 * t
y[7] += 40.0
BOX: dict[str, Any] = {"a": (-10, 10), "b": (-10, 10)}


def fitted(**keywords: Any) -> miho.Fit:
    return miho.fit(lambda t, a, b: a + b * t, t, y, BOX, compiled=False, **keywords)


@pytest.mark.parametrize("name", METHODS)
def test_a_method_by_name_has_the_settings_of_the_command_line(name: str) -> None:
    settings = yaml.safe_load((CONF / f"{name}.yaml").read_text(encoding="utf-8"))
    target = settings.pop("_target_")
    method: Any = method_of(name)
    assert type(method).__name__ == target.rpartition(".")[2]
    assert {key: value for key, value in asdict(method).items() if key in settings} == settings


def test_names_in_a_fit() -> None:
    assert type(fitted(method="least_squares", seed=1)) is miho.Fit
    robust = fitted(loss="huber", sigma=0.1)
    assert robust.values == pytest.approx({"a": 1.0, "b": 0.5}, abs=0.1)
    assert isinstance(robust.problem.rho, Huber)
    assert robust.problem.rho.scale == pytest.approx(0.1345)


def test_the_scale_of_a_loss_by_name_is_that_of_the_errors() -> None:
    sigma = np.array([0.1, 0.2])
    assert loss_of("cauchy", sigma) == Cauchy(2.385 / np.sqrt(np.mean(1 / sigma**2)))
    assert loss_of(None) == loss_of("square") == Square()
    assert loss_of(Huber(2.0)) == Huber(2.0)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"loss": "huber"}, "loss is 'huber', which needs a scale in the unit of the output"),
        ({"loss": "hubber"}, "expected miho.identification.Huber.* 'huber': did you mean that?"),
        ({"loss": 3}, "or one of square, huber, cauchy"),
        ({"method": "least-squares"}, "'least_squares': did you mean that"),
        ({"method": "xx"}, "method is 'xx'; expected a method, .* one of cluster_gauss"),
        (
            {"method": LeastSquares},
            r"the class LeastSquares; write method=LeastSquares\(\)",
        ),
        (
            {"budget": 300},
            r"budget is 300; expected a Budget, for example miho.Budget\(evaluations=1000\)",
        ),
    ],
)
def test_what_is_none_is_refused_in_one_line(keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as refused:
        fitted(**keywords)
    assert "\n" not in str(refused.value)


def test_a_long_search_says_that_it_is_alive(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """After two seconds and each ten, without an infinite error, and how to limit it."""
    now = [0.0]
    monkeypatch.setattr("miho.optim.pace.time.monotonic", lambda: now[0])
    space = miho.Space((miho.Parameter("a", "", -10, 10), miho.Parameter("b", "", -10, 10)))
    data = miho.Dataset("d", {"t": t, "y": y}, {"t": "", "y": ""}, "y")
    problem = CurveFit(lambda t, *, a, b: a + b * t, data, space, compiled=False)
    oracle: Any = SimpleNamespace(
        evaluations=5,
        meter=SimpleNamespace(seconds=2.0, rejected=Counter({"loss is nan": 5})),
        workers=SimpleNamespace(usage=None, busy=0),
        best=np.inf,
    )
    observe = pace_line(problem, DifferentialEvolution(), None)
    observe(oracle)
    assert not capsys.readouterr().err
    now[0] = 2.0
    observe(oracle)
    first = capsys.readouterr().err
    assert first.startswith("miho: model: no value yet (loss is nan) after 5 evaluations, 2 s")
    assert first.endswith(
        "; DifferentialEvolution stops by itself; budget=miho.Budget(seconds=60) limits it to a "
        "minute\n"
    )
    now[0] = 2.0 + LOGGED
    oracle.best = 0.25
    observe(oracle)
    second = capsys.readouterr().err
    assert second.startswith("miho: model: error 0.5 after 5 evaluations")
    assert "inf" not in first + second
    assert "budget" not in second
    pace_line(problem, DifferentialEvolution(), None, -LOGGED, limitable=False)(oracle)
    assert capsys.readouterr().err.endswith("; DifferentialEvolution stops by itself\n")
