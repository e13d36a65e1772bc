"""Optimisation: problems, methods, and the oracle that evaluates and counts."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use
from miho.optim.minimize import minimize  # at once: the module has the same name

if TYPE_CHECKING:
    from miho.optim.ask_tell import AskTell
    from miho.optim.asynchronous_miho_gn import AsynchronousMIHOGN
    from miho.optim.distribution import Distribution
    from miho.optim.evidence import Agreement, agreement, in_optimum
    from miho.optim.meter import (
        Budget,
        BudgetExhausted,
        Clock,
        Meter,
        RunInterrupted,
        UnusableValueError,
    )
    from miho.optim.miho import MIHO
    from miho.optim.miho_gn import MIHOGN
    from miho.optim.miho_qn import MIHOQN
    from miho.optim.minimize import Checkpoint, Outcome, RunRecord
    from miho.optim.optimizer import Optimizer, Resumable
    from miho.optim.oracle import Oracle
    from miho.optim.problem import LeastSquaresProblem, Problem, Traits
    from miho.optim.random_search import RandomSearch
    from miho.optim.schedule import Rung, hyperband_table
    from miho.optim.space import Parameter, Space
    from miho.optim.trace import Descent, Descents, Minimum, Starts, Trace

__all__ = [
    "MIHO", "MIHOGN", "MIHOQN", "Agreement", "AskTell", "AsynchronousMIHOGN", "Budget",
    "BudgetExhausted", "Checkpoint", "Clock", "Descent", "Descents", "Distribution",
    "LeastSquaresProblem", "Meter", "Minimum", "Optimizer", "Oracle", "Outcome", "Parameter",
    "Problem", "RandomSearch", "Resumable", "RunInterrupted", "RunRecord", "Rung", "Space",
    "Starts", "Trace", "Traits", "UnusableValueError", "agreement", "hyperband_table", "in_optimum",
    "minimize",
]  # fmt: skip

REMOVED = {
    "Arrivals": "a journal repeats an asynchronous run: minimize(..., journal=FILE)",
    "AsynchronousMIHO": "use AsynchronousMIHOGN, or MIHO, whose batches workers evaluate",
}

__getattr__, __dir__ = at_first_use(__name__, REMOVED)
