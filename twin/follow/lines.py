"""Text output of a followed run: JSON for programs, sentences for people."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

from twin.durations import NANOSECONDS
from twin.follow.follow import RunListener
from twin.follow.forecast import Forecast
from twin.follow.state import FollowedRun, Violation
from twin.run.event_log import EventLogError

Write = Callable[[str], None]


class JsonLines(RunListener):
    """Writes one JSON object a line: forecasts, violations, unreadable lines, and the end."""

    def __init__(self, write: Write) -> None:
        """Hand lines, without newlines, to ``write``."""
        self._write = write

    def violation(self, violation: Violation) -> None:
        """Write a violation."""
        self._put(
            "violation",
            t_s=violation.t_ns / NANOSECONDS,
            robot=violation.robot,
            node=violation.node,
            task=violation.task,
            edges=[list(edge) for edge in violation.edges],
            text=violation.text,
        )

    def unreadable(self, number: int, error: EventLogError) -> None:
        """Write which line is no event."""
        self._put("unreadable", line=number, text=str(error))

    def forecast(self, forecast: Forecast, run: FollowedRun) -> None:
        """Write a forecast."""
        p50, p90 = forecast.quantile(0.5), forecast.quantile(0.9)
        self._put(
            "forecast",
            t_s=forecast.t_s,
            p50_s=_number(p50),
            p90_s=_number(p90),
            remaining_p50_s=_number(p50 - forecast.t_s),
            remaining_p90_s=_number(p90 - forecast.t_s),
            failing=forecast.failing,
            nodes_done=forecast.nodes_done,
            nodes=forecast.nodes,
        )

    def close(self, run: FollowedRun) -> None:
        """Write how it ended, or how far it had come."""
        self._put(
            "end",
            t_s=run.now_ns / NANOSECONDS,
            outcome=run.outcome or None,
            events=run.events,
            violations=len(run.violations),
            nodes_done=run.nodes_done,
        )

    def _put(self, what: str, **values: Any) -> None:
        self._write(json.dumps({"kind": what, **values}))


class PlainLines(RunListener):
    """Writes sentences, for where there is no terminal to draw on."""

    def __init__(self, write: Write) -> None:
        """Hand lines, without newlines, to ``write``."""
        self._write = write

    def violation(self, violation: Violation) -> None:
        """Write a violation."""
        self._write(f"FORBIDDEN {violation.text}")

    def unreadable(self, number: int, error: EventLogError) -> None:
        """Write which line is no event."""
        self._write(f"line {number} is no event: {error}")

    def forecast(self, forecast: Forecast, run: FollowedRun) -> None:
        """Write a forecast."""
        self._write(forecast_sentence(forecast))

    def close(self, run: FollowedRun) -> None:
        """Write how it ended, or how far it had come."""
        self._write(end_sentence(run))


def forecast_sentence(forecast: Forecast) -> str:
    """Return a forecast in words."""
    p50, p90 = forecast.quantile(0.5), forecast.quantile(0.9)
    text = f"{forecast.t_s:8.1f} s  {forecast.nodes_done}/{forecast.nodes} nodes"
    if not math.isnan(p50):
        text += (
            f"  ends at {p50:.1f} s (P50), {p90:.1f} s (P90):"
            f" {max(p50 - forecast.t_s, 0.0):.1f} s to go"
        )
    if forecast.failing > 0:
        text += f"  a task fails in {100 * forecast.failing:.1f} % of futures"
    return text


def end_sentence(run: FollowedRun) -> str:
    """Return how a run ended in words, or how far it had come."""
    what = run.outcome or "no end in the log yet"
    total = sum(len(robot.start_ns) for robot in run.robots)
    text = (
        f"{run.now_ns / NANOSECONDS:.3f} s: {what}, {run.nodes_done} of {total} nodes"
    )
    count = len(run.violations)
    return (
        f"{text}, {count} forbidden events" if count else f"{text}, nothing forbidden"
    )


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value
