"""Where everything was, and when: the motion of a run, from its node times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.transforms import Array, Transform
from scheduling.temporal_plan_graph import Indices, NodeChain, TemporalPlanGraph
from twin.durations import Nanoseconds
from twin.run import Run, waypoint_offsets_ns


@dataclass(frozen=True)
class Trajectory:
    """The motion of one robot; linear interpolation between its rows is the motion.

    Attributes:
        robot: its name.
        t_ns: shape (rows,), never falling, from 0 to the makespan [ns].
        q: configurations, shape (rows, n).
        node: node of the robot that each row belongs to, shape (rows,); -1 before the first.
    """

    robot: str
    t_ns: Nanoseconds
    q: Array
    node: Indices

    def at(self, t_ns: Nanoseconds) -> Array:
        """Return the configurations at some times, shape (times, n)."""
        t = t_ns.astype(float)
        return np.stack(
            [np.interp(t, self.t_ns.astype(float), column) for column in self.q.T],
            axis=1,
        )


@dataclass(frozen=True)
class Placement:
    """From a time on, an object is somewhere.

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


def robot_trajectories(tpg: TemporalPlanGraph, run: Run) -> tuple[Trajectory, ...]:
    """Return the motion of every robot of the cell, in the cell's order.

    There is a row for every waypoint passed and at both ends of every wait and stall. A run
    that was broken off ends in the middle of its motions.
    """
    chains = {chain.robot: k for k, chain in enumerate(tpg.chains)}
    found = []
    for robot in tpg.cell.robots:
        if robot.name in chains:
            k = chains[robot.name]
            found.append(_chain_trajectory(tpg.chains[k], run, k))
        else:
            ends = np.array([0, run.makespan_ns], dtype=np.int64)
            home = np.stack([robot.home, robot.home])
            found.append(Trajectory(robot.name, ends, home, np.full(2, -1)))
    return tuple(found)


def _chain_trajectory(chain: NodeChain, run: Run, k: int) -> Trajectory:
    count = int(np.count_nonzero(run.start_ns[k] >= 0))
    nodes = np.arange(count)
    start, stall = run.start_ns[k][:count], run.stall_ns[k][:count]
    passed = int(chain.first[count])
    path = np.vstack([chain.start[None], chain.waypoints[:passed]])
    of_waypoint = np.repeat(nodes, np.diff(chain.first[: count + 1]))
    offset = waypoint_offsets_ns(chain, run.duration_ns[k])[:passed]
    arrival = (start + stall)[of_waypoint] + offset
    # The robot stands where the node before ended, until it starts and then until it moves.
    stands = path[chain.first[:count]]
    before = np.concatenate([[0], run.end_ns[k][:count][:-1]]) if count else start
    waited, stalled = start > before, stall > 0
    t = np.concatenate([[0], start[waited], (start + stall)[stalled], arrival])
    q = np.vstack([path[:1], stands[waited], stands[stalled], path[1:]])
    node = np.concatenate([[-1], nodes[waited], nodes[stalled], of_waypoint])
    counts = [1, int(np.sum(waited)), int(np.sum(stalled)), passed]
    slot = np.repeat(np.array([0, 0, 1, 2]), counts)
    order = np.lexsort((t, slot, node))
    return _until(
        Trajectory(chain.robot, t[order], q[order], node[order]), run.makespan_ns
    )


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


def object_placements(tpg: TemporalPlanGraph, run: Run) -> tuple[Placement, ...]:
    """Return where every object was: at the start, and from every change on, by time.

    An object that comes up later has no row before it does.
    """
    placements = [
        Placement(0, o.name, None, o.start) for o in tpg.cell.objects if not o.later
    ]
    offsets = [
        waypoint_offsets_ns(chain, duration)
        for chain, duration in zip(tpg.chains, run.duration_ns, strict=True)
    ]
    for item in tpg.handlings:
        start = int(run.start_ns[item.robot][item.node])
        t_ns = start + int(run.stall_ns[item.robot][item.node])
        if item.waypoint > 0:
            first = int(tpg.chains[item.robot].first[item.node])
            t_ns += int(offsets[item.robot][first + item.waypoint - 1])
        if start >= 0 and t_ns <= run.makespan_ns:
            placements.append(Placement(t_ns, item.object, item.holder, item.pose))
    return tuple(sorted(placements, key=lambda placement: placement.t_ns))
