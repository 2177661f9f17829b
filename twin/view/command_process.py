"""Commands of the program that the page runs, each in a process of its own."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from planning.errors import RequestError

_LAST_LINES = 12
"""Number of lines of output that are shown."""


class CommandProcess:
    """Runs one command at a time.

    Args:
        report: called with the arguments and the last lines of output while a command runs.
        ended: called with the arguments and the exit code when a command has ended.
    """

    def __init__(
        self,
        report: Callable[[Sequence[str], Sequence[str]], None],
        ended: Callable[[Sequence[str], int], None],
    ) -> None:
        self._report, self._ended = report, ended
        self._process: subprocess.Popen[str] | None = None

    def start(self, arguments: Sequence[str], folder: Path) -> None:
        """Run ``twin`` with arguments in a folder.

        Raises:
            RequestError: another command is running.
        """
        if self._process is not None:
            raise RequestError("a command is running: cancel it, or wait for its end")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "twin.cli", *arguments],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
            env={**os.environ, "COLUMNS": "100", "NO_COLOR": "1"},
        )
        threading.Thread(
            target=self._follow, args=[self._process, tuple(arguments)], daemon=True
        ).start()

    def cancel(self) -> None:
        """Interrupt the command, as Ctrl-C does."""
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGINT)

    def _follow(self, process: subprocess.Popen[str], arguments: Sequence[str]) -> None:
        lines: list[str] = []
        self._report(arguments, lines)
        assert process.stdout is not None
        for line in process.stdout:
            lines = [*lines, line.rstrip()][-_LAST_LINES:]
            self._report(arguments, lines)
        code = process.wait()
        self._process = None
        self._ended(arguments, code)


def command_line(arguments: Sequence[str]) -> str:
    """Return a command as it is typed."""
    return shlex.join(["twin", *arguments])
