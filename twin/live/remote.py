"""A driver in a process of its own, which asks a cell for the nodes of its robot."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

from planning.errors import RequestError
from twin.cluster.certificates import Certificates
from twin.live.driver_end import DriverEnd
from twin.live.service import METHOD, channel_to, grpc_module
from twin.live.wire_format import MessageError, read_command, report_bytes

_AGAIN_S = 0.2
"""How long it waits before it asks again [s]."""


def drive_remotely(
    end: DriverEnd,
    address: str,
    certificates: Certificates | None = None,
    *,
    every_s: float = 0.02,
    patience_s: float = 60.0,
    over: Callable[[], bool] = lambda: False,
) -> None:
    """Serve a cell until it says that nothing more will come.

    Args:
        end: of the driver.
        address: of the cell, such as ``127.0.0.1:50551``.
        certificates: of both sides; None for a cell on this machine.
        every_s: time between reports [s].
        patience_s: how long it asks for a cell that is not there [s].
        over: tells whether to end before.

    Raises:
        RequestError: the cell refuses it, or is not there.
    """
    grpc = grpc_module()
    refused = (
        grpc.StatusCode.NOT_FOUND,
        grpc.StatusCode.UNAUTHENTICATED,
        grpc.StatusCode.INVALID_ARGUMENT,
    )

    def reports() -> Iterator[bytes]:
        while not end.left and not over():
            yield report_bytes(end.report())
            time.sleep(every_s)

    with channel_to(address, certificates) as channel:
        ask = channel.stream_stream(METHOD)
        heard = time.monotonic()
        while not end.left and not over():
            try:
                for content in ask(reports()):
                    heard = time.monotonic()
                    _take(end, content)
            except grpc.RpcError as error:
                told: Any = error
                if told.code() in refused:
                    raise RequestError(f"{address}: {told.details()}") from None
                if time.monotonic() - heard > patience_s:
                    raise RequestError(
                        f"{address}: no cell for {patience_s:g} s: {told.details()}"
                    ) from None
            time.sleep(_AGAIN_S)


def _take(end: DriverEnd, content: bytes) -> None:
    try:
        end.receive(read_command(content))
    except MessageError:
        return  # it comes again
