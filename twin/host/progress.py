"""Progress reports of long-running work, and their display on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
)

Report = Callable[[str, float, float], None]
"""Called with the name of a stage, how much of it is done, and how much there is in all."""


def report_nothing(stage: str, done: float, total: float) -> None:
    """Ignore progress."""


def of_stage(report: Report, stage: str) -> Callable[[float, float], None]:
    """Return a callback for the progress of one stage: done, and total."""
    return lambda done, total: report(stage, done, total)


class StageDisplay:
    """A line a stage on standard error; nothing when that is no terminal or not wanted.

    Args:
        enabled: show anything.
        columns: what stands behind the bar of a stage; by default a share and the time it took.
    """

    def __init__(
        self, *, enabled: bool = True, columns: Sequence[ProgressColumn] = ()
    ) -> None:
        """Show nothing yet."""
        share = (TaskProgressColumn("{task.percentage:>3.0f} %"), TimeElapsedColumn())
        self._live = enabled and sys.stderr.isatty()
        self._stages: dict[str, TaskID] = {}
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description:<24}"),
            BarColumn(bar_width=30),
            *(columns or share),
            console=Console(stderr=True),
            transient=True,
            disable=not self._live,
        )

    def __enter__(self) -> Self:
        """Start to draw."""
        self._progress.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Take the lines away again."""
        self._progress.stop()

    def say(self, text: str) -> None:
        """Print a line on standard error, terminal or not."""
        self._progress.console.print(text, highlight=False)

    def count(self, what: str, so_far: int, *, done: bool) -> None:
        """Show how many there are of something, nobody knows of how many; hide it when done."""
        if not self._live:
            return
        if what not in self._stages:
            self._stages[what] = self._progress.add_task(what, total=None)
        self._progress.update(
            self._stages[what], description=f"{what}: {so_far}", visible=not done
        )

    def __call__(self, stage: str, done: float, total: float) -> None:
        """Show how far a stage has come; the first call of a stage adds its line.

        A stage that was done and starts again keeps its line and starts its clock again.
        """
        if not self._live:
            return
        if stage not in self._stages:
            self._stages[stage] = self._progress.add_task(stage, total=total)
        elif done == 0:
            self._progress.reset(self._stages[stage], total=total)
        self._progress.update(self._stages[stage], completed=done, total=total)
