"""Data structure of the multi-modal temporal plan graph (TPG; APEX-MR, section IV-C).

A node is a piece of motion of one robot: from the last waypoint of the node before it, through
its own waypoints, to the last of them. Pose nodes have one waypoint, skill nodes their whole
reference path. Type-1 edges join consecutive nodes of a robot and are not stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
import numpy.typing as npt

from planning.bounds import LATEST_S
from planning.cell.workcell import Workcell
from planning.tasks.task import AllowedContact, Task, TaskKind, TimeWindow
from planning.transforms import Array, Indices, Transform
from scheduling.graph.columns import Column

BY_JOINTS, BY_TOOL_SPEED, BY_EFFORT = 0, 1, 2
"""What sets the times of a node: speed, acceleration and jerk of joints; the speed of the tool; or,
from ``BY_EFFORT`` on, the effort of the joint that is counted on from there. Below zero, counted down
from -1, is a joint whose effort does not bear the weight, however slow it is."""

EVER = 2**61
"""Patience of an edge that holds until its source is complete [ns]."""

TASK_DEPENDENCY = 0
MOTION_CONFLICT = 1

Causes = npt.NDArray[np.uint8]
"""TASK_DEPENDENCY or MOTION_CONFLICT, one per edge."""

SECONDS = Column(("nodes",), least=0.0, largest=LATEST_S)
"""Schema of times of nodes [s]."""

NO_EDGES = np.empty((0, 4), dtype=np.int64), np.empty(0, dtype=np.uint8)
"""Edges of a graph without any, and their causes."""


@dataclass(frozen=True, eq=False)
class Drive:
    """Timing limits of the nodes of a chain, one entry per node.

    Consecutive pose nodes on a straight line in joint space, and around rounded corners of it, are a
    *stretch*: the robot passes the borders between them at speed, and is at rest at both ends of it.
    Skill nodes, and nodes that do not move, begin and end at rest.

    Attributes:
        cruise: time at full speed; of a skill, its least duration [s].
        ramp: time from rest to full speed, longer around rounded corners; 0 for what is no part of
            a stretch [s].
        lag: by how much the executed motion is behind the commanded one, the same for all nodes of
            a stretch; 0 for what is no part of one [s].
        rests: whether the robot is at rest at the end of the node.
        slowed: how many times as long its stretch or skill takes as by the limits of speed,
            acceleration and jerk of joints.
        slowed_by: what asks for that: ``BY_JOINTS``, ``BY_TOOL_SPEED``, or a joint's effort.
        cap: greatest share of full speed at which the node may be passed; 1 but around rounded
            corners.
    """

    cruise: Annotated[Array, SECONDS]
    ramp: Annotated[Array, SECONDS]
    lag: Annotated[Array, SECONDS]
    rests: Annotated[npt.NDArray[np.bool_], Column(("nodes",), np.bool_)]
    slowed: Annotated[Array, SECONDS]
    slowed_by: Annotated[Indices, Column(("nodes",), np.int64)]
    cap: Annotated[Array, Column(("nodes",), least=0.0, most=1.0)]

    @property
    def least(self) -> Array:
        """Least duration of each node [s]."""
        return self.cruise / self.cap

    def cut(self, nodes: slice) -> Drive:
        """Return the entries of some nodes; they end at rest."""
        own = {name: values[nodes] for name, values in vars(self).items()}
        own["rests"] = own["rests"].copy()
        own["rests"][-1:] = True
        return Drive(**own)

    def repeated(self, times: int) -> Drive:
        """Return the entries repeated a number of times."""
        return joined_drives([self] * times)


def joined_drives(parts: Sequence[Drive]) -> Drive:
    """Return the concatenated entries of two runs of nodes."""
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return Drive(*map(np.concatenate, columns))


@dataclass(frozen=True, eq=False)
class RoundedCorners:
    """Rounded corners of a chain, in order, in *bends*: the corners of a bend share its curve.

    The pose nodes of a bend are a curve from one straight path to another, see
    ``planning.timing.rounded_path``; their waypoints are on it, so close that chords are as good, and equal
    times apart. It begins where the first node does and ends where the last one does.

    Attributes:
        begin: first node of each bend, shape (b,).
        stop: the node after the last one of each bend, shape (b,).
        length: time of each bend at full speed, in a unit of its own, shape (b,).
        bend: the bend that each corner is part of, shape (k,).
        at: path parameter of each corner from the start of its bend, in that unit, shape (k,).
        window: over which it is rounded, in that unit, shape (k,).
        corner: intersection of the straight legs, shape (k, n).
    """

    begin: Annotated[Indices, Column(("bends",), np.int64)]
    stop: Annotated[Indices, Column(("bends",), np.int64)]
    length: Annotated[Array, Column(("bends",))]
    bend: Annotated[Indices, Column(("corners",), np.int64)]
    at: Annotated[Array, Column(("corners",))]
    window: Annotated[Array, Column(("corners",))]
    corner: Annotated[Array, Column(("corners", "joints"))]

    def inside(self, first: int, stop: int) -> RoundedCorners | None:
        """Return the corners within nodes ``range(first, stop)``, numbered from ``first``; None for none."""
        own = np.flatnonzero((self.begin >= first) & (self.stop <= stop))
        return joined_corners((self._picked(own), -first))

    def outside(self, first: int, stop: int) -> RoundedCorners | None:
        """Return the corners without a node within ``range(first, stop)``; None for none."""
        own = np.flatnonzero((self.begin >= stop) | (self.stop <= first))
        return joined_corners((self._picked(own), 0))

    def repeated(self, times: int, nodes: int) -> RoundedCorners | None:
        """Return the corners of a repeated chain of some nodes."""
        return joined_corners(*((self, k * nodes) for k in range(times)))

    def _picked(self, own: Indices) -> RoundedCorners:
        """Return some bends with their corners."""
        corners = [np.flatnonzero(self.bend == k) for k in own]
        rows = np.concatenate([*corners, np.empty(0, dtype=np.int64)])
        counts = [len(part) for part in corners]
        return RoundedCorners(
            self.begin[own],
            self.stop[own],
            self.length[own],
            np.repeat(np.arange(len(own)), counts),
            self.at[rows],
            self.window[rows],
            self.corner[rows],
        )


def joined_corners(
    *parts: tuple[RoundedCorners | None, int],
) -> RoundedCorners | None:
    """Return the corners of a chain in order, None for none.

    Args:
        parts: some of its corners, and the node from which their nodes are numbered.
    """
    some = [(part, by) for part, by in parts if part is not None and len(part.begin)]
    if not some:
        return None
    bends = np.cumsum([0, *(len(part.begin) for part, _ in some)])
    moved = [
        vars(part)
        | {"begin": part.begin + by, "stop": part.stop + by, "bend": part.bend + first}
        for (part, by), first in zip(some, bends, strict=False)
    ]
    joined = RoundedCorners(
        **{name: np.concatenate([own[name] for own in moved]) for name in moved[0]}
    )
    return joined._picked(np.argsort(joined.begin))


@dataclass(frozen=True)
class NodeChain:
    """All nodes of one robot, in order.

    Attributes:
        robot: its name.
        start: configuration before the first node, shape (n,).
        waypoints: of all nodes, shape (p, n); node k owns ``waypoints[first[k]:first[k + 1]]``.
        fraction: share of its node's duration that has passed at each waypoint, shape (p,),
            rising to 1 at a node's last waypoint.
        first: shape (nodes + 1,).
        task: task index of each node, shape (nodes,), non-decreasing.
        skill: True for skill nodes, shape (nodes,).
        duration: nominal duration of each node, shape (nodes,) [s].
        planned_start: start of each node in the input plan, shape (nodes,) [s].
        least: least duration of each node that the joints' speed limits allow, shape (nodes,)
            [s], in a graph that is kept without paths; empty where the waypoints say it.
        drive: how nodes are passed within limits of acceleration; None where robots are at full
            speed at once.
        corners: that are rounded; None for none.
    """

    robot: str
    start: Annotated[Array, Column(("joints",))]
    waypoints: Annotated[Array, Column(("points", "joints"))]
    fraction: Annotated[Array, Column(("points",), least=0.0, most=1.0)]
    first: Annotated[Indices, Column(("borders",), np.int64)]
    task: Annotated[Indices, Column(("nodes",), np.int64)]
    skill: Annotated[npt.NDArray[np.bool_], Column(("nodes",), np.bool_)]
    duration: Annotated[Array, SECONDS]
    planned_start: Annotated[Array, SECONDS]
    least: Array = field(default_factory=lambda: np.empty(0))
    drive: Drive | None = None
    corners: RoundedCorners | None = None

    def __len__(self) -> int:
        """Return the number of nodes."""
        return len(self.task)

    def stands_at(self, count: int) -> Array:
        """Return the configuration of its robot when a number of its nodes are complete, shape (n,)."""
        return self.start if count == 0 else self.waypoints[self.first[count] - 1]

    def frozen(self) -> NodeChain:
        """Return it with read-only arrays."""
        for values in vars(self).values():
            if isinstance(values, np.ndarray):
                values.setflags(write=False)
        return self

    def cut(self, first: int, stop: int) -> NodeChain:
        """Return nodes ``range(first, stop)`` as a chain of their own.

        Its arrays are copies: a piece that is kept does not keep the whole chain.
        """
        lo, hi = int(self.first[first]), int(self.first[stop])
        return NodeChain(
            self.robot,
            self.start if lo == 0 else self.waypoints[lo - 1].copy(),
            self.waypoints[lo:hi].copy(),
            self.fraction[lo:hi].copy(),
            self.first[first : stop + 1] - lo,
            self.task[first:stop].copy(),
            self.skill[first:stop].copy(),
            self.duration[first:stop].copy(),
            self.planned_start[first:stop].copy(),
            drive=None if self.drive is None else self.drive.cut(slice(first, stop)),
            corners=None if self.corners is None else self.corners.inside(first, stop),
        )


def pose_nodes(
    robot: str,
    start: Array,
    waypoints: Array,
    task: int | Indices,
    duration: float | Array,
    planned_start: float | Array = 0.0,
    *,
    skill: bool = False,
) -> NodeChain:
    """Return nodes of one waypoint each; a scalar applies to all of them."""
    count = len(waypoints)
    return NodeChain(
        robot,
        start,
        waypoints,
        np.ones(count),
        np.arange(count + 1),
        np.full(count, task),
        np.full(count, skill),
        np.full(count, duration),
        np.full(count, planned_start),
    )


def join_chains(parts: Sequence[NodeChain]) -> NodeChain:
    """Return the concatenated nodes of several chains of one robot."""
    counts = np.concatenate([np.diff(part.first) for part in parts])
    names = ("waypoints", "fraction", "task", "skill", "duration", "planned_start")
    joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
    first = np.cumsum([0, *counts], dtype=np.int64)
    return NodeChain(
        parts[0].robot,
        parts[0].start,
        first=first,
        drive=None,
        corners=None,
        **joined,
    )


@dataclass(frozen=True)
class NodeHandling:
    """A change of hands of an object within a node.

    Attributes:
        object: its name.
        robot: index of the chain whose node it happens in.
        node: index of the node.
        waypoint: 0 = when the node starts, k = at the node's k-th waypoint.
        holder: robot that holds it from then on, None when it is put down.
        pose: of the object's centre in the holder's flange frame, or in the world.
    """

    object: str
    robot: int
    node: int
    waypoint: int
    holder: str | None
    pose: Transform


@dataclass(frozen=True)
class TemporalPlanGraph:
    """Temporal plan graph: node chains, type-2 edges, handlings and tasks.

    Attributes:
        cell: the static cell.
        tasks: in order of their index.
        chains: one per robot that has work, in the order of ``cell.robots``.
        edges: type-2 edges, shape (e, 4): robot and node that must be complete, robot and node
            that may then start; robots are indices of ``chains``. Sorted.
        cause: TASK_DEPENDENCY or MOTION_CONFLICT per edge, shape (e,).
        handlings: in planned order.
        allowed: allowed contacts, with their times.
        dependencies: pairs (a, b) of tasks, shape (d, 2): a must be complete before b starts.
            The edges say so too, but some of them only through others.
        slots: slot of each task where the plan was made in slots, from 0, shape (tasks,);
            empty otherwise.
        products: the product that each task is for where there are several, from 1, 0 for none
            that is made whole, shape (tasks,); empty otherwise.
        windows: of time between tasks.
        patience: how long after the begin of its source each edge holds at most, met or not, shape (e,) [ns];
            empty where every edge holds until its source is complete, as in all plans that are kept.
    """

    cell: Workcell
    tasks: tuple[Task, ...]
    chains: tuple[NodeChain, ...]
    edges: Annotated[Indices, Column(("edges", 4), np.int64)]
    cause: Annotated[Causes, Column(("edges",), np.uint8)]
    handlings: tuple[NodeHandling, ...]
    allowed: tuple[AllowedContact, ...]
    dependencies: Annotated[Indices, Column(("pairs", 2), np.int64)] = field(
        default_factory=lambda: np.empty((0, 2), dtype=np.int64)
    )
    slots: Annotated[Indices, Column(("slots",), np.int64, least=0)] = field(
        default_factory=lambda: np.empty(0, dtype=np.int64)
    )
    products: Indices = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    windows: tuple[TimeWindow, ...] = ()
    patience: Indices = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @property
    def chain_index(self) -> dict[str, int]:
        """Index in ``chains`` of each robot that has nodes."""
        return {chain.robot: i for i, chain in enumerate(self.chains)}

    def task_at(self, chain: int, node: int) -> Task:
        """Return the task of a node of a chain."""
        return self.tasks[int(self.chains[chain].task[node])]

    def task_of(self, h: NodeHandling) -> Task:
        """Return the task in which an object changes hands."""
        return self.task_at(h.robot, h.node)

    def holds_before(self, h: NodeHandling) -> bool:
        """Tell whether a handling picks up what its robot holds before its first node."""
        begins = (h.node, h.waypoint) == (0, 0)
        return begins and h.holder == self.chains[h.robot].robot

    def machine_chains(self) -> frozenset[int]:
        """Return the indices of the chains of machines."""
        machines = {item.name for item in self.cell.machines}
        return frozenset(
            k for k, chain in enumerate(self.chains) if chain.robot in machines
        )

    def working_machines(self) -> tuple[int, ...]:
        """Return the indices of the chains of machines that process parts, and do not supply or remove any."""
        kind = {task.robot: task.kind for task in self.tasks}
        return tuple(
            k
            for k in sorted(self.machine_chains())
            if kind.get(self.chains[k].robot) not in TaskKind.SUPPLY
        )

    def idle_robots(self) -> tuple[str, ...]:
        """Return the robots of the cell without nodes in the graph that are not out of service."""
        out = () if self.cell.begun is None else self.cell.begun.out
        working = {*out, *(chain.robot for chain in self.chains if len(chain))}
        return tuple(r.name for r in self.cell.robots if r.name not in working)
