"""Reader of a growing event log: yields new lines from a file, a pipe or an HTTP server."""

from __future__ import annotations

import os
import queue
import threading
import time
import urllib.parse
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from pathlib import Path

from planning.errors import OutputError
from planning.files import open_regular

POLL_S = 0.1
"""Polling interval [s]."""

_CONNECT_S = 10.0
"""How long a server may take to answer [s]."""

_PIECE = 1 << 20
"""Bytes read at once."""


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
