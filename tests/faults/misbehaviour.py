"""Jobs and models that go wrong, each in its way."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time

import numpy as np

MODEL = '''"""A line whose evaluation goes wrong after some calls."""
from tests.faults.misbehaviour import misbehave

calls = 0


def line(alpha: "rad", *, B: "1/rad", C: "-", D: "N", Sx: "rad", Sy: "N") -> "N":
    global calls
    calls += 1
    if calls > 200:
        misbehave({how!r})
    return Sy - B * D * (alpha - Sx)
'''
"""The text of a model: `how` says what goes wrong."""


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
        subprocess.Popen(["sleep", "600"], start_new_session=True)
    return os.getpid(), float(np.exp(1.0))
