"""Reasons that end a run whose evaluations are made elsewhere or stored in a journal."""

from __future__ import annotations

SPURIOUS_INTERRUPT = "KeyboardInterrupt, though nobody interrupted it"
"""The reason of a run or a job whose code raises KeyboardInterrupt itself."""


class JournalError(ValueError):
    """A journal cannot be used. The message names the file and a remedy in one line."""


class UncheckedJournalError(JournalError):
    """A journal cannot be checked, because its model fails for a reason that may be temporary."""


class StaleJournalError(BaseException):
    """The values of a journal differ from its functions, or cannot be compared with them.

    It is not an Exception, because methods may treat an Exception as a rejected evaluation. The
    `error` is a JournalError for the method's caller.
    """

    def __init__(self, error: JournalError) -> None:
        super().__init__(str(error))
        self.error = error


class NoWorkersLeft(BaseException):
    """No worker can evaluate anything any more; the message gives the reason in one line.

    It is not an Exception, because methods may treat an Exception as a rejected evaluation.
    """
