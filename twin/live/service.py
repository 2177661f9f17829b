"""gRPC service for drivers in other processes, in any language; and its client."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from planning.errors import RequestError
from twin.cluster.address import on_this_machine
from twin.cluster.certificates import Certificates
from twin.host.extras import extra_module
from twin.live.driver_end import Deliver, DriverEnd
from twin.live.messages import Command, Report
from twin.live.report_checks import plain_text
from twin.live.wire_format import (
    MOST_BYTES,
    MessageError,
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

_SILENT_S = 5.0
"""A stream in which no report has come for so long is closed [s]."""

_MOST_UNNAMED = 8
"""So many streams may be open that have not named a robot; the oldest is closed for a further one."""

_MOST_STREAMS = 64
"""So many streams may be open; further ones are refused."""

_MOST_REFUSED = 5
"""Largest number of reported invalid messages of a stream."""

_log = logging.getLogger(__name__)

_AGAIN_S = 0.2
"""How long it waits before it asks again [s]."""


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
    """Refuse to listen on a public address without certificates.

    Raises:
        RequestError: they could.
    """
    if certificates is None and not on_this_machine(address):
        raise RequestError(
            f"listen: {address} is not on this machine: whoever reaches it moves robots; give"
            " certificates (twin cluster certificates DIR makes a folder)"
        )


class ServiceWire:
    """Transport to the driver that connected last for a robot.

    Args:
        service: where it asks.
        joints: of the robot.
    """

    def __init__(self, service: Service, joints: int) -> None:
        self._service, self.joints = service, joints
        self._deliver: Deliver = lambda _: None
        self._outbox: queue.Queue[Command | str | None] | None = None
        self._turn = threading.Lock()

    def open(self, deliver: Deliver) -> None:
        """Start to transport reports."""
        self._deliver = deliver
        self._service.start()

    def send(self, command: Command) -> None:
        """Send a command, if a driver is connected."""
        outbox = self._outbox
        if outbox is not None and outbox.qsize() < _MOST_WAITING:
            outbox.put(command)

    def close(self) -> None:
        """Close the transport after pending messages are sent."""
        self.connect(None)
        self._service.stop()

    def connect(self, outbox: queue.Queue[Command | str | None] | None) -> None:
        """Connect a new driver's stream in place of the earlier one."""
        with self._turn:
            before, self._outbox = self._outbox, outbox
        if before is not None:
            before.put(None)

    def deliver(self, report: Report) -> None:
        """Pass on a report."""
        self._deliver(report)


