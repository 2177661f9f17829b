"""Windows of time between two steps: glue that must be pressed while it is wet, a part that must cool.

In the terms of project scheduling they are time lags from the end of one activity to the start of another,
a least and a greatest one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

EARLIER = -1
"""In place of the index of a task that was done before the plan begins."""


@dataclass(frozen=True)
class TimeLag:
    """How long after an earlier step a step may begin, and must have begun.

    Attributes:
        step: name of the earlier step.
        least: time that passes at least [s].
        most: time that may pass at most, None for any [s].
        machine: chain of the task that lasts for the least time, None where there is none to wait for.
    """

    step: str
    least: float = 0.0
    most: float | None = None
    machine: str | None = None


@dataclass(frozen=True)
class TimeWindow:
    """Time from the end of a task to the start of another, within which it must lie.

    The least time is kept by a task that lasts as long, so by the graph. The greatest one is not: it is
    planned for, held back for, and told of.

    Attributes:
        begun: index of the task with which the work of the earlier step begins; EARLIER where that was before
            the plan.
        done: index of the task with which that step is complete: its end opens the window; EARLIER likewise.
        due: index of the task whose start must lie in the window.
        least: [s].
        most: None for any [s].
        words: the two steps, for people.
        ago: how long before the begin of the plan the window was opened, where that is so [s].
    """

    begun: int
    done: int
    due: int
    least: float
    most: float | None
    words: str
    ago: float = 0.0

    @property
    def own(self) -> frozenset[int]:
        """The tasks of the plan that it is about."""
        return frozenset({self.begun, self.done, self.due} - {EARLIER})

    def moved(self, new: Callable[[int], int]) -> TimeWindow:
        """Return it with other indices of tasks."""

        def index(task: int) -> int:
            return task if task == EARLIER else new(task)

        begun, done, due = map(index, (self.begun, self.done, self.due))
        return replace(self, begun=begun, done=done, due=due)
