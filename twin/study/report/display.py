"""Progress of a study on a terminal: how many replications, and how much longer."""

from __future__ import annotations

from rich.progress import (
    MofNCompleteColumn,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from twin.host.progress import StageDisplay


class StudyDisplay(StageDisplay):
    """A line a stage, with how many replications are done and how long the rest will take."""

    def columns(self) -> tuple[ProgressColumn, ...]:
        """Return what stands behind the bar of a stage."""
        return (
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        )
