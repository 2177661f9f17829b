"""Lines of an event log that is still being written: a file that grows, or a pipe."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from planning.errors import OutputError

POLL_S = 0.1
"""Polling interval [s]."""

_PIECE = 1 << 20


def growing_file(
    path: Path, *, wait: bool = True, poll_s: float = POLL_S
) -> Iterator[str | None]:
    """Yield the lines of a file as they are written; None whenever there is no more yet.

    A line counts once its newline is there, so a torn one is waited for.

    Args:
        path: the file; with ``wait`` it need not exist yet.
        wait: go on when the end is reached; otherwise that is the end.
        poll_s: how often to look for more [s].

    Raises:
        OutputError: the file cannot be read, or has become shorter.
    """
    position, rest = 0, b""
    while True:
        try:
            content = _read_from(path, position)
        except FileNotFoundError as error:
            if not wait:
                raise OutputError(f"{path}: no such file") from error
            content = b""
        except OSError as error:
            raise OutputError(f"{path}: cannot be read: {error}") from error
        position += len(content)
        *lines, rest = (rest + content).split(b"\n")
        for line in lines:
            yield line.decode("utf-8", errors="replace")
        if content:
            continue
        if not wait:
            return
        yield None
        time.sleep(poll_s)


def _read_from(path: Path, position: int) -> bytes:
    with path.open("rb") as file:
        size = file.seek(0, 2)
        if size < position:
            raise OutputError(f"{path}: has become shorter: another run began")
        file.seek(position)
        return file.read(_PIECE)


def piped(stream: BinaryIO) -> Iterator[str | None]:
    """Yield the lines that come through a pipe; None whenever there is no more yet.

    What is left without a newline at the end was torn, and is dropped.

    Args:
        stream: such as ``sys.stdin.buffer``.
    """
    lines: queue.Queue[bytes | None] = queue.Queue(maxsize=10_000)

    def read() -> None:
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
