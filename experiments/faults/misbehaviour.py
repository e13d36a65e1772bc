"""Jobs that go wrong, each in its way."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time

import numpy as np


def misbehave(how: str) -> str:
    """Do what `how` says to this process; any other text is given back."""
    if how == "exit":
        sys.exit(7)
    if how == "leave":
        os._exit(9)
    if how == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "hang":
        time.sleep(1000)
    while how == "deaf":
        with contextlib.suppress(KeyboardInterrupt):
            time.sleep(1000)
    if how == "raise":
        raise ValueError("no\n  good")
    if how == "memory":
        raise MemoryError
    return how


def spoil(job: str) -> tuple[int, float]:
    """Change this process, if the job says so; its number, and what exp(1) is in it."""
    if job == "spoil":
        np.exp = lambda _: 0.5  # type: ignore[assignment]
        os.chdir("/")
        subprocess.Popen(["sleep", "600"], start_new_session=True)  # noqa: S607 -- wherever it is
    return os.getpid(), float(np.exp(1.0))
