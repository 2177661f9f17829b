"""Output of a followed run: JSON for programs, sentences, or a picture on a terminal."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from twin.durations.model import NANOSECONDS
from twin.follow.follow import RunListener
from twin.follow.forecast import Forecast
from twin.follow.state import FollowedRun, ForbiddenEvent, RobotProgress
from twin.host.guard import finite
from twin.run.events import Event, EventLogError


class JsonLines(RunListener):
    """Writes one JSON object a line: forecasts, violations, unreadable lines, and the end."""

    def __init__(self, write: Callable[[str], None]) -> None:
        """Hand lines, without newlines, to ``write``."""
        self._write = write

    def violation(self, violation: ForbiddenEvent) -> None:
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
            p50_s=finite(p50),
            p90_s=finite(p90),
            remaining_p50_s=finite(p50 - forecast.t_s),
            remaining_p90_s=finite(p90 - forecast.t_s),
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

    def __init__(self, write: Callable[[str], None]) -> None:
        """Hand lines, without newlines, to ``write``."""
        self._write = write

    def violation(self, violation: ForbiddenEvent) -> None:
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


_MOST_VIOLATIONS = 5
"""Forbidden events, and unreadable lines, that are shown."""

_SILENT_S = 5.0
"""Silence that is told of [s]."""

_PAUSE_S = 0.1
"""Least time between two drawings [s]."""


class TerminalDisplay(RunListener):
    """Draws the state of a run again whenever it has changed, ten times a second at most."""

    def __init__(self, run: FollowedRun, title: str, console: Console) -> None:
        """Begin to draw."""
        self._run = run
        self._title = title
        self._console = console
        self._forecast: Forecast | None = None
        self._unreadable: list[str] = []
        self._silent_s = 0.0
        self._drawn = 0.0
        self._live = Live(console=console, auto_refresh=False)
        self._live.start()

    def event(self, event: Event, run: FollowedRun) -> None:
        """Show what has changed."""
        self._silent_s = 0.0
        self._draw()

    def unreadable(self, number: int, error: EventLogError) -> None:
        """Show which line is no event."""
        self._unreadable.append(f"line {number} is no event: {error}")
        self._draw()

    def forecast(self, forecast: Forecast, run: FollowedRun) -> None:
        """Show how the run will end."""
        self._forecast = forecast
        self._draw()

    def waiting(self, run: FollowedRun, silent_s: float) -> None:
        """Show for how long there has been no event."""
        self._silent_s = silent_s
        self._draw()

    def close(self, run: FollowedRun) -> None:
        """Leave the last picture and a sentence on the terminal."""
        self._draw(at_once=True)
        self._live.stop()
        self._console.print(end_sentence(run), highlight=False)

    def _draw(self, *, at_once: bool = False) -> None:
        now = time.monotonic()
        if at_once or now - self._drawn >= _PAUSE_S:
            self._drawn = now
            self._live.update(self._picture(), refresh=True)

    def _picture(self) -> Group:
        """Return the picture of the run as it is now."""
        run = self._run
        now = run.now_ns + int(self._silent_s * NANOSECONDS)
        table = Table(title=self._title, title_justify="left", expand=False)
        for column in ("robot", "does", "for", "nodes", ""):
            right = column in ("for", "nodes")
            table.add_column(
                column, justify="right" if right else "left", no_wrap=right
            )
        for k, robot in enumerate(run.robots):
            text, since = _state(run, k, robot)
            total = len(robot.start_ns)
            table.add_row(
                robot.name,
                text,
                "" if since < 0 else f"{(now - since) / NANOSECONDS:.1f} s",
                f"{robot.completed}/{total}",
                ProgressBar(total=max(total, 1), completed=robot.completed, width=24),
            )
        parts: list[Table | Text] = [table, _forecast_line(run, self._forecast, now)]
        if self._silent_s >= _SILENT_S:
            parts.append(Text(f"no event for {self._silent_s:.0f} s", style="yellow"))
        hidden = len(run.violations) - _MOST_VIOLATIONS
        if hidden > 0:
            parts.append(Text(f"{hidden} more forbidden events before", style="red"))
        for violation in run.violations[-_MOST_VIOLATIONS:]:
            parts.append(Text(f"forbidden: {violation.text}", style="bold red"))
        for line in self._unreadable[-_MOST_VIOLATIONS:]:
            parts.append(Text(line, style="yellow"))
        return Group(*parts)


def _state(run: FollowedRun, k: int, robot: RobotProgress) -> tuple[Text, int]:
    """Return what a robot does, and since when [ns], -1 where that does not matter."""
    node = robot.under_way
    if robot.failed:
        return Text(f"failed: {_label(run, k, robot.completed)}", style="bold red"), -1
    if robot.standing:
        text = robot.standing
        if node >= 0:
            text += f" in {_label(run, k, node)}"
        return Text(text, style="bold yellow"), robot.since_ns
    if node >= 0:
        text = _label(run, k, node)
        if robot.attempts:
            text += f", attempt {robot.attempts + 1}"
        return Text(text, style="green"), _task_begun(run, k, robot, node)
    if robot.finished:
        return Text("done", style="dim"), -1
    since = int(robot.end_ns[robot.completed - 1]) if robot.completed else 0
    return Text(run.waits_for(k) or "waits for its release", style="dim"), since


def _task_begun(run: FollowedRun, k: int, robot: RobotProgress, node: int) -> int:
    """Return when the task of a node began [ns]."""
    tasks = run.tpg.chains[k].task
    return int(robot.start_ns[int(np.searchsorted(tasks, tasks[node]))])


def _label(run: FollowedRun, k: int, node: int) -> str:
    task = run.tpg.tasks[int(run.tpg.chains[k].task[node])]
    return f"{task.label} (step {task.step})" if task.step > 0 else task.label


def _forecast_line(run: FollowedRun, forecast: Forecast | None, now: int) -> Text:
    at = f"{now / NANOSECONDS:.1f} s"
    if run.outcome:
        return Text(f"{run.outcome} at {run.now_ns / NANOSECONDS:.3f} s", style="bold")
    if forecast is None:
        return Text(at)
    p50, p90 = forecast.quantile(0.5), forecast.quantile(0.9)
    text = Text(f"{at}  ")
    if not math.isnan(p50):
        text.append(f"ends at {p50:.1f} s (P50), {p90:.1f} s (P90)", style="bold")
        left = [max(p - now / NANOSECONDS, 0.0) for p in (p50, p90)]
        text.append(f"  {left[0]:.0f} to {left[1]:.0f} s to go")
    if forecast.failing > 0:
        share = 100 * forecast.failing
        text.append(f"  a task fails in {share:.1f} % of futures", style="red")
    return text
