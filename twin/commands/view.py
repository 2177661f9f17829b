"""Output of a command: progress, then JSON or tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from twin.host.guard import print_json

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

    from twin.host.progress import StageDisplay


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
    def progress(
        self, columns: Callable[[], Sequence[ProgressColumn]] = tuple
    ) -> Iterator[StageDisplay]:
        """Display the progress of stages on standard error within the context.

        Args:
            columns: returns the columns behind the bar of a stage; by default its share and seconds.

        Yields:
            The display, which is called with the name of a stage, how much of it is done, and its total.
        """
        from twin.host.progress import StageDisplay, show_compilation

        with (
            StageDisplay(enabled=not self.silent, columns=columns()) as display,
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


def count_columns() -> Sequence[ProgressColumn]:
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
