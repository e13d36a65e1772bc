"""Losses whose evaluations go wrong in workers, and a log of what was evaluated."""

from __future__ import annotations

import os
import resource
import signal
import time
from collections import Counter
from pathlib import Path

import numpy as np

from miho.optim import Parameter, Problem, Space
from miho.quantities import Array

SPACE = Space((Parameter("x", "1", -1.0, 1.0), Parameter("y", "1", -1.0, 1.0)))
POLL = 0.01


class Failing(Problem):
    """x^2 + y^2, but `how` says what becomes of a row in a `share` of all.

    `doomed`: its process waits for its end, the first time, `ends` times in all; `memory`: there is
    none; `killed`: its process is killed, as by a system without memory; `hang`: it never ends. In
    the process that searches, `home`, such a row raises. Each takes `seconds`. The log names each
    row that is begun, that hangs, and that is done.
    """

    name, space = "failing", SPACE

    def __init__(
        self, folder: Path, *how: str, share: float = 0.1, seconds: float = 0.0, ends: int = 100
    ) -> None:
        self.folder, self.how, self.share, self.seconds = folder, how, share, seconds
        self.ends = ends
        self.home = os.getpid()

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return np.array([self._loss(theta) for theta in thetas])

    def _loss(self, theta: Array) -> float:
        row = theta.tobytes().hex()
        self._log(f"begun {row}")
        place = float(np.modf(abs(theta[0]) * 1e6)[0]) / self.share
        if self.how and place < 1:
            self._fail(self.how[int(place * len(self.how))], row)
        time.sleep(self.seconds)
        self._log(f"done {row}")
        return float(theta @ theta)

    def _fail(self, how: str, row: str) -> None:
        if how == "doomed":
            if os.getpid() != self.home and self._is_doomed(row):
                (self.folder / f"{row}.pid").write_text(f"{os.getpid()} ")
                _for_ever()
            return
        if os.getpid() == self.home:
            raise ValueError(how)
        if how == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if how == "hang":
            self._log(f"hangs {row}")
            _for_ever()
        limits = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (1 << 34, limits[1]))
        try:
            np.zeros(1 << 33)
        finally:
            resource.setrlimit(resource.RLIMIT_AS, limits)

    def _is_doomed(self, row: str) -> bool:
        if not _first(self.folder / f"{row}.row"):
            return False
        return any(_first(self.folder / f"{k}.end") for k in range(self.ends))

    def _log(self, line: str) -> None:
        line = f"{line}\n"
        with (self.folder / "log").open("ab", buffering=0) as file:  # a line at once
            file.write(line.encode())


def logged(folder: Path, what: str) -> Counter[str]:
    """How often each row was `begun` or `done`."""
    log = folder / "log"
    text = log.read_text(encoding="utf-8") if log.exists() else ""
    lines = [line.split() for line in text.splitlines()]
    return Counter(line[1] for line in lines if line[0] == what)


def _first(path: Path) -> bool:
    """Whether this is the first time."""
    try:
        path.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def _for_ever() -> None:
    while True:
        time.sleep(POLL)
