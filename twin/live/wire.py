"""What carries commands to a driver and its reports back; here within this process."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Protocol

from twin.live.driver_end import DriverEnd
from twin.live.wire_format import Command, Report

Deliver = Callable[[Report], None]
"""Is given every report; it may be called from any thread."""


class Wire(Protocol):
    """Carries messages between dispatcher and one driver; any of them may be lost."""

    def open(self, deliver: Deliver) -> None:
        """Begin to carry reports."""
        ...

    def send(self, command: Command) -> None:
        """Carry a command, if that can be; it returns at once."""
        ...

    def close(self) -> None:
        """Carry no more."""
        ...


class LocalWire:
    """Carries messages to and from a driver in this process, which reports again and again.

    Args:
        end: of the driver.
        every_s: time between reports [s].
    """

    def __init__(self, end: DriverEnd, every_s: float = 0.01) -> None:
        self._end, self._every = end, every_s
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self, deliver: Deliver) -> None:
        """Begin to report, in a thread of its own."""

        def report() -> None:
            while not self._over.wait(self._every):
                deliver(self._end.report())

        self._thread = threading.Thread(target=report, daemon=True)
        self._thread.start()

    def send(self, command: Command) -> None:
        """Tell the driver."""
        self._end.receive(command)

    def close(self) -> None:
        """Report no more."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()


def started_now() -> int:
    """Return an instance of a driver that is greater than those of others that were started before."""
    return time.time_ns()
