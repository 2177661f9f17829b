"""Division of a run into motion segments of single robots, for export to robot controllers.

Within a segment, a robot waits for others only before the first node, and others wait only for its last node. If each
segment starts after all its predecessors, all edges of the temporal plan graph are satisfied for any delays.

For robots with acceleration limits, points of the executed motion are sampled at a given rate, with speeds and
accelerations. A standstill has only a first and a last point. For other robots, points have nominal times, and the
controller chooses the velocities. Points that are closer in time than one period of the rate are delayed, so all points
are at least one period apart, unless the whole segment is shorter.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from planning.errors import OutputError
from planning.tasks.task import Task
from planning.transforms import Array, Indices
from scheduling.graph.rollout import Rollout, earliest_times
from twin.activities.activities import CAUSES, SAME_ROBOT
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds, to_nanoseconds
from twin.runs.execution_record import waypoint_offsets_ns
from twin.runs.trajectory import Trajectory
from twin.trial.run_result import RunResult
from twin.uncertainty.contraction import Contraction, contract

CONTROLLER_RATES_HZ = (125.0, 1000.0)
"""Least and greatest rate of points that controllers accept [Hz]."""

CONTROLLER_RATE_HZ = 250.0
"""Default rate of points [Hz]."""

STILL = 1e-9
"""A joint that moves by less between two rows at rest counts as still: the difference is rounding [rad or m]."""

Span = tuple[int, int]
"""Start and end time [ns]; -1 for a start or end that has not happened."""


@dataclass(frozen=True)
class Predecessor:
    """A segment that must be complete before another one starts.

    Attributes:
        segment: its id.
        cause: one of ``CAUSES``, or ``SAME_ROBOT``.
    """

    segment: str
    cause: str


@dataclass(frozen=True)
class SegmentHandling:
    """Transfer of an object within a segment.

    Attributes:
        object: its name.
        holder: robot that has it from then on, None at rest.
        t_ns: when, from the start of the segment [ns].
    """

    object: str
    holder: str | None
    t_ns: int


@dataclass(frozen=True)
class Segment:
    """A stretch of a robot's nodes.

    Attributes:
        id: the robot and the number among its segments, ``left/3``.
        robot: its name.
        joint_names: of the robot.
        task: that the nodes belong to.
        nodes: the first and the last of them.
        after: segments that must be complete before it starts.
        nominal: its start and end if everything takes as long as planned.
        executed: its start and end in this run.
        motion: times of this run from which to which its motion was sampled; None if the points are the plan's.
        handlings: transfers of objects.
        t_ns: times of the points from the start of the segment, shape (points,) [ns].
        q: configurations, shape (points, n) [rad or m].
        v: joint speeds, likewise, None where they are left to the controller.
        a: accelerations, likewise.
    """

    id: str
    robot: str
    joint_names: tuple[str, ...]
    task: Task
    nodes: tuple[int, int]
    after: tuple[Predecessor, ...]
    nominal: Span
    executed: Span
    motion: Span | None
    handlings: tuple[SegmentHandling, ...]
    t_ns: Nanoseconds
    q: Array
    v: Array | None
    a: Array | None


def require_rate(rate_hz: float, rates_hz: tuple[float, float]) -> None:
    """Refuse a rate that is out of a range [Hz].

    Raises:
        OutputError: the rate is out of the range.
    """
    low, high = rates_hz
    if not low <= rate_hz <= high:
        raise OutputError(f"--rate-hz: {rate_hz:g} is not from {low:g} to {high:g}")


def segments(run: RunResult, rate_hz: float) -> Iterator[Segment]:
    """Yield the segments of a run, robot after robot, each robot's in order.

    Args:
        run: the run.
        rate_hz: of points where speeds are known, and the greatest one elsewhere [Hz].
    """
    found = contract(run.tpg)
    after = _predecessors(found)
    nominal = earliest_times(
        run.tpg, [to_nanoseconds(chain.duration) for chain in run.tpg.chains]
    )
    for k, first in enumerate(found.first):
        yield from _chain_segments(run, k, first, after, nominal, rate_hz)


def _predecessors(found: Contraction) -> dict[tuple[int, int], list[Predecessor]]:
    """Return the predecessors of each segment among other robots."""
    out: dict[tuple[int, int], list[Predecessor]] = defaultdict(list)
    chains = found.tpg.chains
    for edge, cause in zip(
        found.tpg.edges.tolist(), found.tpg.cause.tolist(), strict=True
    ):
        before, source, chain, target = edge
        name = f"{chains[before].robot}/{source}"
        out[chain, target].append(Predecessor(name, CAUSES[cause]))
    return out


def _chain_segments(
    run: RunResult,
    k: int,
    bounds: Indices,
    after: Mapping[tuple[int, int], list[Predecessor]],
    nominal: Rollout,
    rate_hz: float,
) -> Iterator[Segment]:
    """Yield the segments of a chain; ``bounds`` are their first nodes, and one more."""
    tpg, chain = run.tpg, run.tpg.chains[k]
    durations = to_nanoseconds(chain.duration)
    begin = np.cumsum(durations) - durations
    passed = np.repeat(begin, np.diff(chain.first))
    passed += waypoint_offsets_ns(chain, durations)
    stands = np.vstack([chain.start[None], chain.waypoints])
    started, ended = run.node_times_ns[k]
    smooth = run.smooth_motions.get(chain.robot)
    changed = {
        (event.node, event.object): event.t_ns
        for event in ([] if smooth is None else run.history)
        if event.robot == chain.robot and event.kind in ("attached", "detached")
    }
    spans = None if smooth is None else _spans(run, k, bounds, smooth)
    names = tuple(tpg.cell.robot(chain.robot).model.joint_names)
    for index, (first, end) in enumerate(pairwise(bounds.tolist())):
        zero = int(begin[first])
        low, high = int(chain.first[first]), int(chain.first[end])
        q, v, a = stands[low : high + 1], None, None
        planned = np.append(0, passed[low:high] - zero)
        slowed, kept = _at_least_apart(planned, q, _period_ns(rate_hz))
        t_ns, q = slowed[kept], q[kept]
        motion = None
        if smooth is not None and spans is not None and np.all(spans[index] >= 0):
            motion = int(spans[index, 0]), int(spans[index, 1])
            times = _sample_times(*motion, rate_hz, smooth)
            t_ns = times - motion[0]
            q, v, a = smooth.states_at(times)
        handlings = []
        for item in tpg.handlings:
            if item.robot == k and first <= item.node < end:
                if motion is not None:
                    at = changed.get((item.node, item.object))
                    if at is None:
                        raise OutputError(
                            f"{run.folder}: in node {item.node} of {chain.robot!r} the plan lets"
                            f" {item.object!r} change hands, of which the log does not tell"
                        )
                    at_ns = at - motion[0]
                else:
                    at_ns = int(slowed[chain.first[item.node] + item.waypoint - low])
                handlings.append(SegmentHandling(item.object, item.holder, at_ns))
        waits = list(after.get((k, index), ()))
        if index:
            waits.insert(0, Predecessor(f"{chain.robot}/{index - 1}", SAME_ROBOT))
        yield Segment(
            id=f"{chain.robot}/{index}",
            robot=chain.robot,
            joint_names=names,
            task=tpg.tasks[int(chain.task[first])],
            nodes=(first, end - 1),
            after=tuple(waits),
            nominal=(int(nominal.start[k][first]), int(nominal.end[k][end - 1])),
            executed=(int(started[first]), int(ended[end - 1])),
            motion=motion,
            handlings=tuple(handlings),
            t_ns=t_ns,
            q=q,
            v=v,
            a=a,
        )


def _spans(run: RunResult, k: int, bounds: Indices, motion: Trajectory) -> Indices:
    """Return when the motion of each segment begins and ends, shape (segments, 2); -1 for never.

    Between two nodes without a stop, the next one is reported begun, and the one before it complete, only once the robot
    has certainly passed their border: at most a lag after it has. This function returns the times of passing
    the borders themselves. A speed override makes the lag longer than planned.
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
    if motion.v is not None and len(border):
        # Where a robot waited at a border, it begins to move after the last row at rest.
        rest = motion.t_ns[~np.any(motion.v, axis=1)]
        last = rest[np.searchsorted(rest, high) - 1]
        low = np.where(last < spans[border - 1, 1], low, last)
    passes = low < spans[border - 1, 1]
    spans[border, 0] = low
    border, node, lag = border[passes], node[passes], lag[passes]
    low, high = low[passes], high[passes]
    at = chain.waypoints[chain.first[node] - 1]
    ahead = chain.waypoints[chain.first[node + 1] - 1] - at

    def past(t_ns: Indices) -> npt.NDArray[np.bool_]:
        return np.asarray(np.sum((motion.at(t_ns) - at) * ahead, axis=1) >= 0.0)

    while np.any(early := past(low) & (low > spans[border - 1, 0])):
        low = np.where(early, low - lag, low)
    while np.any(high - low > 1):
        middle = (low + high) // 2
        is_past = past(middle)
        low, high = np.where(is_past, low, middle), np.where(is_past, middle, high)
    spans[border, 0] = spans[border - 1, 1] = high
    return spans