@dataclass(eq=False)
class _DriverStream:
    """A stream opened by a driver.

    Attributes:
        context: of the call.
        heard_s: when the last report came in it, or when it was opened [s].
        robot: that it has named, empty before.
        outbox: messages to send; a text closes the stream with that cause, None without.
        refused: messages in it that were none.
    """

    context: Any
    heard_s: float = field(default_factory=time.monotonic)
    robot: str = ""
    outbox: queue.Queue[Command | str | None] = field(default_factory=queue.Queue)
    refused: int = 0


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
        self._streams: list[_DriverStream] = []
        self._turn, self._over = threading.Lock(), threading.Event()
        options = (
            ("grpc.so_reuseport", 0),
            ("grpc.max_receive_message_length", MOST_BYTES),
        )
        # A stream takes a thread until it is closed.
        pool = ThreadPoolExecutor(_MOST_STREAMS, "driver")
        self._server = self._grpc.server(
            pool, options=options, maximum_concurrent_rpcs=_MOST_STREAMS
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
        """Return the transport to the driver of a robot."""
        own = self._wires[robot] = ServiceWire(self, joints)
        return own

    def start(self) -> None:
        """Start to listen, unless already listening."""
        if not self._running:
            self._server.start()
            threading.Thread(target=self._close_silent, daemon=True).start()
        self._running += 1

    def stop(self) -> None:
        """Stop when no session uses it."""
        self._running -= 1
        if self._running <= 0:
            self._over.set()
            self._server.stop(1.0).wait()

    def _drive(self, asked: Iterator[bytes], context: Any) -> Iterator[bytes]:
        """Serve one driver: receive its reports, and yield its commands."""
        stream = _DriverStream(context)
        self._make_room(stream)
        try:
            yield from self._serve(asked, stream)
        finally:
            with self._turn:
                self._streams.remove(stream)

    def _serve(self, asked: Iterator[bytes], stream: _DriverStream) -> Iterator[bytes]:
        context, codes = stream.context, self._grpc.StatusCode
        first = self._next(asked, stream)
        if first is None:
            context.abort(codes.INVALID_ARGUMENT, "no valid report")
            return
        wire = self._wires.get(first.robot)
        if wire is None:
            names = ", ".join(sorted(self._wires))
            robot = plain_text(first.robot, 60)
            words = f"no robot {robot!r} waits for a driver here: {names}"
            _log.warning("%s: refused: %s", context.peer(), words)
            context.abort(codes.NOT_FOUND, words)
            return
        stream.robot = first.robot
        wire.connect(stream.outbox)
        threading.Thread(
            target=self._listen_to, args=(asked, wire, stream), daemon=True
        ).start()
        while (message := stream.outbox.get()) is not None:
            if isinstance(message, str):
                context.abort(codes.INVALID_ARGUMENT, message)
                return
            yield command_bytes(message)

    def _listen_to(
        self, asked: Iterator[bytes], wire: ServiceWire, stream: _DriverStream
    ) -> None:
        end: str | None = None
        try:
            while (report := self._next(asked, stream, wire.joints)) is not None:
                if report.robot != stream.robot:
                    robot = plain_text(report.robot, 60)
                    end = f"this stream is of {stream.robot}, not of {robot!r}"
                    break
                wire.deliver(report)
        finally:
            stream.outbox.put(end)

    def _next(
        self, asked: Iterator[bytes], stream: _DriverStream, joints: int = 0
    ) -> Report | None:
        """Return the next report, None at the end; invalid messages are skipped."""
        try:
            for content in asked:
                try:
                    report = read_report(content, joints)
                except MessageError as error:
                    stream.refused += 1
                    if stream.refused <= _MOST_REFUSED:
                        peer, words = stream.context.peer(), plain_text(str(error))
                        _log.warning("%s: ignored: %s", peer, words)
                else:
                    stream.heard_s = time.monotonic()
                    return report
        except self._grpc.RpcError:
            pass  # the driver is gone, or its connection
        return None

    def _make_room(self, stream: _DriverStream) -> None:
        """Admit a stream, closing the oldest unnamed ones beyond the limit."""
        with self._turn:
            self._streams.append(stream)
            unnamed = [own for own in self._streams if not own.robot]
        for own in unnamed[:-_MOST_UNNAMED]:
            own.context.cancel()

    def _close_silent(self) -> None:
        """Close idle streams, until the service stops."""
        while not self._over.wait(_SILENT_S / 10.0):
            with self._turn:
                streams = list(self._streams)
            for own in streams:
                if time.monotonic() - own.heard_s > _SILENT_S:
                    words = f"no report for {_SILENT_S:g} s"
                    _log.warning("%s: closed: %s", own.context.peer(), words)
                    own.context.cancel()
                    own.outbox.put(None)


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
    # By default gRPC waits ever longer, up to two minutes, which is more than a cell waits for a driver.
    options = [("grpc.max_reconnect_backoff_ms", 1000)]
    if certificates is None:
        if not on_this_machine(address):
            raise RequestError(f"{address} is not on this machine: give --certificates")
        return grpc.insecure_channel(address, options=options)
    secure = grpc.ssl_channel_credentials(
        certificates.authority.read_bytes(),
        certificates.key.read_bytes(),
        certificates.certificate.read_bytes(),
    )
    named = ("grpc.ssl_target_name_override", NAME)
    return grpc.secure_channel(address, secure, options=[*options, named])


def drive_remotely(
    end: DriverEnd,
    address: str,
    certificates: Certificates | None = None,
    *,
    every_s: float = 0.02,
    patience_s: float = 60.0,
    over: Callable[[], bool] = lambda: False,
) -> None:
    """Drive a robot for a cell until the session ends.

    Args:
        end: of the driver.
        address: of the cell, such as ``127.0.0.1:50551``.
        certificates: of both sides; None for a cell on this machine.
        every_s: time between reports [s].
        patience_s: how long it asks for a cell that is not there [s].
        over: returns whether to end early.

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
                message: Any = error
                if message.code() in refused:
                    raise RequestError(f"{address}: {message.details()}") from None
                if time.monotonic() - heard > patience_s:
                    raise RequestError(
                        f"{address}: no cell for {patience_s:g} s: {message.details()}"
                    ) from None
            time.sleep(_AGAIN_S)


def _take(end: DriverEnd, content: bytes) -> None:
    try:
        end.receive(read_command(content))
    except MessageError:
        return  # it comes again
