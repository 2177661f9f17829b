"""Motions for controllers: JSON in the shape of trajectory_msgs/JointTrajectory, a segment each.

A segment is a stretch of one robot's nodes that nothing else can interrupt: it waits for others
only before its first node, and others wait for nothing within it but its last. Whoever executes a
segment when all segments in its ``after`` are complete keeps to the temporal plan graph, whatever
the delays. Points are timed by the nominal durations, velocities are left to the controller.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds, to_nanoseconds
from twin.exports.recorded_run import RecordedRun
from twin.run.lanes import CAUSES
from twin.run.run_record import waypoint_offsets_ns
from twin.uncertainty.contraction import Contraction, contract

FORMAT = "assembly-twin joint trajectories"
VERSION = 1


def joint_trajectory_files(run: RecordedRun) -> Mapping[str, bytes]:
    """Return ``joint_trajectories.json``."""
    found = contract(run.tpg)
    after = _after(found)
    segments: list[dict[str, Any]] = []
    for k, chain in enumerate(run.tpg.chains):
        durations = to_nanoseconds(chain.duration)
        offsets = waypoint_offsets_ns(chain, durations)
        for index, (first, end) in enumerate(pairwise(found.first[k].tolist())):
            nodes = range(first, end)
            segments.append(
                _segment(run, k, index, nodes, after[k, index], durations, offsets)
            )
    document = {
        "format": FORMAT,
        "version": VERSION,
        "scenario": run.scenario,
        "segments": segments,
    }
    text = json.dumps(document, ensure_ascii=False, allow_nan=False)
    return {"joint_trajectories.json": text.encode() + b"\n"}


def segment_id(robot: str, index: int) -> str:
    """Return the identity of a segment."""
    return f"{robot}/{index}"


def _after(found: Contraction) -> dict[tuple[int, int], list[dict[str, str]]]:
    """Return the segments of other robots that each segment has to wait for."""
    out: dict[tuple[int, int], list[dict[str, str]]] = defaultdict(list)
    chains = found.tpg.chains
    for edge, cause in zip(
        found.tpg.edges.tolist(), found.tpg.cause.tolist(), strict=True
    ):
        before, source, chain, target = edge
        out[chain, target].append(
            {
                "segment": segment_id(chains[before].robot, source),
                "cause": CAUSES[cause],
            }
        )
    return out


def _segment(
    run: RecordedRun,
    k: int,
    index: int,
    nodes: range,
    after: list[dict[str, str]],
    durations: Nanoseconds,
    offsets: Nanoseconds,
) -> dict[str, Any]:
    tpg, chain = run.tpg, run.tpg.chains[k]
    task = tpg.tasks[int(chain.task[nodes[0]])]
    begin = _begin_of_nodes(durations, nodes)
    points = [_point(_configuration_before(chain, nodes[0]), 0)]
    arrival: dict[tuple[int, int], int] = {}
    for node in nodes:
        arrival[node, 0] = begin[node]
        low, high = int(chain.first[node]), int(chain.first[node + 1])
        for number, waypoint in enumerate(range(low, high), start=1):
            t_ns = begin[node] + int(offsets[waypoint])
            arrival[node, number] = t_ns
            points.append(_point(chain.waypoints[waypoint].tolist(), t_ns))
    start, end = run.node_times_ns[k]
    return {
        "id": segment_id(chain.robot, index),
        "robot": chain.robot,
        "task": {
            "index": task.index,
            "kind": task.kind,
            "step": task.step,
            "label": task.label,
            "object": task.object,
        },
        "nodes": [nodes[0], nodes[-1]],
        "after": [
            *(
                [{"segment": segment_id(chain.robot, index - 1), "cause": "same robot"}]
                if index
                else []
            ),
            *after,
        ],
        "executed_s": [_seconds(int(start[nodes[0]])), _seconds(int(end[nodes[-1]]))],
        "handlings": _handlings(tpg, k, arrival),
        "joint_trajectory": {
            "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
            "joint_names": list(tpg.cell.robot(chain.robot).model.joint_names),
            "points": points,
        },
    }


def _begin_of_nodes(durations: Nanoseconds, nodes: range) -> dict[int, int]:
    """Return when each node of a segment begins, counted from the segment's start [ns]."""
    out, clock = {}, 0
    for node in nodes:
        out[node] = clock
        clock += int(durations[node])
    return out


def _configuration_before(chain: NodeChain, node: int) -> list[float]:
    waypoint = int(chain.first[node]) - 1
    q = chain.start if waypoint < 0 else chain.waypoints[waypoint]
    values: list[float] = q.tolist()
    return values


def _point(q: list[float], t_ns: int) -> dict[str, Any]:
    return {
        "positions": q,
        "velocities": [],
        "accelerations": [],
        "effort": [],
        "time_from_start": _duration(t_ns),
    }


def _handlings(
    tpg: TemporalPlanGraph, k: int, arrival: Mapping[tuple[int, int], int]
) -> list[dict[str, Any]]:
    return [
        {
            "object": item.object,
            "holder": item.holder,
            "time_from_start": _duration(arrival[item.node, item.waypoint]),
        }
        for item in tpg.handlings
        if item.robot == k and (item.node, item.waypoint) in arrival
    ]


def _duration(t_ns: int) -> dict[str, int]:
    seconds, rest = divmod(t_ns, NANOSECONDS)
    return {"sec": seconds, "nanosec": rest}


def _seconds(t_ns: int) -> float | None:
    return t_ns / NANOSECONDS if t_ns >= 0 else None
