"""The twin of a running cell: follows its events, flags what must not be, forecasts the end."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence

from twin.durations import NANOSECONDS
from twin.follow.forecast import Forecast, Forecaster
from twin.follow.state import FollowedRun, Violation
from twin.run.event_log import EventLogError, parse_event
from twin.run.events import Event


class Onlooker:
    """Something that shows or keeps what is seen of a run; each kind overrides what it wants."""

    def event(self, event: Event, run: FollowedRun) -> None:
        """Take note of an event, which the state of the run holds already."""

    def violation(self, violation: Violation) -> None:
        """Take note of something that should not have happened."""

    def unreadable(self, number: int, error: EventLogError) -> None:
        """Take note of a line, counted from 1, that is no event."""

    def forecast(self, forecast: Forecast, run: FollowedRun) -> None:
        """Take note of how the run will end."""

    def waiting(self, run: FollowedRun, silent_s: float) -> None:
        """Take note that there has been no event for a time."""

    def close(self, run: FollowedRun) -> None:
        """Finish; called once."""


def follow(
    lines: Iterable[str | None],
    run: FollowedRun,
    forecaster: Forecaster,
    onlookers: Sequence[Onlooker],
    *,
    every_s: float = 2.0,
    clock: Callable[[], float] = time.monotonic,
) -> FollowedRun:
    """Follow a run until it ends or there are no more lines.

    There is a forecast before the first event at or after every multiple of ``every_s`` of the
    run's time. While there is nothing to read, the run's time goes on with the clock.

    Args:
        lines: of the event log; None stands for nothing to read yet.
        run: its state, which is kept equal to the events.
        forecaster: of the same plan.
        onlookers: told of everything.
        every_s: time of the run between forecasts [s].
        clock: a clock of seconds.

    Returns:
        The run.
    """
    every = max(int(every_s * NANOSECONDS), 1)
    due = 0
    heard = clock()
    number = 0

    def foresee(now_ns: int) -> None:
        nonlocal due
        due = (now_ns // every + 1) * every
        forecast = forecaster.forecast(run, now_ns)
        for onlooker in onlookers:
            onlooker.forecast(forecast, run)

    try:
        for line in lines:
            if line is None:
                silent_s = clock() - heard
                now = run.now_ns + int(silent_s * NANOSECONDS)
                if run.events and now >= due:
                    foresee(now)
                for onlooker in onlookers:
                    onlooker.waiting(run, silent_s)
                continue
            number += 1
            heard = clock()
            if not line.strip():
                continue
            try:
                event = parse_event(line)
            except EventLogError as error:
                for onlooker in onlookers:
                    onlooker.unreadable(number, error)
                continue
            if event.t_ns >= due and not run.outcome:
                foresee(max(event.t_ns // every * every, run.now_ns))
            found = run.apply(event)
            for onlooker in onlookers:
                onlooker.event(event, run)
                for violation in found:
                    onlooker.violation(violation)
            if run.outcome:
                break
    finally:
        for onlooker in onlookers:
            onlooker.close(run)
    return run
