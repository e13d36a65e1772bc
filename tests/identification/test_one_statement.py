"""All outputs say the same of an optimum, also where a step after the search finds a better one."""

# mypy: disable-error-code="no-untyped-def"
import html
import json
import pickle
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import miho
from miho.analysis.pages.run import save_report
from miho.identification import Huber, report_steps
from miho.identification.conclusion import conclusion_from
from miho.optim import Budget, Descents, Optimizer, Outcome
from tests.printed import flat

BRACKETS = 30
T = np.linspace(0, 3, 80)
Y = 0.6 * np.sin(4.0 * T) + 0.5 * np.random.default_rng(4).standard_normal(80)
BOUNDS = {"b1": (0.1, 3), "b2": (0.1, 12)}


def wave(t, b1, b2):
    """An optimum in b2 every few periods; the profile of b2 passes from one to the next."""
    return b1 * np.sin(b2 * t)


@dataclass(frozen=True)
class Misled(Optimizer):
    """All of its brackets end in the same optimum, which is not the best."""

    at: tuple[float, float] = (0.3, 6.0)

    def run(self, oracle, rng):
        loss = float(oracle(np.array([self.at]))[0])
        oracle.meter.starts.brackets = True
        oracle.starts.screened += 100
        for _ in range(BRACKETS):
            oracle.starts.add(np.inf, loss)


@pytest.fixture
def misled() -> miho.Fit:
    """A fit whose search ended in a wrong optimum, of which it is sure."""
    local = miho.fit(wave, T, Y, BOUNDS, start={"b1": 0.3, "b2": 6.0})
    fit = miho.fit(wave, T, Y, BOUNDS, method=Misled(tuple(local.theta)))
    assert fit.error == pytest.approx(local.error)
    assert "Converged: " in fit.optimum, "or this tests nothing"
    return fit


def test_a_better_optimum_of_a_profile_is_the_fits_own_everywhere(
    misled: miho.Fit, tmp_path: Path
) -> None:
    missed = misled.error
    best = miho.fit(wave, T, Y, BOUNDS, start={"b1": 0.6, "b2": 4.0})
    assert best.error < 0.8 * missed, "or this tests nothing"
    report = misled.report()
    statement = (
        f"In doubt: a profile found this optimum after {BRACKETS} independent searches had ended, "
        f"the best of them at an error of {missed:.5g}."
    )
    save_report(report, tmp_path)
    stored = json.loads((tmp_path / "parameters.json").read_text())
    page = html.unescape((tmp_path / "report.html").read_text())
    # Each says the same of the optimum.
    assert report.conclusion.statement == misled.optimum == statement
    assert stored["provenance"]["optimum"] == statement
    for text in (flat(misled), flat(report), page, misled._repr_html_()):
        assert f"the optimum is {statement[0].lower()}{statement[1:]}" in html.unescape(text)
        assert "Converged: " not in text
    # And each is of the better one.
    values = dict(zip(("b1", "b2"), best.theta, strict=True))
    for found in (misled.values, misled.parameters["value"].to_dict(),
                  report.parameters.set_index("parameter")["value"].to_dict(),
                  {name: stored["parameters"][name]["value"] for name in values}):  # fmt: skip
        assert found == pytest.approx(values, rel=1e-4)
    for error in (misled.error, report.error, stored["provenance"]["error"]):
        assert error == pytest.approx(best.error, rel=1e-6)
    assert misled.predict(T).value == pytest.approx(best.predict(T).value, abs=1e-3)
    assert f"error {best.error:.5g} " in str(misled)
    # It stays so.
    assert misled.notes[0] == report.notes[0]
    for again in (pickle.loads(pickle.dumps(misled)), misled):
        assert again.optimum == statement
        assert again.report().conclusion.statement == statement
    assert not best.report().found_by


def test_before_its_report_a_fit_says_what_its_report_will() -> None:
    fit = miho.fit(wave, T, Y, BOUNDS)
    assert fit.optimum == fit.report().conclusion.statement
    assert fit.optimum in flat(fit.report())