def _period_ns(rate_hz: float) -> int:
    return math.ceil(NANOSECONDS / rate_hz)


def _at_least_apart(
    t_ns: Nanoseconds, q: Array, period: int
) -> tuple[Nanoseconds, Indices]:
    """Return times of points at least a period apart [ns], and the points kept.

    A point is left out if it has the time and the configuration of the one before it.

    Args:
        t_ns: as planned, the first 0, shape (points,) [ns].
        q: configurations, shape (points, n).
        period: [ns].
    """
    apart = np.diff(t_ns)
    kept = (apart > 0) | np.any(np.diff(q, axis=0) != 0.0, axis=1)
    apart = np.where(kept, np.maximum(apart, period), 0)
    return np.append(0, np.cumsum(apart)), np.flatnonzero(np.append(True, kept))


def _sample_times(
    begin: int, end: int, rate_hz: float, motion: Trajectory
) -> Nanoseconds:
    """Return times of points from a time to another [ns], both included.

    They are a period apart, except that the last two may be up to two periods apart. A standstill has only a first
    and a last point.
    """
    period = _period_ns(rate_hz)
    stop = max((end - begin) // period, 1)
    runs, low = [], 0
    for stands, moves in _standstills(motion, begin, end):
        first, last = -(-(stands - begin) // period), (moves - begin) // period
        if first < last:
            runs.append(np.arange(low, min(first + 1, stop)))
            low = last
    k = np.concatenate([*runs, np.arange(low, stop)])
    return np.unique(np.append(begin + k * period, end))


def _standstills(motion: Trajectory, begin: int, end: int) -> Iterator[Span]:
    """Yield the standstills of a robot between two times, in order [ns]."""
    assert motion.v is not None
    assert motion.a is not None
    low = int(np.searchsorted(motion.t_ns, begin, side="right"))
    high = int(np.searchsorted(motion.t_ns, end, side="left"))
    rows = slice(max(low - 1, 0), high + 1)
    t, q = motion.t_ns[rows], motion.q[rows]
    rests = np.all((motion.v[rows] == 0.0) & (motion.a[rows] == 0.0), axis=1)
    same = np.all(np.abs(np.diff(q, axis=0)) < STILL, axis=1)
    for k in np.flatnonzero(rests[:-1] & rests[1:] & same).tolist():
        yield max(int(t[k]), begin), min(int(t[k + 1]), end)
