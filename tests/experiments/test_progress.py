"""The bar of a run follows the limit that ends it."""

import math
import os

import pytest

from experiments.app.progress import progress, spent
from miho import Budget, Oracle
from miho.optim import Clock
from miho.testing import DecayFit


@pytest.mark.parametrize(
    ("budget", "evaluations", "seconds", "share", "left"),
    [
        (Budget(evaluations=500_000, seconds=60), 30, 45, 0.75, 15),
        (Budget(evaluations=100, seconds=60), 80, 6, 0.8, 1.5),
        (Budget(evaluations=100), 25, 3, 0.25, 9),
        (Budget(seconds=60), 10, 15, 0.25, 45),
        (Budget(evaluations=100), 0, 0, 0, math.inf),
        (Budget(), 10, 15, 0, math.inf),
        (Budget(seconds=60), 10, 61, 1, 0),  # the batch in progress is finished
    ],
)
def test_the_nearer_limit(
    budget: Budget, evaluations: int, seconds: float, share: float, left: float
) -> None:
    assert spent(budget, evaluations, seconds) == pytest.approx((share, left))


def test_the_bar_shows_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A slow model within 500,000 evaluations and 60 seconds, of which 45 are over."""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    now = [0.0]
    clock = Clock(wall=lambda: now[0], cpu=lambda: now[0])
    budget = Budget(evaluations=500_000, seconds=60)
    with progress("run", budget, "V") as observer:
        problem = DecayFit()
        oracle = Oracle(problem, budget, observer=observer, clock=clock)
        theta = problem.space.decode(problem.space.initial(1))
        loss = float(problem.loss(theta)[0])
        oracle.starts.add(9.0, loss)
        oracle.starts.add(9.0, loss)
        oracle.starts.add(9.0, 1.5 * loss)
        now[0] = 45.0
        oracle(theta)
    printed = capsys.readouterr().err
    assert " 75% |" in printed
    assert ", 2 of 3 descents agree, " in printed
    assert "at most 15 s left" in printed


def test_a_line_without_a_value_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("experiments.app.progress.Pace.line_due", lambda self: True)
    with progress("run", Budget(evaluations=100), "V") as observer:
        observer(Oracle(DecayFit(), Budget(evaluations=100)))
    assert capsys.readouterr().err.startswith("run: no value yet, 0 evaluations, ")


def test_a_terminal_without_a_width_shows_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """That of `docker exec -t` or of `script` in a job: it says that it has 0 columns."""
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    os.set_blocking(ours, False)
    with os.fdopen(ours, "rb", buffering=0) as shown, os.fdopen(theirs, "w") as stream:
        monkeypatch.setattr("sys.stderr", stream)
        with progress("run", Budget(evaluations=100), "V"):
            stream.flush()
            assert b"run" in (shown.read(1000) or b"")
