"""Keeping the chatter of compiled libraries off the terminal."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager


@contextmanager
def silenced() -> Iterator[None]:
    """Discard what compiled code prints: PyBullet prints a greeting when it is imported.

    Python's own output goes through the same two files; nothing else should happen inside.
    """
    with ExitStack() as stack:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        stack.callback(os.close, nowhere)
        for number, stream in ((1, sys.stdout), (2, sys.stderr)):
            try:
                stream.flush()
                kept = os.dup(number)
            except (OSError, ValueError):  # closed: there is nothing to silence
                continue
            stack.callback(os.close, kept)
            stack.callback(os.dup2, kept, number)
            os.dup2(nowhere, number)
        yield
