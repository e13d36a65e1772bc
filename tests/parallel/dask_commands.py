"""A scheduler of Dask and its workers, as a user starts them, each a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

CHECKOUT = Path(__file__).parents[2]
DEADLINE = 60.0


@dataclass
class DaskCommands:
    """`dask scheduler` and its workers, whose address is in a file in `folder`."""

    folder: Path
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @classmethod
    def started(cls, folder: Path, workers: int, *, nanny: bool = False) -> DaskCommands:
        """A scheduler that listens, and workers of one thread that come to it."""
        folder.mkdir(parents=True, exist_ok=True)
        options = ["--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0"]
        file = str(folder / "scheduler.json")
        scheduler = _dask(folder, "scheduler", *options, "--scheduler-file", file)
        commands = cls(folder, scheduler)
        wait_until(lambda: commands.address is not None)
        for _ in range(workers):
            commands.add_worker(nanny=nanny)
        return commands

    @property
    def address(self) -> str | None:
        """Where the scheduler listens, as `sweep.workers` takes it; None before it does."""
        try:
            text = (self.folder / "scheduler.json").read_text(encoding="utf-8")
            return str(json.loads(text)["address"]).replace("tcp:", "dask:")
        except (OSError, ValueError):
            return None

    def add_worker(self, *, nanny: bool = False) -> None:
        """One more worker, whose process is the command itself, or a child that a nanny renews."""
        options = ["--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1"]
        options += ["--nanny" if nanny else "--no-nanny"]
        file = str(self.folder / "scheduler.json")
        options += ["--scheduler-file", file, "--local-directory", str(self.folder)]
        self.workers.append(_dask(self.folder, "worker", *options))

    def close(self) -> None:
        """Kill them all."""
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


def wait_until(event: object, seconds: float = DEADLINE) -> None:
    """Wait for an event, a function that says whether it has come."""
    assert callable(event)
    until = time.monotonic() + seconds
    while not event():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.02)


def _dask(folder: Path, command: str, *options: str) -> subprocess.Popen[bytes]:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    with (folder / f"{command}.log").open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", command, *options],
            cwd=CHECKOUT, env=environment, stdout=log, stderr=log, start_new_session=True,
        )  # fmt: skip
