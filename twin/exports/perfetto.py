"""Export of the timeline of a run as trace-event JSON, which ui.perfetto.dev and chrome://tracing display.

Times are microseconds with three decimals, which is exact to the nanosecond.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.activities.activities import CAUSES, TOLD, Activity, robot_activities
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
        name = f"{item.state}: {task.label}" if item.state in TOLD else task.label
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
