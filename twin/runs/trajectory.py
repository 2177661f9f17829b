"""Trajectories of robots and poses of objects, computed from the start and end times of the nodes of a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.transforms import Array, Indices, Transform
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.runs.cubic_motion import cubic_at
from twin.runs.driven_motion import driven_rows, stopped_motion
from twin.runs.execution_record import ExecutionRecord, Measured, waypoint_offsets_ns


@dataclass(frozen=True)
class Trajectory:
    """Motion of one robot: linear between its rows, or cubic in time if speeds are known.

    Attributes:
        robot: its name.
        t_ns: shape (rows,), non-decreasing, from 0 to the makespan [ns].
        q: configurations, shape (rows, n).
        node: node of the robot that each row belongs to, shape (rows,); -1 before the first.
        v: joint speeds, shape (rows, n) [rad/s or m/s]; None where robots are at full speed at
            once. With it, times rise.
        a: accelerations, linear in time between rows, likewise [rad/s^2 or m/s^2].
    """

    robot: str
    t_ns: Nanoseconds
    q: Array
    node: Indices
    v: Array | None = None
    a: Array | None = None

    def at(self, t_ns: Nanoseconds) -> Array:
        """Return the configurations at given times, shape (times, n)."""
        if self.v is not None:
            return self.states_at(t_ns)[0]
        t = t_ns.astype(float)
        return np.stack(
            [np.interp(t, self.t_ns.astype(float), column) for column in self.q.T],
            axis=1,
        )

    def states_at(self, t_ns: Nanoseconds) -> tuple[Array, Array, Array]:
        """Return configurations, speeds and accelerations at given times, where speeds are known."""
        assert self.v is not None
        return cubic_at(self.t_ns / NANOSECONDS, self.q, self.v, t_ns / NANOSECONDS)


@dataclass(frozen=True)
class Placement:
    """Pose and parent of an object from a time on.

    Attributes:
        t_ns: when [ns].
        object: its name.
        holder: robot that holds it, None at rest.
        pose: of its centre in the holder's flange frame, or in the world.
    """

    t_ns: int
    object: str
    holder: str | None
    pose: Transform


def robot_trajectories(
    tpg: TemporalPlanGraph, run: ExecutionRecord
) -> tuple[Trajectory, ...]:
    """Return the motion of every robot of the cell, in the cell's order.

    There is a row for every waypoint passed and at both ends of every wait and stall. A run
    that was broken off ends in the middle of its motions.
    """
    chains = {chain.robot: k for k, chain in enumerate(tpg.chains)}
    found = []
    for robot in tpg.cell.robots:
        if (measured := run.measured.get(robot.name)) is not None:
            found.append(_as_measured(robot.name, measured, run.makespan_ns))
        elif robot.name in chains:
            k = chains[robot.name]
            if tpg.chains[k].drive is None:
                found.append(_chain_trajectory(tpg.chains[k], run, k))
            else:
                found.append(_driven_trajectory(tpg, run, k))
        else:
            ends = np.array([0, run.makespan_ns], dtype=np.int64)
            home = np.stack([robot.home, robot.home])
            still = None if robot.limits is None else np.zeros_like(home)
            nodes = np.full(2, -1)
            found.append(Trajectory(robot.name, ends, home, nodes, still, still))
    return tuple(found)


def _as_measured(robot: str, own: Measured, end_ns: int) -> Trajectory:
    """Return the measured motion of a robot over the whole run."""
    kept = int(np.searchsorted(own.t_ns, end_ns, side="right"))
    t = np.concatenate([[0], own.t_ns[:kept], [end_ns]])
    q = np.vstack([own.q[:1], own.q[:kept], own.q[max(kept - 1, 0)][None]])
    node = np.concatenate([[-1], own.node[:kept], own.node[max(kept - 1, 0)][None]])
    return Trajectory(robot, t, q, node)


def _driven_trajectory(
    tpg: TemporalPlanGraph, run: ExecutionRecord, k: int
) -> Trajectory:
    """Return the motion of a robot with acceleration limits, until the run ends."""
    t, q, v, a, node = driven_rows(tpg, run, k)
    until = run.makespan_ns
    keep = t < until
    still = np.zeros_like(v[-1:])
    if t[-1] <= until:
        last = q[-1:], still, still
    else:
        last = cubic_at(t / NANOSECONDS, q, v, np.array([until]) / NANOSECONDS)
    cut = min(int(np.count_nonzero(keep)), len(node) - 1)
    ends = np.array([*t[keep], until])
    return Trajectory(
        tpg.chains[k].robot,
        ends,
        np.vstack([q[keep], last[0]]),
        np.append(node[keep], node[cut]),
        np.vstack([v[keep], last[1]]),
        np.vstack([a[keep], last[2]]),
    )


def _chain_trajectory(chain: NodeChain, run: ExecutionRecord, k: int) -> Trajectory:
    """Return the motion of a robot that has tasks; computed by its own clock first."""
    pace = run.pace(k)
    count = int(np.count_nonzero(run.start_ns[k] >= 0))
    # A node whose task failed never moves.
    moves = count - (count > 0 and run.failed_nodes[k] == count - 1)
    nodes = np.arange(count)
    start, stall = pace.own(run.start_ns[k][:count]), run.stood_ns[k][:count]
    passed = int(chain.first[moves])
    path = np.vstack([chain.start[None], chain.waypoints[:passed]])
    of_waypoint = np.repeat(nodes[:moves], np.diff(chain.first[: moves + 1]))
    offset = waypoint_offsets_ns(chain, run.duration_ns[k])[:passed]
    arrival = (start + stall)[of_waypoint] + offset
    # The robot stands where the node before ended, until it starts and then until it moves.
    stands = path[chain.first[:count]]
    before = np.concatenate([[0], pace.own(run.end_ns[k][:count])])[:count]
    waited, stalled = start > before, stall > 0
    t = np.concatenate([[0], start[waited], (start + stall)[stalled], arrival])
    q = np.vstack([path[:1], stands[waited], stands[stalled], path[1:]])
    node = np.concatenate([[-1], nodes[waited], nodes[stalled], of_waypoint])
    counts = [1, int(np.sum(waited)), int(np.sum(stalled)), passed]
    slot = np.repeat(np.array([0, 0, 1, 2]), counts)
    order = np.lexsort((t, slot, node))
    motion = Trajectory(chain.robot, t[order], q[order], node[order])
    end_ns = int(pace.own(np.array([run.makespan_ns]))[0])
    return _with_stops(_until(motion, end_ns), run, k)


def _with_stops(motion: Trajectory, run: ExecutionRecord, k: int) -> Trajectory:
    """Return a motion in the run's time, with a row at both ends of every stop."""
    stops = run.stops_ns[k]
    if not stops:
        return motion
    pace = run.pace(k)
    stops_at = pace.stops_at
    row = np.searchsorted(motion.t_ns, stops_at, side="left")
    # What comes at the instant of a stop, nodes of no length too, comes after it.
    there = motion.t_ns[np.minimum(row, len(motion.t_ns) - 1)] == stops_at
    stands = np.where(
        there[:, None],
        motion.q[np.minimum(row, len(motion.q) - 1)],
        motion.at(stops_at),
    )
    node = motion.node[np.minimum(row, len(motion.node) - 1)]
    edges = np.array(stops, dtype=np.int64)
    t = np.concatenate(
        [
            np.minimum(pace.real(motion.t_ns), run.makespan_ns),
            edges[:, 0],
            np.minimum(edges[:, 1], run.makespan_ns),
        ]
    )
    q = np.vstack([motion.q, stands, stands])
    nodes = np.concatenate([motion.node, node, node])
    own = np.concatenate([motion.t_ns, stops_at, stops_at])
    # At the own time of a stop: first it begins, then it ends, then come the rows there are.
    slot = np.repeat([2, 0, 1], [len(motion.t_ns), len(stops), len(stops)])
    order = np.lexsort((slot, own))
    order = order[np.argsort(t[order], kind="stable")]
    return Trajectory(motion.robot, t[order], q[order], nodes[order])


