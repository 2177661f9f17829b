"""Buttons of the page that run commands on its scenario file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import viser

from twin.trial.run_result import RunResult, read_run
from twin.view.cell_editor import CellEditor
from twin.view.command_process import CommandProcess, command_line

_RESULTS = "view"
"""Folder of the results, beside the scenario file."""


class CommandPanel:
    """Runs plan, run, study and explore on a file, and shows what they print.

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
        self._process = CommandProcess(self._report, self._ended)
        self._keys = gui.add_button_group(
            "Command", ("Plan", "Run", "Study", "Explore")
        )
        self._keys.on_click(lambda _: guarded(self._start))
        cancel = gui.add_button("Cancel", hint="Interrupts the command, as Ctrl-C does")
        cancel.on_click(lambda _: self._process.cancel())
        self._output = gui.add_markdown("")

    def _start(self) -> None:
        if self._editor.unsaved:
            self._editor.save()
        command = self._keys.value.lower()
        arguments = [command, self._editor.path.name, "--out", f"{_RESULTS}/{command}"]
        arguments += {"run": ["--no-recording"], "study": ["-n", "200"]}.get(
            command, []
        )
        self._process.start(arguments, self._folder)

    @property
    def _folder(self) -> Path:
        return self._editor.path.resolve().parent

    def _report(self, arguments: Sequence[str], lines: Sequence[str]) -> None:
        output = "\n".join(lines)
        self._output.content = f"`{command_line(arguments)}`\n\n```\n{output}\n```"

    def _ended(self, arguments: Sequence[str], code: int) -> None:
        words = "completed" if code == 0 else f"ended with exit code {code}"
        self._output.content += f"\n\n**{words}**"
        if arguments[0] == "run" and code == 0:
            self._guarded(lambda: self._play(read_run(self._folder / arguments[3])))
