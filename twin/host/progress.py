"""Progress of long computations: callbacks, seconds per stage, and a terminal display."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    ProgressColumn,
    SpinnerColumn,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.progress import Progress as RichProgress

from planning.progress import Progress

Report = Callable[[str, float, float], None]
"""Called with the name of a stage, how much of it is done, and how much there is in all."""


def report_nothing(stage: str, done: float, total: float) -> None:
    """Ignore progress."""


@dataclass
class StageWatch:
    """Measures and reports the stages of planning.

    Attributes:
        report: receives the progress of each stage.
        seconds: seconds that each stage took; a stage entered again adds up.
        clock: returns the time, by default wall-clock [s].
    """

    report: Report = report_nothing
    seconds: dict[str, float] = field(default_factory=dict)
    clock: Callable[[], float] = time.perf_counter

    @contextmanager
    def stage(self, key: str, label: str | None = None) -> Iterator[None]:
        """Measure a stage; with a label, show it as one piece of work."""
        start = self.clock()
        if label is not None:
            self.report(label, 0, 1)
        try:
            yield
        finally:
            elapsed = self.clock() - start
            self.seconds[key] = self.seconds.get(key, 0.0) + elapsed
        if label is not None:
            self.report(label, 1, 1)

    def reporter(self, label: str) -> Progress:
        """Return a callback that shows the progress of a stage: done, and total."""
        return partial(self.report, label)


class StageDisplay:
    """A line a stage on standard error; nothing when that is no terminal or not wanted.

    Args:
        enabled: show anything.
        columns: columns after the bar of a stage; by default a share and the elapsed time.
    """

    def __init__(
        self, *, enabled: bool = True, columns: Sequence[ProgressColumn] = ()
    ) -> None:
        """Prepare the display; nothing is shown yet."""
        share = (TaskProgressColumn("{task.percentage:>3.0f} %"), TimeElapsedColumn())
        self._live = enabled and sys.stderr.isatty()
        self._stages: dict[str, TaskID] = {}
        self._progress = RichProgress(
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
        """Remove the lines."""
        self._progress.stop()

    def say(self, text: str) -> None:
        """Print a line on standard error, terminal or not."""
        self._progress.console.print(text, highlight=False)

    def count(self, what: str, so_far: int, *, done: bool) -> None:
        """Show a counter without a total; hide it when done."""
        if not self._live:
            return
        if what not in self._stages:
            self._stages[what] = self._progress.add_task(what, total=None)
        self._progress.update(
            self._stages[what], description=f"{what}: {so_far}", visible=not done
        )

    def __call__(self, stage: str, done: float, total: float) -> None:
        """Show the progress of a stage; the first call of a stage adds its line.

        A stage that was done and starts again keeps its line and starts its clock again.
        """
        if not self._live:
            return
        if stage not in self._stages:
            self._stages[stage] = self._progress.add_task(stage, total=total)
        elif done == 0:
            self._progress.reset(self._stages[stage], total=total)
        self._progress.update(self._stages[stage], completed=done, total=total)


@contextmanager
def show_compilation(
    display: StageDisplay, *, silent: bool
) -> Iterator[Callable[[], int]]:
    """Show the number of kernels compiled meanwhile, which delay a first run.

    Meshes that are cut into convex pieces for the first time are named, too.

    Args:
        display: where they are counted.
        silent: whether to show nothing.

    Yields:
        What returns their number so far; those that are cached are only loaded.
    """
    from planning.kernels import watch_compilation
    from planning.meshes.mesh_loading import watch_cutting

    count = 0

    def begin() -> None:
        nonlocal count
        if count == 0 and not silent:
            display.say("compiling kernels, once ...")
        count += 1
        display.count("compiling kernels", count, done=False)

    def end() -> None:
        display.count("compiling kernels", count, done=True)

    def cutting(path: Path) -> None:
        if not silent:
            display.say(f"cutting {path.name} into convex pieces, once ...")

    with watch_compilation(begin, end), watch_cutting(cutting):
        yield lambda: count
