"""The problem for checks of methods, and the time that a method may spend without an evaluation."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

import numpy as np

from miho.optim import LeastSquaresProblem, Parameter, Space
from miho.optim.problem import mean_square
from miho.quantities import Array

PATIENCE = 60.0
"""CPU seconds that a method may compute between two evaluations, and seconds that it may wait."""
IDLE = 0.01
"""A method that computes for less than this share of the time is waiting; even a busy machine gives
it more."""


class NoEvaluation(BaseException):
    """A method makes no evaluations. Not an Exception, which a method might catch."""


@contextlib.contextmanager
def patience() -> Iterator[None]:
    """Context that raises NoEvaluation in a method that does not reach its next evaluation.

    It may compute for PATIENCE seconds of its CPU time, so that a busy machine makes no difference,
    or wait for as many seconds of wall time without computing. The context has no effect outside of
    the main thread, because only that handles signals, and on systems without interval timers.
    """
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or not hasattr(signal, "setitimer"):
        yield
        return

    # Two timers: one for the process's CPU seconds, and one for wall seconds.
    messages: list[str] = []

    def give_up(reason: str) -> None:
        messages.append(f"{reason} without an evaluation")
        raise NoEvaluation(messages[0])

    def on_computing(number: int, frame: FrameType | None) -> None:
        give_up(f"it computed for {PATIENCE:g} CPU seconds")

    last_cpu = time.process_time()

    def on_waiting(number: int, frame: FrameType | None) -> None:
        nonlocal last_cpu
        cpu = time.process_time()
        idle, last_cpu = cpu - last_cpu < IDLE * PATIENCE, cpu
        if idle:
            give_up(f"it waited for {PATIENCE:g} seconds")

    # Set them, and restore the previous handlers at the end.
    handlers = {signal.SIGVTALRM: on_computing, signal.SIGALRM: on_waiting}
    previous = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    _set_timers(PATIENCE)
    try:
        yield
    finally:
        _set_timers(0.0)
        for number, handler in previous.items():
            signal.signal(number, handler)
        if messages:  # it was raised in a run, which caught it and failed
            raise NoEvaluation(messages[0])


def restart_patience() -> None:
    """Restart both timers at an evaluation, if they are running."""
    if hasattr(signal, "setitimer") and signal.getitimer(signal.ITIMER_VIRTUAL)[0]:
        _set_timers(PATIENCE)


def _set_timers(seconds: float) -> None:
    for timer in (signal.ITIMER_VIRTUAL, signal.ITIMER_REAL):
        signal.setitimer(timer, seconds, seconds)


class DecayFit(LeastSquaresProblem):
    """Fit y = a exp(-b t), with a on a linear and b on a log scale, and record all evaluations.

    Parameters
    ----------
    spoil : callable, optional
        Maps parameters (n, d) and losses (n,) of a batch to modified losses.

    Attributes
    ----------
    thetas, losses : list
        All loss evaluations in order. The loss is +inf at a fidelity below one, which cannot become
        best. All data are used at any fidelity.
    spent : float
        Cost of losses, residuals and Jacobians; a fidelity counts as that fraction.
    """

    name = "conformance"
    space = Space(
        (
            Parameter("a", "V", -5.0, 5.0, sigma_max=0.5),
            Parameter("b", "1/s", 0.01, 10.0, scale="log", sigma_max=0.3),
        )
    )
    linear = ("a",)

    def __init__(self, spoil: Callable[[Array, Array], Array] | None = None) -> None:
        self.t = np.linspace(0.0, 2.0, 17)
        self.y = 2.0 * np.exp(-1.5 * self.t) + 0.05 * np.cos(40 * self.t)
        self.thetas: list[Array] = []
        self.losses: list[float] = []
        self.spent = 0.0
        self._spoil = spoil

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Mean squared residual (n,), modified by `spoil`."""
        losses = mean_square(thetas[:, :1] * np.exp(-thetas[:, 1:] * self.t) - self.y)
        if self._spoil is not None:
            losses = self._spoil(thetas, losses)
        self._remember(thetas, losses if fidelity == 1.0 else np.full(len(thetas), np.inf))
        self.spent += len(thetas) * fidelity
        return losses

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Model minus data, (17,)."""
        residuals = theta[0] * np.exp(-theta[1] * self.t) - self.y
        if self._spoil is not None and not np.isfinite(
            self._spoil(theta[None], mean_square(residuals)[None])
        ):
            residuals = np.full_like(residuals, np.nan)
        self._remember(theta[None], mean_square(residuals)[None])
        self.spent += 1
        return np.asarray(residuals)

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals, (17, 2)."""
        decay = np.exp(-theta[1] * self.t)
        self.spent += 2
        restart_patience()
        return np.stack([decay, -theta[0] * self.t * decay], axis=1)

    def _remember(self, thetas: Array, losses: Array) -> None:
        self.thetas.extend(thetas.copy())
        self.losses.extend(losses.tolist())
        restart_patience()
