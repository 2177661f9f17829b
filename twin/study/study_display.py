"""The progress of a study on a terminal: how many replications, and how much longer."""

from __future__ import annotations

import sys
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


class StudyDisplay:
    """A line a stage on standard error; nothing when that is no terminal or not wanted.

    Args:
        enabled: show anything at all.
    """

    def __init__(self, *, enabled: bool = True) -> None:
        self._live = enabled and sys.stderr.isatty()
        self._stages: dict[str, TaskID] = {}
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description:<24}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            disable=not self._live,
        )

    def __enter__(self) -> StudyDisplay:
        """Start to draw."""
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take the lines away again."""
        self._progress.stop()

    def __call__(self, stage: str, done: float, total: float) -> None:
        """Show how far a stage has come; the first call of a stage adds its line."""
        if not self._live:
            return
        if stage not in self._stages:
            self._stages[stage] = self._progress.add_task(stage, total=total)
        self._progress.update(self._stages[stage], completed=done, total=total)
