"""Motions for controllers: JSON in the shape of trajectory_msgs/JointTrajectory, a segment each.

Motions for controllers as tables: CSV, a file a robot, a row a point of a segment.

Columns say their units. What a segment waits for, and what changes hands in it, stands in its first
row.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from io import StringIO
from itertools import groupby
from typing import Any

from planning.tasks.task import GONE
from twin.durations.model import NANOSECONDS
from twin.exports.segments import (
    CONTROLLER_RATE_HZ,
    CONTROLLER_RATES_HZ,
    Segment,
    SegmentHandling,
    require_rate,
    segments,
)
from twin.trial.run_result import RunResult

FORMAT = "assembly-twin joint trajectories"
VERSION = 2


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
        "task": {
            "index": task.index,
            "kind": task.kind,
            "step": task.step,
            "label": task.label,
            "object": task.object,
        },
        "nodes": list(segment.nodes),
        "after": [
            {"segment": item.segment, "cause": item.cause} for item in segment.after
        ],
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
    """Return ``joints_<robot>.csv`` for every robot with work.

    Args:
        run: the run.
        rate_hz: of points where speeds are known [Hz].

    Raises:
        OutputError: controllers take no such rate.
    """
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
