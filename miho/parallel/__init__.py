"""Evaluations in other processes and on other machines, and the evaluation log (journal)."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.parallel.errors import (
        JournalError,
        NoWorkersLeft,
        StaleJournalError,
        UncheckedJournalError,
    )
    from miho.parallel.evaluations import Evaluations
    from miho.parallel.journal import Journal, calls_of
    from miho.parallel.pool import Pool, Workers, open_pool
    from miho.parallel.rows import Ahead, Evaluated

__all__ = [
    "Ahead", "Evaluated", "Evaluations", "Journal", "JournalError", "NoWorkersLeft", "Pool",
    "StaleJournalError", "UncheckedJournalError", "Workers", "calls_of", "open_pool",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
