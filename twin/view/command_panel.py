"""Buttons of the page that run commands on its scenario file, each in a process of its own."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path

import viser

from planning.errors import RequestError
from twin.trial.run_result import RunResult, read_run
from twin.view.cell_editor import CellEditor

_RESULTS = "view"
"""Folder of the results, beside the scenario file."""

_OPTIONS = {"run": ("--no-recording",), "study": ("-n", "200")}

_LAST_LINES = 12
"""Number of lines of output that are shown."""


class CommandPanel:
    """Runs plan, run, study and explore on a file, one at a time, and shows what they print.

    Args:
        gui: where the buttons come.
        editor: the file; it is saved first.
        guarded: calls a function, and shows its error.
        play: plays a run on the page.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        editor: CellEditor,
        guarded: Callable[[Callable[[], object]], None],
        play: Callable[[RunResult], None],
    ) -> None:
        self._editor, self._guarded, self._play = editor, guarded, play
        self._process: subprocess.Popen[str] | None = None
        keys = gui.add_button_group("Command", ("Plan", "Run", "Study", "Explore"))
        keys.on_click(lambda _: guarded(lambda: self._start(keys.value.lower())))
        cancel = gui.add_button("Cancel", hint="Interrupts the command, as Ctrl-C does")
        cancel.on_click(lambda _: self._cancel())
        self._output = gui.add_markdown("")

    def _start(self, command: str) -> None:
        if self._process is not None:
            raise RequestError("a command is running: cancel it, or wait for its end")
        if self._editor.unsaved:
            self._editor.save()
        out = Path(_RESULTS) / command
        file = self._editor.path.resolve()
        options = _OPTIONS.get(command, ())
        arguments = [command, file.name, "--out", str(out), *options]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "twin.cli", *arguments],
            cwd=file.parent,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
            env={**os.environ, "COLUMNS": "100", "NO_COLOR": "1"},
        )
        done = file.parent / out if command == "run" else None
        line = shlex.join(["twin", *arguments])
        threading.Thread(
            target=self._follow, args=[self._process, line, done], daemon=True
        ).start()

    def _cancel(self) -> None:
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGINT)

    def _follow(
        self, process: subprocess.Popen[str], command: str, run: Path | None
    ) -> None:
        """Show what a command prints, how it ends, and the run that it leaves."""
        lines: deque[str] = deque(maxlen=_LAST_LINES)
        assert process.stdout is not None
        self._output.content = f"`{command}`"
        for line in process.stdout:
            lines.append(line.rstrip())
            output = "\n".join(lines)
            self._output.content = f"`{command}`\n\n```\n{output}\n```"
        code = process.wait()
        self._process = None
        words = "completed" if code == 0 else f"ended with exit code {code}"
        self._output.content += f"\n\n**{words}**"
        if run is not None and code == 0:
            self._guarded(lambda: self._play(read_run(run)))
