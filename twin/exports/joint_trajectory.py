"""Motions for controllers: JSON in the shape of trajectory_msgs/JointTrajectory, a segment each.

A segment is a stretch of one robot's nodes that nothing else can interrupt: it waits for others
only before its first node, and others wait for nothing within it but its last. Whoever executes a
segment when all segments in its ``after`` are complete keeps to the temporal plan graph, whatever
the delays. Points are timed by the nominal durations, velocities are left to the controller.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from planning.transforms import Indices
from twin.durations import NANOSECONDS, to_nanoseconds
from twin.exports.recorded_run import RecordedRun
from twin.run.activities import CAUSES
from twin.run.run_record import waypoint_offsets_ns
from twin.uncertainty.contraction import Contraction, contract

FORMAT = "assembly-twin joint trajectories"
VERSION = 1


def joint_trajectory_files(run: RecordedRun) -> Mapping[str, bytes]:
    """Return ``joint_trajectories.json``."""
    found = contract(run.tpg)
    after = _after(found)
    segments = [
        segment
        for k, first in enumerate(found.first)
        for segment in _segments(run, k, first, after)
    ]
    document = {
        "format": FORMAT,
        "version": VERSION,
        "scenario": run.scenario,
        "segments": segments,
    }
    text = json.dumps(document, ensure_ascii=False, allow_nan=False)
    return {"joint_trajectories.json": text.encode() + b"\n"}


def _after(found: Contraction) -> dict[tuple[int, int], list[dict[str, str]]]:
    """Return the segments of other robots that each segment has to wait for."""
    out: dict[tuple[int, int], list[dict[str, str]]] = defaultdict(list)
    chains = found.tpg.chains
    for edge, cause in zip(
        found.tpg.edges.tolist(), found.tpg.cause.tolist(), strict=True
    ):
        before, source, chain, target = edge
        out[chain, target].append(
            {"segment": f"{chains[before].robot}/{source}", "cause": CAUSES[cause]}
        )
    return out


def _segments(
    run: RecordedRun,
    k: int,
    bounds: Indices,
    after: Mapping[tuple[int, int], list[dict[str, str]]],
) -> Iterator[dict[str, Any]]:
    """Yield the segments of a chain; ``bounds`` are their first nodes, and one more."""
    tpg, chain = run.tpg, run.tpg.chains[k]
    durations = to_nanoseconds(chain.duration)
    begin = np.cumsum(durations) - durations
    passed = np.repeat(begin, np.diff(chain.first))
    passed += waypoint_offsets_ns(chain, durations)
    stands = np.vstack([chain.start[None], chain.waypoints])
    started, ended = run.node_times_ns[k]
    for index, (first, end) in enumerate(pairwise(bounds.tolist())):
        zero = int(begin[first])
        low, high = int(chain.first[first]), int(chain.first[end])
        times = [0, *(passed[low:high] - zero).tolist()]
        handlings = []
        for item in tpg.handlings:
            if item.robot == k and first <= item.node < end:
                t_ns = int(begin[item.node])
                if item.waypoint:
                    t_ns = int(passed[chain.first[item.node] + item.waypoint - 1])
                handlings.append(
                    {
                        "object": item.object,
                        "holder": item.holder,
                        "time_from_start": _duration(t_ns - zero),
                    }
                )
        waits = list(after.get((k, index), ()))
        if index:
            previous = f"{chain.robot}/{index - 1}"
            waits.insert(0, {"segment": previous, "cause": "same robot"})
        task = tpg.tasks[int(chain.task[first])]
        yield {
            "id": f"{chain.robot}/{index}",
            "robot": chain.robot,
            "task": {
                "index": task.index,
                "kind": task.kind,
                "step": task.step,
                "label": task.label,
                "object": task.object,
            },
            "nodes": [first, end - 1],
            "after": waits,
            "executed_s": [
                _seconds(int(started[first])),
                _seconds(int(ended[end - 1])),
            ],
            "handlings": handlings,
            "joint_trajectory": {
                "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
                "joint_names": list(tpg.cell.robot(chain.robot).model.joint_names),
                "points": [
                    _point(q, t_ns)
                    for q, t_ns in zip(
                        stands[low : high + 1].tolist(), times, strict=True
                    )
                ],
            },
        }


def _point(q: list[float], t_ns: int) -> dict[str, Any]:
    return {
        "positions": q,
        "velocities": [],
        "accelerations": [],
        "effort": [],
        "time_from_start": _duration(t_ns),
    }


def _duration(t_ns: int) -> dict[str, int]:
    seconds, rest = divmod(t_ns, NANOSECONDS)
    return {"sec": seconds, "nanosec": rest}


def _seconds(t_ns: int) -> float | None:
    return t_ns / NANOSECONDS if t_ns >= 0 else None
