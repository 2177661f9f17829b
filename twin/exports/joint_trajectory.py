"""Motions for controllers: JSON in the shape of trajectory_msgs/JointTrajectory, a segment each.

A segment is a stretch of one robot's nodes that nothing else can interrupt: it waits for others
only before its first node, and others wait for nothing within it but its last. Whoever executes a
segment when all segments in its ``after`` are complete keeps to the temporal plan graph, whatever
the delays. Robots that keep to limits of acceleration have points of what was executed, at a rate,
with speeds and accelerations. Other points are timed by the nominal durations, and velocities are
left to the controller.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from planning.errors import OutputError
from planning.transforms import Array, Indices
from scheduling.graph.rollout import Rollout, earliest_times
from twin.durations import NANOSECONDS, to_nanoseconds
from twin.exports.recorded_run import RecordedRun
from twin.run.activities import CAUSES
from twin.run.run_record import waypoint_offsets_ns
from twin.run.trajectory import Trajectory
from twin.uncertainty.contraction import Contraction, contract

FORMAT = "assembly-twin joint trajectories"
VERSION = 2
RATES_HZ = (125.0, 1000.0)
RATE_HZ = 250.0

Points = tuple[list[int], Array, Array | None, Array | None]
"""Times from the start of a segment [ns], configurations, speeds and accelerations."""


def joint_trajectory_files(
    run: RecordedRun, *, rate_hz: float = RATE_HZ
) -> Mapping[str, bytes]:
    """Return ``joint_trajectories.json``.

    Args:
        run: the run.
        rate_hz: of points where speeds are known [Hz].

    Raises:
        OutputError: controllers take no such rate.
    """
    low, high = RATES_HZ
    if not low <= rate_hz <= high:
        raise OutputError(f"--rate-hz: {rate_hz:g} is not from {low:g} to {high:g}")
    found = contract(run.tpg)
    after = _after(found)
    nominal = earliest_times(
        run.tpg, [to_nanoseconds(chain.duration) for chain in run.tpg.chains]
    )
    segments = [
        segment
        for k, first in enumerate(found.first)
        for segment in _segments(run, k, first, after, nominal, rate_hz)
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
    nominal: Rollout,
    rate_hz: float,
) -> Iterator[dict[str, Any]]:
    """Yield the segments of a chain; ``bounds`` are their first nodes, and one more."""
    tpg, chain = run.tpg, run.tpg.chains[k]
    durations = to_nanoseconds(chain.duration)
    begin = np.cumsum(durations) - durations
    passed = np.repeat(begin, np.diff(chain.first))
    passed += waypoint_offsets_ns(chain, durations)
    stands = np.vstack([chain.start[None], chain.waypoints])
    started, ended = run.node_times_ns[k]
    smooth = run.smooth_motions.get(chain.robot)
    changed = _changes(run, chain.robot) if smooth is not None else {}
    spans = None if smooth is None else _spans(run, k, bounds, smooth)
    for index, (first, end) in enumerate(pairwise(bounds.tolist())):
        zero = int(begin[first])
        low, high = int(chain.first[first]), int(chain.first[end])
        points: Points = (
            [0, *(passed[low:high] - zero).tolist()],
            stands[low : high + 1],
            None,
            None,
        )
        span = [-1, -1] if spans is None else spans[index].tolist()
        executed = span[0] >= 0 and span[1] >= 0
        if smooth is not None and executed:
            points = _sampled(smooth, span[0], span[1], rate_hz)
        handlings = []
        for item in tpg.handlings:
            if item.robot == k and first <= item.node < end:
                t_ns = int(begin[item.node])
                if item.waypoint:
                    t_ns = int(passed[chain.first[item.node] + item.waypoint - 1])
                t_ns -= zero
                if executed:
                    t_ns = changed[item.node, item.object] - span[0]
                handlings.append(
                    {
                        "object": item.object,
                        "holder": item.holder,
                        "time_from_start": _duration(t_ns),
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
            "nominal_s": [
                _seconds(int(nominal.start[k][first])),
                _seconds(int(nominal.end[k][end - 1])),
            ],
            "executed_s": [
                _seconds(int(started[first])),
                _seconds(int(ended[end - 1])),
            ],
            "motion_s": [_seconds(t) for t in span] if executed else None,
            "handlings": handlings,
            "joint_trajectory": {
                "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
                "joint_names": list(tpg.cell.robot(chain.robot).model.joint_names),
                "points": _points(points),
            },
        }


def _changes(run: RecordedRun, robot: str) -> dict[tuple[int, str], int]:
    """Return when objects changed hands [ns], by node of a robot and object."""
    return {
        (event.node, event.object): event.t_ns
        for event in run.events
        if event.robot == robot and event.kind in ("attached", "detached")
    }


def _spans(run: RecordedRun, k: int, bounds: Indices, motion: Trajectory) -> Indices:
    """Return when the motion of each segment begins and ends, shape (segments, 2); -1 for never.

    A node that is entered at speed counts as begun, and the one before it as complete, when the
    robot has certainly passed their border, up to a lag after it has: motions are cut where it does.
    """
    chain = run.tpg.chains[k]
    assert chain.drive is not None
    started, ended = run.node_times_ns[k]
    spans = np.column_stack([started[bounds[:-1]], ended[bounds[1:] - 1]])
    border = np.arange(1, len(spans))
    node = bounds[border]
    lag = np.ceil(chain.drive.lag[node] * NANOSECONDS).astype(np.int64)
    begins = (~chain.drive.rests[node - 1]) & (spans[1:, 0] >= 0)
    border, node, lag = border[begins], node[begins], lag[begins]
    low, high = spans[border, 0] - lag, spans[border, 0]
    passes = low < spans[border - 1, 1]
    spans[border, 0] = low
    border, node, low, high = (x[passes] for x in (border, node, low, high))
    at = chain.waypoints[chain.first[node] - 1]
    ahead = chain.waypoints[chain.first[node + 1] - 1] - at
    while np.any(high - low > 1):
        middle = (low + high) // 2
        past = np.sum((motion.at(middle) - at) * ahead, axis=1) >= 0.0
        low, high = np.where(past, low, middle), np.where(past, middle, high)
    spans[border, 0] = spans[border - 1, 1] = high
    return spans


def _sampled(motion: Trajectory, begin: int, end: int, rate_hz: float) -> Points:
    """Return points of a motion from a time to another [ns], both included."""
    count = int((end - begin) * rate_hz / NANOSECONDS) + 1
    grid = begin + np.rint(np.arange(count) * (NANOSECONDS / rate_hz)).astype(np.int64)
    times = np.unique(np.append(grid[grid < end], [begin, end]))
    return (times - begin).tolist(), *motion.states_at(times)


def _points(points: Points) -> list[dict[str, Any]]:
    times, q, v, a = points
    empty: list[list[float]] = [[]] * len(times)
    return [
        {
            "positions": at,
            "velocities": speed,
            "accelerations": rise,
            "effort": [],
            "time_from_start": _duration(t_ns),
        }
        for t_ns, at, speed, rise in zip(
            times,
            q.tolist(),
            empty if v is None else v.tolist(),
            empty if a is None else a.tolist(),
            strict=True,
        )
    ]


def _duration(t_ns: int) -> dict[str, int]:
    seconds, rest = divmod(t_ns, NANOSECONDS)
    return {"sec": seconds, "nanosec": rest}


def _seconds(t_ns: int) -> float | None:
    return t_ns / NANOSECONDS if t_ns >= 0 else None
