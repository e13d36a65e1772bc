"""Evaluations in other processes and on other machines, and the evaluation log (journal)."""

from miho.parallel.evaluations import Evaluated, Evaluations
from miho.parallel.journal import Journal, JournalError, UncheckedJournalError, calls_of
from miho.parallel.journal_check import StaleJournalError
from miho.parallel.pending import Ahead, NoWorkersLeft
from miho.parallel.pool import Pool, Workers, open_pool

__all__ = [
    "Ahead",
    "Evaluated",
    "Evaluations",
    "Journal",
    "JournalError",
    "NoWorkersLeft",
    "Pool",
    "StaleJournalError",
    "UncheckedJournalError",
    "Workers",
    "calls_of",
    "open_pool",
]
