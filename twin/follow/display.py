"""Output of ``twin follow`` about a run in progress, as JSON, as sentences, or as a live terminal display."""

from __future__ import annotations

import json
import math
import time
from typing import Any

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from twin.activities.progress import RobotProgress
from twin.durations.nanoseconds import NANOSECONDS
from twin.follow.drift import Drift
from twin.follow.follow import News, Silence, UnreadableLine
from twin.follow.forecast import Forecast
from twin.follow.state import FollowedRun, ForbiddenEvent
from twin.host.atomic_files import finite_or_none
from twin.runs.events import Event

_MOST_VIOLATIONS = 5
"""Greatest number of forbidden events, and of unreadable lines, that are shown."""

_SILENT_S = 5.0
"""Time without events after which silence is reported [s]."""

_PAUSE_S = 0.1
"""Least time between two updates of the terminal [s]."""


def news_to_json(news: News) -> str:
    """Return news as a JSON object; an empty text if there is nothing to report."""
    content: dict[str, Any]
    match news:
        case ForbiddenEvent():
            content = {
                "kind": "violation",
                "t_s": news.t_ns / NANOSECONDS,
                "robot": news.robot,
                "node": news.node,
                "task": news.task,
                "edges": [list(edge) for edge in news.edges],
                "text": news.text,
            }
        case UnreadableLine():
            content = {
                "kind": "unreadable",
                "line": news.number,
                "text": str(news.error),
            }
        case Forecast():
            p50, p90 = news.quantile(0.5), news.quantile(0.9)
            content = {
                "kind": "forecast",
                "t_s": news.t_s,
                "p50_s": finite_or_none(p50),
                "p90_s": finite_or_none(p90),
                "remaining_p50_s": finite_or_none(p50 - news.t_s),
                "remaining_p90_s": finite_or_none(p90 - news.t_s),
                "failing": news.failing,
                "nodes_done": news.nodes_done,
                "nodes": news.nodes,
            }
        case Drift():
            content = {
                "kind": "drift",
                "what": news.what,
                "robot": news.robot,
                "since_s": news.since_ns / NANOSECONDS,
                "count": news.count,
                "ratio": news.ratio,
                "low": news.low,
                "high": news.high,
                "text": news.words,
            }
        case FollowedRun():
            content = {
                "kind": "end",
                "t_s": news.now_ns / NANOSECONDS,
                "outcome": news.outcome or None,
                "events": news.events,
                "violations": len(news.violations),
                "nodes_done": news.nodes_done,
            }
        case _:
            return ""
    return json.dumps(content)


def news_to_sentence(news: News) -> str:
    """Return news as a sentence; an empty text if there is nothing to report."""
    match news:
        case ForbiddenEvent():
            return f"FORBIDDEN {news.text}"
        case UnreadableLine():
            return f"line {news.number} is no event: {news.error}"
        case Forecast():
            done = f"{news.t_s:8.1f} s  {news.nodes_done}/{news.nodes} nodes"
            left = max(news.quantile(0.5) - news.t_s, 0.0)
            ends = f"  {_ends(news)}: {left:.1f} s to go" if _ends(news) else ""
            return done + ends + _failing(news)
        case Drift():
            return f"DRIFT {news.words}"
        case FollowedRun():
            total = sum(len(robot.start_ns) for robot in news.robots)
            what = news.outcome or "no end in the log yet"
            count = len(news.violations)
            forbidden = f"{count} forbidden events" if count else "nothing forbidden"
            return (
                f"{news.now_ns / NANOSECONDS:.3f} s: {what}, {news.nodes_done} of {total} nodes,"
                f" {forbidden}"
            )
        case _:
            return ""


def _ends(forecast: Forecast) -> str:
    """Return a text on the forecast end of a run; empty if it does not end."""
    p50, p90 = forecast.quantile(0.5), forecast.quantile(0.9)
    return "" if math.isnan(p50) else f"ends at {p50:.1f} s (P50), {p90:.1f} s (P90)"


def _failing(forecast: Forecast) -> str:
    share = 100 * forecast.failing
    return f"  a task fails in {share:.1f} % of futures" if share > 0 else ""


class TerminalDisplay:
    """Redraws the state of a run after changes, at most ten times a second."""

    def __init__(self, run: FollowedRun, title: str, console: Console) -> None:
        """Begin to draw."""
        self._run = run
        self._title = title
        self._console = console
        self._forecast: Forecast | None = None
        self._drifts: dict[tuple[str, str], Drift] = {}
        self._unreadable: list[str] = []
        self._silent_s = 0.0
        self._drawn = 0.0
        self._live = Live(console=console, auto_refresh=False)
        self._live.start()

    def __call__(self, news: News) -> None:
        """Show changes; at the end leave the last picture and a sentence on the terminal."""
        match news:
            case UnreadableLine():
                self._unreadable.append(news_to_sentence(news))
            case Forecast():
                self._forecast = news
            case Drift():
                self._drifts[news.what, news.robot] = news
            case Event():
                self._silent_s = 0.0
            case Silence():
                self._silent_s = news.seconds
        now = time.monotonic()
        if news is self._run or now - self._drawn >= _PAUSE_S:
            self._drawn = now
            self._live.update(self._picture(), refresh=True)
        if news is self._run:
            self._live.stop()
            self._console.print(news_to_sentence(news), highlight=False)

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
        for drift in self._drifts.values():
            parts.append(Text(f"drift: {drift.words}", style="yellow"))
        hidden = len(run.violations) - _MOST_VIOLATIONS
        if hidden > 0:
            parts.append(Text(f"{hidden} more forbidden events before", style="red"))
        for violation in run.violations[-_MOST_VIOLATIONS:]:
            parts.append(Text(f"forbidden: {violation.text}", style="bold red"))
        for line in self._unreadable[-_MOST_VIOLATIONS:]:
            parts.append(Text(line, style="yellow"))
        return Group(*parts)


def _state(run: FollowedRun, k: int, robot: RobotProgress) -> tuple[Text, int]:
    """Return the state of a robot and its start [ns], -1 where irrelevant."""
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
    text = Text(f"{at}  ")
    if ends := _ends(forecast):
        left = (forecast.quantile(p) - now / NANOSECONDS for p in (0.5, 0.9))
        low, high = (max(seconds, 0.0) for seconds in left)
        text.append(ends, style="bold")
        text.append(f"  {low:.0f} to {high:.0f} s to go")
    return text.append(_failing(forecast), style="red")
