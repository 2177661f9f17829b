"""Monitoring of a running cell: reads its events, reports violations of the plan, and forecasts the end of the run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypeAlias

from twin.durations.nanoseconds import NANOSECONDS
from twin.follow.drift import Drift
from twin.follow.forecast import Forecast, Forecaster
from twin.follow.state import FollowedRun, ForbiddenEvent
from twin.runs.events import Event, EventLogError

News: TypeAlias = (
    "Event | ForbiddenEvent | UnreadableLine | Forecast | Drift | Silence | FollowedRun"
)
"""Update of a followed run. The state of the run already contains it. The last update is the run itself."""


class UnreadableLine(NamedTuple):
    """A line of the log, counted from 1, that is not an event."""

    number: int
    error: EventLogError


class Silence(NamedTuple):
    """Time since the last event [s]."""

    seconds: float


def follow(
    lines: Iterable[str | None],
    run: FollowedRun,
    forecaster: Forecaster,
    listeners: Sequence[Callable[[News], None]],
    *,
    every_s: float = 2.0,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Follow a run until it ends or there are no more lines.

    A forecast is made before the first event at or after every multiple of ``every_s`` of the run's time. Drifts are
    reported together with it: once, and again if the ratio of a drift leaves the interval reported before. While there
    is nothing to read, the run's time advances with the clock.

    Args:
        lines: lines of the event log; None if there is no new one.
        run: its state, updated by the events.
        forecaster: of the same plan; of another version of it where one takes over.
        listeners: receive all news.
        every_s: time of the run between forecasts [s].
        clock: a clock of seconds.
    """
    every = max(int(every_s * NANOSECONDS), 1)
    due = 0
    heard = clock()
    reported: dict[tuple[str, str], Drift] = {}

    def notify(news: News) -> None:
        for listener in listeners:
            listener(news)

    def make_forecast(now_ns: int) -> None:
        nonlocal due, forecaster
        due = (now_ns // every + 1) * every
        forecaster = forecaster.of(run.tpg)
        notify(forecaster.forecast(run, now_ns))
        for drift in forecaster.drifts(run):
            before = reported.get((drift.what, drift.robot))
            if before is None or not before.low <= drift.ratio <= before.high:
                reported[drift.what, drift.robot] = drift
                notify(drift)

    try:
        number = 0
        for line in lines:
            if line is None:
                silent_s = clock() - heard
                now = run.now_ns + int(silent_s * NANOSECONDS)
                if run.events and now >= due:
                    make_forecast(now)
                notify(Silence(silent_s))
                continue
            number += 1
            heard = clock()
            if not line.strip():
                continue
            try:
                event = Event.parse(line)
            except EventLogError as error:
                notify(UnreadableLine(number, error))
                continue
            if event.t_ns >= due and not run.outcome:
                make_forecast(max(event.t_ns // every * every, run.now_ns))
            found = run.apply(event)
            notify(event)
            for violation in found:
                notify(violation)
            if run.outcome:
                break
    finally:
        notify(run)