def _until(motion: Trajectory, end_ns: int) -> Trajectory:
    """Cut a trajectory off, or let the robot stand, so that it ends at a time."""
    keep = motion.t_ns <= end_ns
    last = Trajectory(
        motion.robot, motion.t_ns[keep], motion.q[keep], motion.node[keep]
    )
    if last.t_ns[-1] == end_ns:
        return last
    cut = int(np.count_nonzero(keep))
    node = motion.node[min(cut, len(motion.node) - 1)]
    return Trajectory(
        motion.robot,
        np.append(last.t_ns, end_ns),
        np.vstack([last.q, motion.at(np.array([end_ns]))]),
        np.append(last.node, node),
    )


def object_placements(
    tpg: TemporalPlanGraph, run: ExecutionRecord
) -> tuple[Placement, ...]:
    """Return the placements of every object, at the start and after every change, by time.

    An object that comes up later has no row before it does.
    """
    held = {h.object: h for h in tpg.handlings if tpg.holds_before(h)}
    placements = [
        Placement(0, o.name, None, o.start)
        if o.name not in held
        else Placement(0, o.name, held[o.name].holder, held[o.name].pose)
        for o in tpg.cell.objects
        if not o.later
    ]
    offsets = [
        waypoint_offsets_ns(chain, duration)
        for chain, duration in zip(tpg.chains, run.duration_ns, strict=True)
    ]
    for item in tpg.handlings:
        if tpg.holds_before(item):
            continue
        start = int(run.start_ns[item.robot][item.node])
        if start < 0 or run.failed_nodes[item.robot] == item.node:
            continue
        stopped = stopped_motion(tpg, run, item.robot, item.node)
        at = int(tpg.chains[item.robot].first[item.node]) + item.waypoint - 1
        if stopped is not None and item.waypoint > 0:
            own = tpg.chains[item.robot].fraction[at] * stopped.planned[-1]
            t_ns = round(stopped.stopped_times(own) * NANOSECONDS)
        else:
            passed = int(run.stood_ns[item.robot][item.node])
            if item.waypoint > 0:
                passed += int(offsets[item.robot][at])
            pace = run.pace(item.robot)
            t_ns = int(pace.real(pace.own(np.array([start])) + passed)[0])
        if t_ns <= run.makespan_ns:
            placements.append(Placement(t_ns, item.object, item.holder, item.pose))
    return tuple(sorted(placements, key=lambda placement: placement.t_ns))
