"""The service at which drivers in other processes, and in any language, ask for their robots' nodes (gRPC); and one that asks."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from planning.errors import RequestError
from twin.cluster.certificates import Certificates, on_this_machine
from twin.host.extras import extra_module
from twin.live.driver_end import Deliver, DriverEnd
from twin.live.wire_format import (
    Command,
    MessageError,
    Report,
    command_bytes,
    message_class,
    read_command,
    read_report,
    report_bytes,
)

METHOD = "/assembly_twin.Cell/Drive"
"""Path of the one method of the service."""

NAME = "assembly-twin cluster"
"""Name in the certificates that ``twin cluster certificates`` makes."""

_MOST_WAITING = 1000
"""Commands that wait for a driver that does not take them."""

_log = logging.getLogger(__name__)


def grpc_module() -> Any:
    """Return the module grpc.

    Raises:
        RequestError: it is not installed.
    """
    message_class("Report")
    return extra_module(
        "grpc",
        package="grpcio",
        extra="service",
        needs="a driver in another process",
    )


def require_private(address: str, certificates: Certificates | None) -> None:
    """Refuse to listen where others can reach it and need no certificate.

    Raises:
        RequestError: they could.
    """
    if certificates is None and not on_this_machine(address):
        raise RequestError(
            f"listen: {address} is not on this machine: whoever reaches it moves robots; give"
            " certificates (twin cluster certificates DIR makes a folder)"
        )


class ServiceWire:
    """Carries messages to and from the driver that has asked for a robot last.

    Args:
        service: where it asks.
        joints: of the robot.
    """

    def __init__(self, service: Service, joints: int) -> None:
        self._service, self.joints = service, joints
        self._deliver: Deliver = lambda _: None
        self._outbox: queue.Queue[Command | None] | None = None
        self._turn = threading.Lock()

    def open(self, deliver: Deliver) -> None:
        """Begin to carry reports."""
        self._deliver = deliver
        self._service.start()

    def send(self, command: Command) -> None:
        """Carry a command, if somebody has asked for the robot."""
        outbox = self._outbox
        if outbox is not None and outbox.qsize() < _MOST_WAITING:
            outbox.put(command)

    def close(self) -> None:
        """Carry no more, once what was sent is under way."""
        self.connect(None)
        self._service.stop()

    def connect(self, outbox: queue.Queue[Command | None] | None) -> None:
        """Let somebody have what is sent from now on; who had it before gets no more."""
        with self._turn:
            before, self._outbox = self._outbox, outbox
        if before is not None:
            before.put(None)

    def deliver(self, report: Report) -> None:
        """Hand on a report."""
        self._deliver(report)


class Service:
    """A server for some robots' drivers.

    Args:
        address: where it listens, such as ``127.0.0.1:50551``; port 0 for any.
        certificates: of both sides; None where only this machine is listened to.

    Attributes:
        port: at which it listens, once it does.

    Raises:
        RequestError: others would reach it without certificates, it cannot listen there, or gRPC is not
            installed.
    """

    def __init__(self, address: str, certificates: Certificates | None = None) -> None:
        self._grpc = grpc_module()
        require_private(address, certificates)
        self._wires: dict[str, ServiceWire] = {}
        self._running = 0
        self._server = self._grpc.server(
            ThreadPoolExecutor(32, "driver"), options=(("grpc.so_reuseport", 0),)
        )
        handler = self._grpc.stream_stream_rpc_method_handler(self._drive)
        service, _, method = METHOD[1:].partition("/")
        own = self._grpc.method_handlers_generic_handler(service, {method: handler})
        self._server.add_generic_rpc_handlers((own,))
        try:
            self.port = self._listen(address, certificates)
        except RuntimeError as error:
            raise RequestError(f"listen: {address}: {error}") from None

    def _listen(self, address: str, certificates: Certificates | None) -> int:
        if certificates is None:
            return int(self._server.add_insecure_port(address))
        pair = certificates.key.read_bytes(), certificates.certificate.read_bytes()
        secure = self._grpc.ssl_server_credentials(
            (pair,), certificates.authority.read_bytes(), require_client_auth=True
        )
        return int(self._server.add_secure_port(address, secure))

    def wire(self, robot: str, joints: int) -> ServiceWire:
        """Return what carries messages to the driver of a robot."""
        own = self._wires[robot] = ServiceWire(self, joints)
        return own

    def start(self) -> None:
        """Begin to listen; nothing happens where it does."""
        if not self._running:
            self._server.start()
        self._running += 1

    def stop(self) -> None:
        """Stop once nobody needs it any more."""
        self._running -= 1
        if self._running <= 0:
            self._server.stop(1.0).wait()

    def _drive(self, asked: Iterator[bytes], context: Any) -> Iterator[bytes]:
        """Serve one driver: take its reports, and yield what it is told."""
        first = self._next(asked, context.peer())
        if first is None:
            context.abort(self._grpc.StatusCode.INVALID_ARGUMENT, "no valid report")
            return
        wire = self._wires.get(first.robot)
        if wire is None:
            names = ", ".join(sorted(self._wires))
            words = f"no robot {first.robot!r} waits for a driver here: {names}"
            _log.warning("%s: refused: %s", context.peer(), words)
            context.abort(self._grpc.StatusCode.NOT_FOUND, words)
            return
        outbox: queue.Queue[Command | None] = queue.Queue()
        wire.connect(outbox)
        threading.Thread(
            target=self._listen_to,
            args=(asked, wire, first.robot, context.peer(), outbox),
            daemon=True,
        ).start()
        while (command := outbox.get()) is not None:
            yield command_bytes(command)

    def _listen_to(
        self,
        asked: Iterator[bytes],
        wire: ServiceWire,
        robot: str,
        peer: str,
        outbox: queue.Queue[Command | None],
    ) -> None:
        try:
            while (report := self._next(asked, peer, wire.joints)) is not None:
                if report.robot == robot:
                    wire.deliver(report)
        finally:
            outbox.put(None)

    def _next(
        self, asked: Iterator[bytes], peer: str, joints: int | None = None
    ) -> Report | None:
        """Return the next valid report, None where there is no more; what is not valid is left aside."""
        try:
            for content in asked:
                try:
                    return read_report(content, joints)
                except MessageError as error:
                    _log.warning("%s: left aside: %s", peer, error)
        except self._grpc.RpcError:
            pass  # the driver is gone, or its connection
        return None


def certificates_of(folder: str | None, base: Path) -> Certificates | None:
    """Return the certificates that a drivers file names, relative to its folder."""
    from twin.cluster.certificates import certificates_in

    return None if folder is None else certificates_in(base / folder)


def channel_to(address: str, certificates: Certificates | None) -> Any:
    """Return a channel of gRPC to a service.

    Raises:
        RequestError: it is beyond this machine, and there are no certificates.
    """
    grpc = grpc_module()
    if certificates is None:
        if not on_this_machine(address):
            raise RequestError(f"{address} is not on this machine: give --certificates")
        return grpc.insecure_channel(address)
    secure = grpc.ssl_channel_credentials(
        certificates.authority.read_bytes(),
        certificates.key.read_bytes(),
        certificates.certificate.read_bytes(),
    )
    named: Mapping[str, str] = {"grpc.ssl_target_name_override": NAME}
    return grpc.secure_channel(address, secure, options=tuple(named.items()))


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
