"""Timelines of a run: trace-event JSON, and a Mermaid Gantt chart.

ui.perfetto.dev and chrome://tracing show the first: a lane per robot with what it does and where
it waits, stalls or is stopped; an arrow for each type-2 edge from the end of the node waited for
to the start of the node that waits; an instant for each object that changes hands. Times are
microseconds with three decimals, so exact.

GitHub and many editors draw the second in Markdown: a section a robot, a bar a task; waits and
stops that are long enough to be seen are bars of their own, shorter ones belong to the task
around them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from typing import Any

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.run.activities import CAUSES, STANDING, WAITING, Activity, robot_activities
from twin.trial.run_result import RunResult

PROCESS = 1

_INSTANTS = frozenset({"attached", "detached", "failed"})


def perfetto_files(run: RunResult, *, nodes: bool) -> Mapping[str, bytes]:
    """Return ``trace.json``; with ``nodes`` a slice is a node, otherwise (part of) a task."""
    lanes = robot_activities(run.tpg, run.history, nodes=nodes)
    threads = {robot: k for k, robot in enumerate(lanes, start=1)}
    events = [*_names(run, threads)]
    for robot, activities in lanes.items():
        events += [_slice(run.tpg, threads[robot], item) for item in activities]
    # Viewers tie an arrow to the slice around its end: slices first, arrows by time after.
    events += _arrows(run)
    events += _instants(run, threads)
    keys = ("seed", "policy", "outcome")
    about = {k: v for k, v in run.summary.items() if k in keys}
    document = {
        "traceEvents": events,
        "displayTimeUnit": "ms",
        "otherData": {"scenario": run.name, **about},
    }
    text = json.dumps(document, ensure_ascii=False, allow_nan=False)
    return {"trace.json": text.encode() + b"\n"}


def _names(run: RunResult, threads: Mapping[str, int]) -> Iterator[dict[str, Any]]:
    def meta(what: str, tid: int, **args: object) -> dict[str, Any]:
        return {"ph": "M", "name": what, "pid": PROCESS, "tid": tid, "args": args}

    yield meta("process_name", 0, name=run.name)
    for robot, tid in threads.items():
        yield meta("thread_name", tid, name=robot)
        yield meta("thread_sort_index", tid, sort_index=tid)


def _slice(tpg: TemporalPlanGraph, tid: int, item: Activity) -> dict[str, Any]:
    args: dict[str, Any] = {}
    name = item.state
    if item.task >= 0:
        task = tpg.tasks[item.task]
        name = f"{item.state}: {task.label}" if item.state in STANDING else task.label
        args = {
            "task": item.task,
            "kind": task.kind,
            "step": task.step,
            "object": task.object or "",
            "first_node": item.first,
            "last_node": item.last,
        }
    return {
        "ph": "X",
        "name": name,
        "cat": item.state,
        "ts": _microseconds(item.start_ns),
        "dur": _microseconds(item.duration_ns),
        "pid": PROCESS,
        "tid": tid,
        "args": args,
    }


def _arrows(run: RunResult) -> list[dict[str, Any]]:
    """Return start and finish of an arrow for each type-2 edge that was satisfied."""
    tpg, times = run.tpg, run.node_times_ns
    out: list[dict[str, Any]] = []
    for number, (edge, cause) in enumerate(
        zip(tpg.edges.tolist(), tpg.cause.tolist(), strict=True)
    ):
        before, source, after, target = edge
        begun, end = int(times[before][0][source]), int(times[before][1][source])
        start = int(times[after][0][target])
        if end < 0 or start < 0:
            continue
        arrow = {"id": number, "name": CAUSES[cause], "cat": "type-2"}
        # At the very end of a node the next slice begins: the arrow starts within its own.
        ts = _microseconds(max(begun, end - 1))
        there = {"pid": PROCESS, "tid": before + 1}
        out.append({"ph": "s", **arrow, "ts": ts, **there})
        ts, there = _microseconds(start), {"pid": PROCESS, "tid": after + 1}
        out.append({"ph": "f", **arrow, "ts": ts, **there, "bp": "e"})
    return sorted(out, key=lambda event: event["ts"])


def _instants(run: RunResult, threads: Mapping[str, int]) -> Iterator[dict[str, Any]]:
    for event in run.history:
        if event.kind in _INSTANTS and event.robot in threads:
            yield {
                "ph": "i",
                "s": "t",
                "name": f"{event.kind} {event.object or event.detail}".strip(),
                "cat": event.kind,
                "ts": _microseconds(event.t_ns),
                "pid": PROCESS,
                "tid": threads[event.robot],
                "args": {"detail": event.detail, "node": event.node},
            }


def _microseconds(t_ns: int) -> float:
    """Return a time in microseconds; exact to the nanosecond up to a hundred days."""
    return t_ns / 1000


# Mermaid knows calendar times only: the chart starts at midnight of some day.
_START = datetime(2000, 1, 1)
_SHARE = 0.005
"""Standstills shorter than this share of the makespan are not shown."""

_MILLISECOND = 1_000_000
"""Resolution of Mermaid's times [ns]."""

_KEYWORDS = re.compile(
    r"(gantt|title|section|dateFormat|axisFormat|tickInterval|todayMarker|inclusiveEndDates"
    r"|topAxis|excludes|includes|weekday|weekend|click|accTitle|accDescr|call|href)\b"
)


def mermaid_files(run: RunResult) -> Mapping[str, bytes]:
    """Return ``gantt.mmd``."""
    policy = run.summary.get("policy")
    title = run.name + (f", {policy}" if policy else "")
    lines = [
        "gantt",
        f"    title {_plain(title)}",
        "    dateFormat YYYY-MM-DDTHH:mm:ss.SSS",
        "    axisFormat %H:%M:%S",
    ]
    least_ns = int(_SHARE * run.makespan_ns)
    for robot, activities in robot_activities(run.tpg, run.history).items():
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
    return f"{_plain(label)} :{tags}{_mermaid_time(item.start_ns)}, {_mermaid_time(item.end_ns)}"


def _mermaid_time(t_ns: int) -> str:
    moment = _START + timedelta(milliseconds=t_ns // _MILLISECOND)
    return moment.isoformat(timespec="milliseconds")


def _plain(text: str) -> str:
    """Return a text without the characters and first words that mean something to Mermaid."""
    words = re.sub(r"[\s:;#,%{}]+", " ", text).strip()
    return f"- {words}".rstrip() if not words or _KEYWORDS.match(words) else words
