"""Following a running cell: applies its events, flags forbidden ones, forecasts the end."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence

from twin.durations import NANOSECONDS
from twin.follow.forecast import Forecast, Forecaster
from twin.follow.state import FollowedRun, Violation
from twin.run.events import Event, EventLogError, parse_event


class RunListener:
    """Listener to a followed run; each kind overrides what it shows or keeps."""

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
    listeners: Sequence[RunListener],
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
        listeners: told of everything.
        every_s: time of the run between forecasts [s].
        clock: a clock of seconds.

    Returns:
        The run.
    """
    every = max(int(every_s * NANOSECONDS), 1)
    due = 0
    heard = clock()
    number = 0

    def make_forecast(now_ns: int) -> None:
        nonlocal due
        due = (now_ns // every + 1) * every
        forecast = forecaster.forecast(run, now_ns)
        for listener in listeners:
            listener.forecast(forecast, run)

    try:
        for line in lines:
            if line is None:
                silent_s = clock() - heard
                now = run.now_ns + int(silent_s * NANOSECONDS)
                if run.events and now >= due:
                    make_forecast(now)
                for listener in listeners:
                    listener.waiting(run, silent_s)
                continue
            number += 1
            heard = clock()
            if not line.strip():
                continue
            try:
                event = parse_event(line)
            except EventLogError as error:
                for listener in listeners:
                    listener.unreadable(number, error)
                continue
            if event.t_ns >= due and not run.outcome:
                make_forecast(max(event.t_ns // every * every, run.now_ns))
            found = run.apply(event)
            for listener in listeners:
                listener.event(event, run)
                for violation in found:
                    listener.violation(violation)
            if run.outcome:
                break
    finally:
        for listener in listeners:
            listener.close(run)
    return run
