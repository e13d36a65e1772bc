"""A sweep learns how each of its jobs ended before it learns that the cluster is lost."""

from __future__ import annotations

from typing import Any

import pytest

from experiments.app.cluster_workers import ClusterWorkers
from miho.parallel.cluster import ClusterLost


class Future:
    """A future that ends when the test says so."""

    def add_done_callback(self, ended: Any) -> None:
        self.end = lambda: ended(self)

    def cancelled(self) -> bool:
        return True

    def result(self, timeout: float) -> None:
        raise RuntimeError("cancelled")


class Client:
    """A client of a cluster of three threads."""

    status = "running"

    def __init__(self) -> None:
        self.futures: list[Future] = []

    def nthreads(self) -> dict[str, int]:
        return {"tcp://127.0.0.1:1": 3}

    def submit(self, *_: Any, **__: Any) -> Future:
        self.futures.append(Future())
        return self.futures[-1]


@pytest.mark.parametrize("closed", [True, False])
def test_after_a_break_all_jobs_end_before_the_cluster_counts_as_lost(closed: bool) -> None:
    client: Any = Client()
    workers: ClusterWorkers[str, None] = ClusterWorkers(client, lambda placed: None)
    assert workers.idle == 3
    workers.start("first")
    workers.start("second")
    assert workers.idle == 1
    if closed:
        client.status = "closed"
        assert workers.idle == 0
    reasons = []
    for future, left in zip(client.futures, (1, 0), strict=True):
        future.end()
        reasons += [ended.reason for ended in workers.wait(1)]
        assert (workers.busy, workers.idle) == (left, 1 - left)
    assert ["the connection to the Dask scheduler broke" in str(text) for text in reasons] == [
        True
    ] * 2
    with pytest.raises(ClusterLost, match="call again"):
        workers.start("third")
