"""Driver side of a session: receives commands, which may be late, duplicated or lost, and sends reports."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import islice
from typing import Protocol

import numpy as np

from twin.drivers.driver import Driver, DriverState, Sample
from twin.live.messages import Command, Report
from twin.live.wire_format import MOST_SAMPLES

_AGAIN_S = 0.5
"""Time after which unacknowledged samples are resent [s]."""

_MOST = 50_000
"""Largest number of buffered unacknowledged samples."""

Deliver = Callable[[Report], None]
"""Is given every report; it may be called from any thread."""


class UnacknowledgedSamples:
    """Samples, numbered from 0 on, that are sent until acknowledged."""

    def __init__(self) -> None:
        self.kept = 0
        """Number of the oldest one that is left."""
        self._samples: deque[Sample] = deque()
        self._sent = 0
        self._again_s = -math.inf

    def add(self, samples: Iterable[Sample]) -> None:
        """Append samples."""
        self._samples += samples
        while len(self._samples) > _MOST:
            self._drop()

    def acknowledge(self, count: int) -> None:
        """Drop acknowledged samples; without an acknowledgement all kept ones are sent.

        Args:
            count: the number of the next one that it wants.
        """
        if not count:
            self._sent = self.kept
        while self._samples and self.kept < count:
            self._drop()

    def to_send(self, now_s: float) -> tuple[int, tuple[Sample, ...]]:
        """Return the samples to send now, with the number of the first."""
        if now_s - self._again_s >= _AGAIN_S:
            self._sent, self._again_s = self.kept, now_s
        first = max(self._sent, self.kept)
        skip = first - self.kept
        message = tuple(islice(self._samples, skip, skip + MOST_SAMPLES))
        self._sent = first + len(message)
        return first, message

    def _drop(self) -> None:
        self._samples.popleft()
        self.kept += 1


class DriverEnd:
    """State of a session on the side of the driver.

    Args:
        driver: the robot.
        robot: its name in the plan.
        instance: number that increases with every restart, such as the time.
        clock: returns the time, counted from anywhere [s].
    """

    def __init__(
        self,
        driver: Driver,
        robot: str,
        instance: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._driver, self._robot, self._instance = driver, robot, instance
        self._clock = clock
        self._session = ""
        self._number = self._seen = self._version = self._have = 0
        self._held, self._ordered = False, ""
        self._samples = UnacknowledgedSamples()
        self._turn = threading.RLock()
        self._left = False

    @property
    def left(self) -> bool:
        """Whether the session has ended."""
        return self._left

    def receive(self, command: Command) -> None:
        """Execute a command, unless it is for another robot or session, or outdated."""
        with self._turn:
            self._receive(command)

    def _receive(self, command: Command) -> None:
        # Commands sent before this driver connected may be outdated.
        meant = (command.robot, command.instance) == (self._robot, self._instance)
        if not meant or self.left:
            return
        if self._session not in ("", command.session) or command.number <= self._seen:
            return
        if not self._session:
            self._session, self._have = command.session, command.done
            self._driver.begin(np.asarray(command.start), command.done)
        self._seen = command.number
        self._samples.acknowledge(command.heard)
        self._take(command)
        if command.tool is not None and command.tool.name != self._ordered:
            self._ordered = command.tool.name
            self._driver.act(command.tool)
        if command.held != self._held:
            self._held = command.held
            self._driver.hold(command.held)
        if command.leave:
            self._left = True
            self._driver.leave()

    def _take(self, command: Command) -> None:
        """Accept new nodes, if none is missing before them."""
        failed = self._sample_state().failed
        if failed >= 0:
            # What was to come after it is of a graph that is not executed any more.
            if command.version <= self._version:
                return
            self._have = failed + 1
        fresh = [node for node in command.nodes if node.node >= self._have]
        if fresh and fresh[0].node == self._have:
            self._driver.take(fresh)
            self._have += len(fresh)
            self._version = max(self._version, command.version)

    def _sample_state(self) -> DriverState:
        """Return the state of the robot; its samples go into the next report."""
        state = self._driver.state()
        if self._session:
            alone = Sample(self._clock(), state.q, state.begun, state.done)
            self._samples.add(state.samples or (alone,))
        return state

    def report(self) -> Report:
        """Return the current report, which is also a heartbeat."""
        with self._turn:
            return self._report()

    def _report(self) -> Report:
        now_s, state = self._clock(), self._sample_state()
        self._number += 1
        first, samples = self._samples.to_send(now_s)
        state = replace(state, samples=samples)
        have = self._have if state.failed < 0 else state.failed + 1
        return Report(
            self._session,
            self._robot,
            self._instance,
            self._number,
            now_s,
            self._seen,
            self._version,
            have,
            state,
            first,
            self._samples.kept,
        )


class Wire(Protocol):
    """Transport of messages between dispatcher and one driver; messages may be lost."""

    def open(self, deliver: Deliver) -> None:
        """Start to transport reports."""
        ...

    def send(self, command: Command) -> None:
        """Send a command without blocking, if connected."""
        ...

    def close(self) -> None:
        """Close the transport."""
        ...


class LocalWire:
    """Transport to a driver in this process, which reports periodically.

    Args:
        end: of the driver.
        every_s: time between reports [s].
    """

    def __init__(self, end: DriverEnd, every_s: float = 0.01) -> None:
        self._end, self._every = end, every_s
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self, deliver: Deliver) -> None:
        """Start to report, in a thread of its own."""

        def report() -> None:
            while not self._over.wait(self._every):
                deliver(self._end.report())

        self._thread = threading.Thread(target=report, daemon=True)
        self._thread.start()

    def send(self, command: Command) -> None:
        """Pass a command to the driver."""
        self._end.receive(command)

    def close(self) -> None:
        """Stop reporting."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()


def new_instance_number() -> int:
    """Return an instance number greater than those of drivers started earlier."""
    return time.time_ns()