def test_a_better_optimum_of_the_bootstrap_is_reported(
    misled: miho.Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One replicate has left for the better basin; the others are those of the fit."""

    def replicates(problem, optima, count, *_):
        return np.vstack([np.tile(optima[0].theta, (count - 1, 1)), [0.55, 3.9]])

    monkeypatch.setattr(report_steps, "replicated", replicates)
    report = misled.report(profiles=False, replicates=20)
    assert report.conclusion.doubt.startswith(
        "the bootstrap found this optimum after 30 independent searches had ended"
    )
    assert misled.theta == pytest.approx(report.at.theta)


def test_a_descent_that_lowers_the_loss_of_the_run_is_said() -> None:
    fit = miho.fit(wave, T, Y, BOUNDS, method="random", budget=Budget(evaluations=50))
    before = np.sqrt(fit.problem.loss(fit.run[None])[0])
    assert before > 1.001 * fit.error, "or this tests nothing"
    lowered = "a descent from the run's result lowered the error from"
    assert lowered in fit.optimum
    assert lowered in flat(fit)
    assert lowered in fit.report().conclusion.statement
    exact = miho.fit(wave, T, Y, BOUNDS)
    assert "lowered" not in exact.optimum


def test_a_robust_loss_is_judged_by_the_same_loss() -> None:
    fit = miho.fit(wave, T, Y, BOUNDS, loss=Huber(scale=0.5))
    assert fit.optimum == fit.report().conclusion.statement
    assert "lowered" not in fit.optimum


def test_a_search_that_ended_at_its_last_bracket_claims_nothing() -> None:
    """Two brackets are not enough for any evidence."""
    fit = miho.fit(wave, T, Y, BOUNDS, method=miho.MIHOGN(max_brackets=2))
    assert fit.descents is not None
    assert not fit.descents.settled
    run = miho.minimize(miho.MIHOGN(max_brackets=2), fit.problem)
    assert run.outcome is Outcome.BRACKETS
    for text in (fit.optimum, str(fit), str(fit.report())):
        assert "in doubt" in text.lower()
        assert "Converged" not in text
    assert miho.fit(wave, T, Y, BOUNDS).descents.settled


@pytest.mark.parametrize("agreeing", [7, 100])
def test_ends_that_agree_claim_nothing_where_the_method_was_not_satisfied(agreeing: int) -> None:
    """As at a bound, where `MIHOGN` asks for more of them."""
    ends = Descents(agreeing, agreeing, agreeing, 0, (1.0,) * agreeing, brackets=True)
    assert conclusion_from(1.0, 0.0, [ends]).statement.startswith("Converged: ")
    conclusion = conclusion_from(1.0, 0.0, [replace(ends, settled=False)])
    assert conclusion.statement == (
        f"In doubt: {agreeing} of {agreeing} independent searches found this optimum; the search "
        "ended before the evidence was sufficient."
    )
    check = Descents(20, 20, 20, 0, (1.0,) * 20)
    assert not conclusion_from(1.0, 0.0, [replace(ends, settled=False), check]).doubt, (
        "the check is"
    )


def test_a_report_to_more_digits_gives_the_fit_its_digits() -> None:
    """A descent that stopped early goes on in the report."""
    fit = miho.fit(wave, T, Y, BOUNDS, start={"b1": 0.6, "b2": 4.0})
    off = replace(fit, theta=fit.theta * (1 + 1e-4))
    report = off.report()
    assert off.theta == pytest.approx(fit.theta, rel=1e-6)
    assert np.array_equal(off.theta, report.at.theta)
    assert off.parameters["value"].tolist() == report.parameters["value"].tolist()


def test_optima_that_a_report_meets_stay_with_the_fit() -> None:
    t = T[::7]
    y = 0.45 * np.sin(4 * t) + 0.5 * np.random.default_rng(1).standard_normal(t.size)
    fit = miho.fit(wave, t, y, BOUNDS, start={"b1": 0.3, "b2": 6.0}, compiled=False)
    assert fit.alternatives.empty
    report = fit.report()
    assert report.found_by, "or this tests nothing"
    assert len(report.optima) > 1, "or this tests nothing"
    for one in (fit, pickle.loads(pickle.dumps(fit))):
        assert one.alternatives["b2"].tolist() == pytest.approx(report.optima["b2"], rel=1e-3)
        assert len(one.report().optima) == len(report.optima)
    assert "optima differ by less than the noise" in flat(fit)


def test_a_fit_of_an_older_version_is_stored_again() -> None:
    fit = miho.fit(wave, T, Y, BOUNDS, start={"b1": 0.6, "b2": 4.0}, compiled=False)
    state = fit.__getstate__()
    for name in ("moving", "found_by", "minima"):
        state.pop(name, None)
    older = object.__new__(miho.Fit)
    older.__setstate__(state)
    again = pickle.loads(pickle.dumps(older))
    assert str(again) == str(older) == str(fit)


def test_a_report_without_time_casts_no_doubt_on_the_optimum() -> None:
    fit = miho.fit(wave, T, Y, {"b1": (0.1, 3), "b2": (2, 6)}, compiled=False)
    assert "Converged: " in fit.optimum, "or this tests nothing"
    known = fit.optimum
    report = fit.report(seconds=0)
    assert report.omitted, "or this tests nothing"
    assert "is over; set seconds=0, or --seconds 0 on the command line." in report.omitted[0]
    assert report.conclusion.statement == fit.optimum == known
    cut = replace(fit, theta=1.01 * fit.theta, moving=7)
    assert "had not ended after 7 evaluations" in cut.report(seconds=0).conclusion.doubt
