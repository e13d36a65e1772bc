"""Jobs for the workers of a cluster, some of which go wrong."""

import os
import signal
import time
from pathlib import Path

from miho.parallel.cluster_process import Placed
from miho.parallel.processes import descendants
from tests.faults.misbehaviour import misbehave


def misbehave_there(placed: Placed[str]) -> str:
    """As `misbehave`; a job 'worker' kills the worker of Dask that has it, and that of each try."""
    assert Path(placed.folder).is_dir()
    if placed.job == "worker":
        kill_dask_worker()
    return misbehave(placed.job)


def kill_dask_worker() -> None:
    """Kill the process whose thread waits for this job: it started the server of this process."""
    server = os.getppid()
    fields = Path(f"/proc/{server}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    os.kill(int(fields[1]), signal.SIGKILL)
    time.sleep(60)


def hang(placed: Placed[str]) -> str:
    """Leave a file that says who does it, and hang until it is interrupted."""
    Path(placed.job).write_text(str(os.getpid()), encoding="utf-8")
    try:
        while True:
            time.sleep(0.01)
    except KeyboardInterrupt:
        return f"interrupted {len(descendants(os.getpid()))}"
