"""Export of joint motions for robot controllers as JSON, in the format of ROS trajectory_msgs/JointTrajectory."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from twin.durations.nanoseconds import NANOSECONDS
from twin.exports.segments import (
    CONTROLLER_RATE_HZ,
    CONTROLLER_RATES_HZ,
    Segment,
    require_rate,
    segments,
)
from twin.trial.run_result import RunResult

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
