"""Following a running cell: reads its log, flags forbidden events, forecasts the end."""

from __future__ import annotations

import os
import queue
import threading
import time
import urllib.parse
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import NamedTuple, TypeAlias

from planning.errors import OutputError
from planning.files import open_regular
from twin.durations.nanoseconds import NANOSECONDS
from twin.follow.drift import Drift
from twin.follow.forecast import Forecast, Forecaster
from twin.follow.state import FollowedRun, ForbiddenEvent
from twin.runs.events import Event, EventLogError

POLL_S = 0.1
"""Polling interval [s]."""

_CONNECT_S = 10.0
"""How long a server may take to answer [s]."""

_PIECE = 1 << 20
"""Bytes read at once."""

News: TypeAlias = (
    "Event | ForbiddenEvent | UnreadableLine | Forecast | Drift | Silence | FollowedRun"
)
"""An update of a followed run, whose state holds it already; the run itself is the last one."""


def lines_of_growing_file(
    path: Path, *, wait: bool = True, poll_s: float = POLL_S
) -> Iterator[str | None]:
    """Yield the lines of a growing file; None whenever there is no new one.

    A line counts once its newline is there, so a torn one is waited for.

    Args:
        path: the file; with ``wait`` it need not exist yet.
        wait: continue at the end of the file; otherwise stop there.
        poll_s: how often to look for more [s].

    Raises:
        OutputError: the file cannot be read, or has become shorter.
    """
    position, rest, inode = 0, b"", 0
    while True:
        try:
            content, inode = _read_from(path, position, inode)
        except FileNotFoundError as error:
            if not wait:
                raise OutputError(f"{path}: no such file") from error
            content = b""
        except OSError as error:
            raise OutputError(f"{path}: cannot be read: {error}") from error
        position += len(content)
        *lines, rest = (rest + content).split(b"\n")
        if len(rest) > _PIECE:
            raise OutputError(f"{path}: a line is longer than {_PIECE >> 20} MiB")
        for line in lines:
            yield line.decode("utf-8", errors="replace")
        if content:
            continue
        if not wait:
            return
        yield None
        time.sleep(poll_s)


def _read_from(path: Path, position: int, inode: int) -> tuple[bytes, int]:
    """Return the next piece of a file and its inode, which must not change."""
    with open_regular(path) as file:
        about = os.fstat(file.fileno())
        if position and about.st_ino != inode:
            raise OutputError(f"{path}: is another file now: another run began")
        if about.st_size < position:
            raise OutputError(f"{path}: has become shorter: another run began")
        file.seek(position)
        return file.read(_PIECE), about.st_ino


def lines_of_pipe(stream: Iterable[bytes]) -> Iterator[str | None]:
    """Yield the lines of a pipe; None whenever there is no new one.

    What is left without a newline at the end was torn, and is dropped.

    Args:
        stream: such as ``sys.stdin.buffer``.
    """
    lines: queue.Queue[bytes | None] = queue.Queue(maxsize=10_000)

    def read() -> None:
        with suppress(OSError, HTTPException):  # the server is gone
            for line in stream:
                lines.put(line)
        lines.put(None)

    threading.Thread(target=read, daemon=True).start()
    while True:
        try:
            line = lines.get(timeout=POLL_S)
        except queue.Empty:
            yield None
            continue
        if line is None:
            return
        if line.endswith(b"\n"):
            yield line[:-1].decode("utf-8", errors="replace")


def lines_of_server(address: str) -> Iterator[str | None]:
    """Yield the lines of a server; None whenever there is no new one.

    Args:
        address: such as ``http://127.0.0.1:8321/events.jsonl``, of the page of a run.

    Raises:
        OutputError: there is no such log.
    """
    url = urllib.parse.urlsplit(address)
    with ExitStack() as stack:
        try:
            server = HTTPConnection(url.netloc, timeout=_CONNECT_S)
            stack.callback(server.close)
            server.request("GET", url.path or "/")
            answer = server.getresponse()
        except (OSError, ValueError, HTTPException) as error:
            raise OutputError(f"{address}: cannot be read: {error}") from error
        kind = answer.headers.get_content_type()
        if answer.status != HTTPStatus.OK or kind != "application/jsonl":
            raise OutputError(
                f"{address}: no log of events: {answer.status} {answer.reason}, {kind}"
            )
        assert server.sock is not None
        server.sock.settimeout(None)  # hours may pass between two events
        yield from lines_of_pipe(answer)


class UnreadableLine(NamedTuple):
    """A line of the log, counted from 1, that is not an event."""

    number: int
    error: EventLogError


class Silence(NamedTuple):
    """Time since the last event [s]."""

    seconds: float


def follow(
    lines: Iterable[str | None],
    run: FollowedRun,
    forecaster: Forecaster,
    listeners: Sequence[Callable[[News], None]],
    *,
    every_s: float = 2.0,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Follow a run until it ends or there are no more lines.

    There is a forecast before the first event at or after every multiple of ``every_s`` of the
    run's time; drifts are reported with it, once, and again where it has left its interval. While there is nothing to read, the run's time advances with the clock.

    Args:
        lines: lines of the event log; None if there is no new one.
        run: its state, updated by the events.
        forecaster: of the same plan; of another version of it where one takes over.
        listeners: receive all news.
        every_s: time of the run between forecasts [s].
        clock: a clock of seconds.
    """
    every = max(int(every_s * NANOSECONDS), 1)
    due = 0
    heard = clock()
    reported: dict[tuple[str, str], Drift] = {}

    def notify(news: News) -> None:
        for listener in listeners:
            listener(news)

    def make_forecast(now_ns: int) -> None:
        nonlocal due, forecaster
        due = (now_ns // every + 1) * every
        forecaster = forecaster.of(run.tpg)
        notify(forecaster.forecast(run, now_ns))
        for drift in forecaster.drifts(run):
            before = reported.get((drift.what, drift.robot))
            if before is None or not before.low <= drift.ratio <= before.high:
                reported[drift.what, drift.robot] = drift
                notify(drift)

    try:
        number = 0
        for line in lines:
            if line is None:
                silent_s = clock() - heard
                now = run.now_ns + int(silent_s * NANOSECONDS)
                if run.events and now >= due:
                    make_forecast(now)
                notify(Silence(silent_s))
                continue
            number += 1
            heard = clock()
            if not line.strip():
                continue
            try:
                event = Event.parse(line)
            except EventLogError as error:
                notify(UnreadableLine(number, error))
                continue
            if event.t_ns >= due and not run.outcome:
                make_forecast(max(event.t_ns // every * every, run.now_ns))
            found = run.apply(event)
            notify(event)
            for violation in found:
                notify(violation)
            if run.outcome:
                break
    finally:
        notify(run)
