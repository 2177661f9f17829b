"""Terminal output of a command: progress messages, then the result as JSON or as tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from twin.host.guard import ExitCode, print_error, print_json

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

    from twin.api.checked import Checked
    from twin.host.progress import StageDisplay
    from twin.trial.run_result import RunResult


@dataclass
class View:
    """Output settings of a command.

    Attributes:
        as_json: print JSON only.
        quiet: print errors only.
        compiled: kernels were compiled while progress was displayed.
    """

    as_json: bool = False
    quiet: bool = False
    compiled: bool = field(default=False, init=False)

    @property
    def silent(self) -> bool:
        """True if no progress is displayed."""
        return self.quiet or self.as_json

    @contextmanager
    def progress(self, *, items: bool = False) -> Iterator[StageDisplay]:
        """Display the progress of stages on standard error within the context.

        Args:
            items: show numbers of items and the remaining time of stages, not their shares.

        Yields:
            The display, which is called with the name of a stage, how much of it is done, and its total.
        """
        from twin.host.progress import StageDisplay, show_compilation

        with (
            StageDisplay(
                enabled=not self.silent, columns=_item_columns() if items else ()
            ) as display,
            show_compilation(display, silent=self.silent) as count,
        ):
            yield display
            self.compiled = count() > 0

    def output(self, content: object, show: Callable[[], object]) -> None:
        """Print content as JSON, or call a function that prints it for people, or print nothing."""
        if self.as_json:
            print_json(content)
        elif not self.quiet:
            show()

    def announce_run(self, checked: Checked, folder: Path) -> None:
        """Print the warnings of a check, and scenario and folder of a run, on standard error."""
        from rich.console import Console

        if self.silent:
            return
        if checked.warnings:
            print_error(checked.warning_excerpts)
        case = checked.scenario
        console = Console(stderr=True, highlight=False)
        console.print(
            f"{case.name}: {len(case.robots)} robots, "
            f"{case.steps} steps, seed {case.sections.seed} -> {folder}"
        )

    def show_run(self, done: RunResult) -> int:
        """Print the figures of a run, and return the exit code."""
        from twin.runs.folder import RECORDING
        from twin.runs.summary import print_summary

        folder = done.files
        if self.as_json:
            print_json({"folder": str(folder), **done.summary})
        elif not self.quiet:
            recording = (folder / RECORDING).exists()
            print_summary(
                done.summary, folder, recording=recording, compiled=self.compiled
            )
        if done.outcome == "aborted":
            print_error(f"interrupted; what happened until then is in {folder}")
            return ExitCode.INTERRUPTED
        return ExitCode.COMPLETED if done.passed else ExitCode.FAILED


def _item_columns() -> Sequence[ProgressColumn]:
    """Return columns for stages of many items: number of items, elapsed and remaining time."""
    from rich.progress import (
        MofNCompleteColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    return (
        *(MofNCompleteColumn(), TimeElapsedColumn()),
        *(TextColumn("left"), TimeRemainingColumn()),
    )
