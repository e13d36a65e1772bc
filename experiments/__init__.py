"""Commands, run from the checkout: Hydra composes the configuration, the library does the work."""

import sys
from collections.abc import Sequence
from types import TracebackType

REMOVED = {
    "experiments.benchmarks.growth": "use experiments.benchmarks.arrival",
    "experiments.benchmarks.loss": "use experiments.benchmarks.formulas",
    "experiments.benchmarks.miho_reference": "use experiments.benchmarks.miho_run",
    "experiments.benchmarks.plan_time": "use experiments.benchmarks.plant",
    "experiments.benchmarks.tasks": "use experiments.benchmarks.overhead",
    "experiments.benchmarks.workers": "use experiments.benchmarks.many_workers --check",
    "experiments.check.replay": "a run with its journal repeats an asynchronous run",
    "experiments.compact": "folders .compact may be deleted",
    "experiments.export": "use miho.load_runs(ROOT).runs.to_csv(FILE, index=False)",
}
"""Former commands, with the remedy."""


class RemovedCommands:
    """The last finder of imports, which names the successor of a removed command."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: object = None) -> None:
        """Raise ModuleNotFoundError for a removed command."""
        if name in REMOVED:
            raise ModuleNotFoundError(f"{name} was removed; {REMOVED[name]}")


def print_uncaught(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Print an exception that nothing caught; a Ctrl-C during the imports has no traceback."""
    if issubclass(kind, KeyboardInterrupt):
        print("interrupted by SIGINT", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


sys.meta_path.append(RemovedCommands)
sys.excepthook = print_uncaught
