"""Executors that run function calls on a compute cluster, and error messages about the cluster."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from typing import Any, TypeVar

from planning.errors import RequestError, TwinError, format_names
from twin.cluster.address import Cluster
from twin.cluster.certificates import Certificates
from twin.host.extras import extra_module
from twin.host.versions import versions

ANSWER_WITHIN_S = 10.0
"""Timeout for the scheduler's answer [s]."""


T = TypeVar("T")


class ClusterError(RequestError):
    """A cluster cannot be used: it does not answer, has no workers, or its package is missing."""


class ClusterLostError(TwinError):
    """A cluster disconnected during the work, or its workers keep crashing."""


def distributed() -> Any:
    """Return Dask's package for clusters, which is an extra.

    Raises:
        ClusterError: it is not installed.
    """
    return extra_module(
        "distributed",
        package="distributed",
        extra="cluster",
        needs="a cluster",
        error=ClusterError,
    )


def security(certificates: Certificates, role: str) -> Any:
    """Return Dask's security settings that refuse connections without a certificate.

    Args:
        certificates: of this machine.
        role: client, scheduler or worker.
    """
    return distributed().Security(
        require_encryption=True,
        tls_ca_file=str(certificates.authority),
        **{
            f"tls_{role}_cert": str(certificates.certificate),
            f"tls_{role}_key": str(certificates.key),
        },
    )


class ClusterExecutor(Executor):
    """Executor whose calls run on a cluster; every call ends, even if the cluster fails.

    Dask has one of its own, whose futures stay pending for ever when the scheduler goes away
    between the end of a call and the fetching of its result.
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Submit a call to a worker."""
        # The same call with the same arguments is always wanted again: nothing is cached.
        called = self._client.submit(fn, *args, pure=False, **kwargs)
        future: Future[T] = Future()
        self._client.loop.add_callback(_carry, called, future)
        return future

    def threads(self) -> int:
        """Return the number of calls that the cluster executes in parallel."""
        return sum(self._client.nthreads().values())


async def _carry(called: Any, future: Future[T]) -> None:
    """Copy the outcome of a call to its future."""
    try:
        result = await called
    except BaseException as error:
        if future.set_running_or_notify_cancel():
            future.set_exception(error)
    else:
        if future.set_running_or_notify_cancel():
            future.set_result(result)


@contextmanager
def cluster_executor(
    cluster: Cluster, answer_within_s: float = ANSWER_WITHIN_S
) -> Iterator[ClusterExecutor]:
    """Yield an executor whose calls run on a cluster, closed with the context.

    Args:
        cluster: the cluster.
        answer_within_s: how long the scheduler may take to answer [s].

    Raises:
        ClusterError: the scheduler does not answer, has no workers or some with other versions,
            or Dask is not installed.
        ClusterLostError: the scheduler went away while the context was open, or workers died
            again and again.
        RequestError: a worker would be spoken to in the clear.
    """
    lost = _losses()
    client = _client(cluster, answer_within_s)
    try:
        _require_workers(client, cluster)
        yield ClusterExecutor(client)
    except lost as error:
        raise _lost(cluster, error) from error
    finally:
        client.close(timeout=answer_within_s)


def _client(cluster: Cluster, answer_within_s: float) -> Any:
    dask = distributed()
    # Dask's own messages on lost connections are replaced by the errors of this room.
    for name in ("distributed", "distributed.client", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    held = cluster.certificates
    try:
        return dask.Client(
            cluster.address,
            timeout=answer_within_s,
            security=None if held is None else security(held, "client"),
        )
    except (OSError, TimeoutError, ValueError) as error:
        raise ClusterError(
            f"no scheduler answered at {cluster.address} within {answer_within_s:g} s"
            f"{'' if held is None else ' to these certificates'}; start one with"
            " 'twin cluster up' and give the address that it prints"
        ) from error


def _require_workers(client: Any, cluster: Cluster) -> None:
    workers = client.nthreads()
    if not workers:
        raise ClusterError(
            f"the scheduler at {cluster.address} has no workers; start some with"
            f" 'twin cluster join {cluster.address}'"
        )
    for address in workers:
        cluster.require_private(address)
    require_same_versions(client.run(versions, on_error="return"), versions())


def require_same_versions(found: Mapping[str, Any], here: Mapping[str, str]) -> None:
    """Refuse workers whose results could differ from those of this machine.

    Args:
        found: versions of Python and packages by worker address, or its error.
        here: those of this machine.

    Raises:
        ClusterError: a worker has other versions, or no ``assembly-twin``.
    """
    for address, there in sorted(found.items()):
        if isinstance(there, BaseException):
            raise ClusterError(
                f"the worker at {address} cannot work for this version of assembly-twin:"
                f" {there}"
            )
        other = [
            f"{name} is {there.get(name, 'missing')} there and {version} here"
            for name, version in here.items()
            if there.get(name) != version
        ]
        if other:
            raise ClusterError(
                f"the worker at {address} has other versions, so results could differ:"
                f" {format_names(other)}"
            )


def _losses() -> tuple[type[BaseException], ...]:
    """Return Dask's errors for lost calls."""
    from asyncio import CancelledError as AsyncCancelledError

    dask = distributed()
    comm = importlib.import_module("distributed.comm")
    scheduler = importlib.import_module("distributed.scheduler")
    more = [
        getattr(scheduler, name)
        for name in ("NoWorkerError", "NoValidWorkerError")
        if hasattr(scheduler, name)
    ]
    return (
        *(CancelledError, AsyncCancelledError),
        *(comm.CommClosedError, dask.scheduler.KilledWorker, *more),
    )


def _lost(cluster: Cluster, error: BaseException) -> ClusterLostError:
    if type(error).__name__ == "KilledWorker":
        return ClusterLostError(
            f"workers at {cluster.address} died again and again over the same block"
            " (out of memory?)"
        )
    if "Worker" in type(error).__name__:
        return ClusterLostError(f"no worker is left at {cluster.address}")
    return ClusterLostError(f"the scheduler at {cluster.address} went away")
