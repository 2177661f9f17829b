"""The tables of a run as CSV and Parquet: what happened, where robots were, where objects were.

CSV is that of RFC 4180: a header line, SI units, empty fields where there is nothing.

The timeline of a run as trace-event JSON, which ui.perfetto.dev and chrome://tracing show: a lane
per robot with what it does and where
it waits, stalls or is stopped; an arrow for each type-2 edge from the end of the node waited for
to the start of the node that waits; an instant for each object that changes hands. Times are
microseconds with three decimals, so exact.

Motions for controllers: JSON in the shape of trajectory_msgs/JointTrajectory, a segment each.

Motions for controllers as tables: CSV, a file a robot, a row a point of a segment.

Columns say their units. What a segment waits for, and what changes hands in it, stands in its first
row.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from io import BytesIO, StringIO
from itertools import groupby
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from planning.tasks.task import GONE
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.model import NANOSECONDS
from twin.exports.segments import (
    CONTROLLER_RATE_HZ,
    CONTROLLER_RATES_HZ,
    Segment,
    SegmentHandling,
    require_rate,
    segments,
)
from twin.run.activities import CAUSES, TOLD, Activity, robot_activities
from twin.trial.run_result import RunResult

_PARTS = {"xyz": ("x", "y", "z"), "quat_wxyz": ("qw", "qx", "qy", "qz")}


def csv_files(run: RunResult) -> Mapping[str, bytes]:
    """Return ``events.csv``, ``trajectory.csv`` and ``objects.csv``, a column a component."""
    return {f"{name}.csv": _csv(table) for name, table in _tables(run).items()}


def parquet_files(run: RunResult) -> Mapping[str, bytes]:
    """Return the same tables as Parquet, zstd compressed.

    Each says in its metadata which run it is of.
    """
    about = {"scenario": run.name}
    about |= {k: str(run.summary[k]) for k in ("seed", "policy") if k in run.summary}
    out = {}
    for name, table in _tables(run).items():
        buffer = BytesIO()
        kept = table.schema.metadata or {}
        pq.write_table(
            table.replace_schema_metadata({**kept, **about}), buffer, compression="zstd"
        )
        out[f"{name}.parquet"] = buffer.getvalue()
    return out


def _tables(run: RunResult) -> Mapping[str, pa.Table]:
    """Return the tables ``events``, ``trajectory`` and ``objects``; the last two as in the folder."""
    return {
        "events": run.events,
        "trajectory": run.trajectory,
        "objects": run.objects,
    }


def _csv(table: pa.Table) -> bytes:
    columns = {}
    for name in table.column_names:
        column = table.column(name).combine_chunks()
        if name in _PARTS:
            size = len(_PARTS[name])
            values = column.flatten()
            for k, part in enumerate(_PARTS[name]):
                columns[part] = values.take(
                    pa.array(range(k, len(values), size), pa.int64())
                )
        elif pa.types.is_dictionary(column.type):
            columns[name] = column.cast(pa.string())
        else:
            columns[name] = column
    buffer = BytesIO()
    pa.csv.write_csv(pa.table(columns), buffer)
    return buffer.getvalue()


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


FORMAT = "assembly-twin joint trajectories"
VERSION = 2

_TASK_KEYS = ("index", "kind", "step", "label", "object")


def joint_trajectory_files(
    run: RunResult, *, rate_hz: float = CONTROLLER_RATE_HZ
) -> Mapping[str, bytes]:
    """Return ``joint_trajectories.json``.

    Args:
        run: the run.
        rate_hz: of points where speeds are known [Hz].

    Raises:
        OutputError: controllers take no such rate.
    """
    require_rate(rate_hz, CONTROLLER_RATES_HZ)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "scenario": run.name,
        "segments": [_entry(segment) for segment in segments(run, rate_hz)],
    }
    text = json.dumps(document, ensure_ascii=False, allow_nan=False)
    return {"joint_trajectories.json": text.encode() + b"\n"}


def _entry(segment: Segment) -> dict[str, Any]:
    task = segment.task
    return {
        "id": segment.id,
        "robot": segment.robot,
        "task": {key: getattr(task, key) for key in _TASK_KEYS},
        "nodes": list(segment.nodes),
        "after": list(map(asdict, segment.after)),
        "nominal_s": [_seconds(t) for t in segment.nominal],
        "executed_s": [_seconds(t) for t in segment.executed],
        "motion_s": None
        if segment.motion is None
        else list(map(_seconds, segment.motion)),
        "handlings": [
            {
                "object": item.object,
                "holder": item.holder,
                "time_from_start": _duration(item.t_ns),
            }
            for item in segment.handlings
        ],
        "joint_trajectory": {
            "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
            "joint_names": list(segment.joint_names),
            "points": _points(segment),
        },
    }


def _points(segment: Segment) -> list[dict[str, Any]]:
    empty: list[list[float]] = [[]] * len(segment.t_ns)
    return [
        {
            "positions": at,
            "velocities": speed,
            "accelerations": rise,
            "effort": [],
            "time_from_start": _duration(t_ns),
        }
        for t_ns, at, speed, rise in zip(
            segment.t_ns.tolist(),
            segment.q.tolist(),
            empty if segment.v is None else segment.v.tolist(),
            empty if segment.a is None else segment.a.tolist(),
            strict=True,
        )
    ]


def _duration(t_ns: int) -> dict[str, int]:
    seconds, rest = divmod(t_ns, NANOSECONDS)
    return {"sec": seconds, "nanosec": rest}


def _seconds(t_ns: int) -> float | None:
    return t_ns / NANOSECONDS if t_ns >= 0 else None


def joint_csv_files(
    run: RunResult, *, rate_hz: float = CONTROLLER_RATE_HZ
) -> Mapping[str, bytes]:
    """Return ``joints_<robot>.csv`` for every robot with work; see ``joint_trajectory_files``."""
    require_rate(rate_hz, CONTROLLER_RATES_HZ)
    out = {}
    for robot, own in groupby(segments(run, rate_hz), lambda segment: segment.robot):
        smooth = robot in run.smooth_motions
        text = StringIO(newline="")
        writer = csv.writer(text)
        writer.writerow(_header(run, robot, smooth))
        for segment in own:
            writer.writerows(_rows(segment, smooth))
        out[f"joints_{robot}.csv"] = text.getvalue().encode()
    return out


def _header(run: RunResult, robot: str, smooth: bool) -> list[str]:
    """Return the names of the columns; speeds and accelerations only where they are known."""
    model = run.tpg.cell.robot(robot).model
    units = ["m" if slides else "rad" for slides in model.chain.prismatic]
    found = ["segment", "time_from_start [s]"]
    for letter, per in zip("qva" if smooth else "q", ("", "/s", "/s^2"), strict=False):
        found += [
            f"{letter} {name} [{unit}{per}]"
            for name, unit in zip(model.joint_names, units, strict=True)
        ]
    return [*found, "after", "handlings"]


def _rows(segment: Segment, smooth: bool) -> Iterator[list[object]]:
    after = "; ".join(f"{item.segment} ({item.cause})" for item in segment.after)
    handlings = "; ".join(_said(item) for item in segment.handlings)
    empty = [""] * segment.q.shape[1] * (2 * smooth)
    for k, t_ns in enumerate(segment.t_ns.tolist()):
        rates: list[object] = list(empty)
        if segment.v is not None and segment.a is not None:
            rates = [*segment.v[k].tolist(), *segment.a[k].tolist()]
        said = [after, handlings] if k == 0 else ["", ""]
        yield [segment.id, t_ns / NANOSECONDS, *segment.q[k].tolist(), *rates, *said]


def _said(item: SegmentHandling) -> str:
    """Return an object that changes hands, its new holder and when [s]."""
    to = {None: "at rest", GONE: "gone"}.get(item.holder, f"to {item.holder}")
    return f"{item.object} {to} at {item.t_ns / NANOSECONDS:g} s"
