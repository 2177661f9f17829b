"""Executors of replications: this process, all its cores, or a cluster.

Everything goes through ``concurrent.futures.Executor``, so a study does not know which it is, and
its results do not depend on it.
"""

from __future__ import annotations

import importlib
import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

from planning.errors import RequestError
from planning.parallel import usable_cores

T = TypeVar("T")

ANSWER_WITHIN_S = 10.0
"""A scheduler that has not answered by then is taken to be absent [s]."""


class ClusterError(RequestError):
    """A cluster cannot be used: it does not answer, has no workers, or its package is missing."""


class InProcess(Executor):
    """Executor that computes at once, in the calling process: for debugging and for oracles."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Call the function now; the future that is returned is done."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def open_executor(
    workers: int | None = None,
    scheduler: str | None = None,
    *,
    answer_within_s: float = ANSWER_WITHIN_S,
) -> Iterator[Executor]:
    """Give an executor; it ends with the context.

    Args:
        workers: processes on this machine; 0 for none besides this one, None for one a core.
        scheduler: address of a Dask scheduler such as ``tcp://127.0.0.1:8786``, which then does
            the work instead.
        answer_within_s: how long the scheduler may take to answer [s].

    Raises:
        ClusterError: the scheduler does not answer, has no workers, or Dask is not installed.
    """
    if scheduler is not None:
        with _cluster(scheduler, answer_within_s) as executor:
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


def check_scheduler(address: str) -> None:
    """Raise a ClusterError unless a Dask scheduler answers at an address and has workers."""
    with _cluster(address, ANSWER_WITHIN_S):
        return


def parallelism(executor: Executor) -> int:
    """Return how many calls an executor works on at once, as far as it tells; at least 1."""
    workers = getattr(executor, "_max_workers", None)
    client = getattr(executor, "_client", None)
    if client is not None:
        workers = sum(client.nthreads().values())
    return max(1, int(workers or 1))


@contextmanager
def _cluster(address: str, answer_within_s: float) -> Iterator[Executor]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise ClusterError(
            "a cluster needs the package 'distributed': pip install"
            " 'assembly-twin[cluster]'"
        ) from error
    try:
        client = distributed.Client(address, timeout=answer_within_s)
    except (OSError, TimeoutError, ValueError) as error:
        raise ClusterError(
            f"no scheduler answered at {address} within {answer_within_s:g} s; start one"
            " with 'dask scheduler --host 127.0.0.1' and give its address"
        ) from error
    try:
        if not client.nthreads():
            raise ClusterError(
                f"the scheduler at {address} has no workers; start some with"
                f" 'dask worker {address}'"
            )
        # The same call with the same arguments is always wanted again: nothing is cached.
        yield client.get_executor(pure=False)
    finally:
        client.close(timeout=answer_within_s)
