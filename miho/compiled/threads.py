"""Threads for parts of a batch, shared by all losses of a process."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache


def threads_of(count: int) -> ThreadPoolExecutor:
    """Pool of this number of threads of this process; a fork has none of its parent's threads."""
    return _threads_of(count, os.getpid())


@cache
def _threads_of(count: int, process: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count)
