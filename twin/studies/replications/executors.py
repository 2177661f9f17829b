"""Executors of replications: the calling process, worker processes on all cores, or a cluster.

All implement ``concurrent.futures.Executor``, so the results of a study do not depend on the choice.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

from planning.parallel import usable_cores
from twin.cluster.address import Cluster
from twin.cluster.client import ANSWER_WITHIN_S, cluster_executor

T = TypeVar("T")


class InProcess(Executor):
    """Executor that computes immediately in the calling process: for debugging and tests."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Call the function now; return a finished future."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def open_executor(
    workers: int | None = None,
    cluster: Cluster | None = None,
    *,
    answer_within_s: float = ANSWER_WITHIN_S,
) -> Iterator[Executor]:
    """Yield an executor, closed with the context.

    Args:
        workers: processes on this machine; 0 for none besides this one, None for one per core.
        cluster: whose workers do it instead.
        answer_within_s: how long the scheduler may take to answer [s].

    Raises:
        ClusterError: the scheduler does not answer, has no workers, or Dask is not installed.
        ClusterLostError: the scheduler went away meanwhile, or workers died again and again.
    """
    if cluster is not None:
        with cluster_executor(cluster, answer_within_s) as executor:
            yield executor
    elif workers == 0:
        yield InProcess()
    else:
        # Spawned, not forked: threads of compiled libraries do not survive a fork.
        pool = ProcessPoolExecutor(
            max_workers=workers or usable_cores(),
            mp_context=multiprocessing.get_context("spawn"),
        )
        try:
            yield pool
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def check_cluster(cluster: Cluster) -> None:
    """Raise a ClusterError unless the scheduler of a cluster answers and has workers."""
    with cluster_executor(cluster):
        return


def parallelism(executor: Executor) -> int:
    """Return the number of parallel calls of an executor, if known; at least 1."""
    threads = getattr(executor, "threads", None)
    workers = threads() if callable(threads) else getattr(executor, "_max_workers", 1)
    return max(1, int(workers))
