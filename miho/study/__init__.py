"""Runs on disk: identity, atomic folders, the runner and tables of runs."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.study.environment import environment_stamp, single_thread
    from miho.study.files import DamagedRun, write_bytes, write_text
    from miho.study.identity import Identity
    from miho.study.index import Runs, load_runs
    from miho.study.runner import Execution, Status, execute
    from miho.study.store import RunInUse, Store, StoredRun, read_run

__all__ = [
    "DamagedRun", "Execution", "Identity", "RunInUse", "Runs", "Status", "Store", "StoredRun",
    "environment_stamp", "execute", "load_runs", "read_run",
    "single_thread", "write_bytes", "write_text",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(
    __name__, {"compact": "`load_runs` reads the files of the runs, and needs no cache"}
)
