"""A Mermaid Gantt chart, which GitHub and many editors draw in Markdown.

A section a robot, a bar a task; waits and stops that are long enough to be seen are bars of their
own, shorter ones belong to the task around them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.exports.recorded_run import RecordedRun
from twin.run.activities import STANDING, WAITING, Activity, robot_activities

# Mermaid knows calendar times only: the chart starts at midnight of some day.
_START = datetime(2000, 1, 1)
_SHARE = 0.005
"""Standstills shorter than this share of the makespan are not shown."""

_MILLISECOND = 1_000_000

_KEYWORDS = re.compile(
    r"(gantt|title|section|dateFormat|axisFormat|tickInterval|todayMarker|inclusiveEndDates"
    r"|topAxis|excludes|includes|weekday|weekend|click|accTitle|accDescr|call|href)\b"
)


def mermaid_files(run: RecordedRun) -> Mapping[str, bytes]:
    """Return ``gantt.mmd``."""
    policy = run.summary.get("policy")
    title = run.scenario + (f", {policy}" if policy else "")
    lines = [
        "gantt",
        f"    title {_plain(title)}",
        "    dateFormat YYYY-MM-DDTHH:mm:ss.SSS",
        "    axisFormat %H:%M:%S",
    ]
    least_ns = int(_SHARE * run.makespan_ns)
    for robot, activities in robot_activities(run.tpg, run.events).items():
        lines.append(f"    section {_plain(robot)}")
        lines += [
            f"    {_bar(run.tpg, item)}"
            for item in _visible(activities, least_ns)
            if item.end_ns // _MILLISECOND > item.start_ns // _MILLISECOND
        ]
    return {"gantt.mmd": ("\n".join(lines) + "\n").encode()}


def _visible(activities: Sequence[Activity], least_ns: int) -> list[Activity]:
    """Leave out short standstills within tasks; what they divided becomes one bar."""
    out: list[Activity] = []
    for k, item in enumerate(activities):
        short = item.state in STANDING and item.duration_ns < least_ns
        if short and out and _goes_on(out[-1], activities[k + 1 :]):
            out[-1] = replace(out[-1], end_ns=item.end_ns)
            continue
        last = out[-1] if out else None
        if last is not None and (last.state, last.task) == (item.state, item.task):
            out[-1] = replace(last, end_ns=item.end_ns, last=item.last)
        elif not short:
            out.append(item)
    return out


def _goes_on(last: Activity, following: Iterable[Activity]) -> bool:
    """Tell whether a task that was under way goes on later."""
    return last.state not in STANDING and any(
        item.task == last.task and item.state == last.state for item in following
    )


def _bar(tpg: TemporalPlanGraph, item: Activity) -> str:
    if item.state in STANDING:
        tag = "done" if item.state == WAITING else "crit"
        label = item.state
    else:
        tag = "" if item.state == "transit" else "active"
        label = tpg.tasks[item.task].label
    tags = f"{tag}, " if tag else ""
    return f"{_plain(label)} :{tags}{_time(item.start_ns)}, {_time(item.end_ns)}"


def _time(t_ns: int) -> str:
    moment = _START + timedelta(milliseconds=t_ns // _MILLISECOND)
    return moment.isoformat(timespec="milliseconds")


def _plain(text: str) -> str:
    """Return a text without the characters and first words that mean something to Mermaid."""
    words = re.sub(r"[\s:;#,%{}]+", " ", text).strip()
    return f"- {words}".rstrip() if not words or _KEYWORDS.match(words) else words
