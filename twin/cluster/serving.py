"""Scheduler and workers of a compute cluster, which listen on one address and accept TLS connections only.

Dask's own programs also serve dashboards, without certificates and by default on all network interfaces. This
module does not start dashboards.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import signal
import socket
import tempfile
from collections.abc import Callable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import dask
import distributed
from distributed.worker import Worker

from planning.errors import RequestError, TwinError
from twin.cluster.certificates import Certificates
from twin.cluster.client import security

Say = Callable[[str], None]

JOINED_WITHIN_S = 60.0
"""Workers that have found no scheduler by then give up [s]."""

NO_WORKER_FOR = "5 minutes"
"""Time without workers after which a scheduler fails its calls."""


WORKERS_A_CALL = 10
"""Number of workers that may die with a call before the call is blamed."""


class _Scheduler(distributed.Scheduler):
    """A scheduler without dashboard."""

    def start_http_server(self, *_: Any, **__: Any) -> None:
        """Start none: it would require no certificate."""


class _Worker(Worker):
    """A worker without dashboard; errors go to the client, not to this terminal."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        super().__init__(*arguments, **options)

    def start_http_server(self, *_: Any, **__: Any) -> None:
        """Start none: it would require no certificate."""


def serve_cluster(
    certificates: Certificates, host: str, port: int, workers: int, say: Say
) -> None:
    """Run a scheduler and workers until SIGINT or SIGTERM.

    Args:
        certificates: that members and clients must show.
        host: address of this machine to listen on.
        port: of the scheduler; 0 for any that is free.
        workers: processes on this machine, each for one block at a time.
        say: receives the address once it can be used.

    Raises:
        RequestError: the host is not one address of this machine, or the port is taken.
        TwinError: the workers do not start.
    """
    _require_own_address(host, port)

    async def serve(stack: AsyncExitStack) -> list[Any]:
        scheduler = _Scheduler(
            host=_in_url(host),
            port=port,
            protocol="tls",
            security=security(certificates, "scheduler"),
            dashboard=False,
        )
        await stack.enter_async_context(scheduler)
        await _start_workers(stack, certificates, scheduler.address, host, workers)
        say(f"{scheduler.address} with {workers} workers: Ctrl-C ends it")
        return [scheduler]

    patience = {
        "distributed.scheduler.no-workers-timeout": NO_WORKER_FOR,
        "distributed.scheduler.allowed-failures": WORKERS_A_CALL,
    }
    with dask.config.set(patience):
        asyncio.run(_until_signalled(serve))


def serve_workers(
    certificates: Certificates, address: str, host: str, workers: int, say: Say
) -> None:
    """Run workers for a scheduler until SIGINT or SIGTERM, or until it is gone.

    Args:
        certificates: those of the scheduler.
        address: of the scheduler.
        host: address of this machine to listen on.
        workers: processes, each for one block at a time.
        say: called once they are connected.

    Raises:
        RequestError: the host is not one address of this machine.
        TwinError: the scheduler does not answer, or is gone.
    """
    _require_own_address(host, 0)

    async def serve(stack: AsyncExitStack) -> list[Any]:
        nannies = await _start_workers(stack, certificates, address, host, workers)
        say(f"{workers} workers for {address}: Ctrl-C ends them")
        return nannies

    if not asyncio.run(_until_signalled(serve)):
        raise TwinError(f"the scheduler at {address} is gone")


async def _start_workers(
    stack: AsyncExitStack,
    certificates: Certificates,
    address: str,
    host: str,
    workers: int,
) -> list[Any]:
    # Designs are evaluated in processes of their own.
    dask.config.set({"distributed.worker.daemon": False})
    scratch = Path(
        stack.enter_context(tempfile.TemporaryDirectory(prefix="twin-cluster-"))
    )
    nannies = [
        distributed.Nanny(
            address,
            nthreads=1,
            host=_in_url(host),
            protocol="tls",
            security=security(certificates, "worker"),
            worker_class=_Worker,
            dashboard=False,
            death_timeout=JOINED_WITHIN_S,
            local_directory=str(scratch),
        )
        for _ in range(workers)
    ]
    try:
        await asyncio.gather(*map(stack.enter_async_context, nannies))
    except (OSError, TimeoutError, RuntimeError) as error:
        raise TwinError(
            f"no worker could join the scheduler at {address} with these certificates:"
            f" {error}"
        ) from error
    return nannies


async def _until_signalled(
    serve: Callable[[AsyncExitStack], Any],
) -> bool:
    """Start servers and end them at a signal, or when all have ended; return whether by signal."""
    logging.getLogger("distributed").setLevel(logging.WARNING)
    stopped = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    async with AsyncExitStack() as stack:
        waiting = asyncio.ensure_future(stopped.wait())
        starting = asyncio.ensure_future(serve(stack))
        await asyncio.wait((waiting, starting), return_when=asyncio.FIRST_COMPLETED)
        if not starting.done():
            starting.cancel()
            return True
        ends = [asyncio.ensure_future(s.finished()) for s in starting.result()]
        ended = asyncio.ensure_future(asyncio.wait(ends)) if ends else waiting
        await asyncio.wait((waiting, ended), return_when=asyncio.FIRST_COMPLETED)
        for task in (waiting, ended, *ends):
            task.cancel()
        return stopped.is_set()


def _require_own_address(host: str, port: int) -> None:
    """Raise a RequestError unless a host is one address of this machine with a free port."""
    try:
        chosen = ipaddress.ip_address(host)
    except ValueError as error:
        raise RequestError(
            f"--host {host}: give an address of this machine in numbers, such as 10.0.0.1"
        ) from error
    if chosen.is_unspecified:
        raise RequestError(
            f"--host {host} means every interface of this machine: name one address"
        )
    family = socket.AF_INET6 if chosen.version == 6 else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise RequestError(
                f"--host {host}: cannot listen on port {port} there: {error.strerror}"
            ) from error


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host
