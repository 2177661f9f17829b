"""The multi-modal temporal plan graph (TPG) as data (APEX-MR IV-C).

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

from planning.cell.workcell import Workcell
from planning.tasks.task import AllowedContact, Task
from planning.tasks.time_window import TimeWindow
from planning.transforms import Array, Indices, Transform
from scheduling.graph.columns import SECONDS, Column
from scheduling.graph.drive import Drive, RoundedCorners

EVER = 2**61
"""Patience of an edge that holds until its source is complete [ns]."""

TASK_DEPENDENCY = 0
MOTION_CONFLICT = 1

Causes = npt.NDArray[np.uint8]
"""TASK_DEPENDENCY or MOTION_CONFLICT, one an edge."""


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
        task: task index of each node, shape (nodes,), never falling.
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


def join_chains(parts: Sequence[NodeChain]) -> NodeChain:
    """Return the nodes of several chains of one robot, one after another."""
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
    """An object changes hands within a node.

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
    """Nodes, type-2 edges and what the nodes carry.

    Attributes:
        cell: the static cell.
        tasks: in order of their index.
        chains: one per robot that has work, in the order of ``cell.robots``.
        edges: type-2 edges, shape (e, 4): robot and node that must be complete, robot and node
            that may then start; robots are indices of ``chains``. Sorted.
        cause: TASK_DEPENDENCY or MOTION_CONFLICT per edge, shape (e,).
        handlings: in planned order.
        allowed: who may touch whom, and when.
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

    def task_of(self, h: NodeHandling) -> Task:
        """Return the task in which an object changes hands."""
        return self.tasks[int(self.chains[h.robot].task[h.node])]

    def holds_before(self, h: NodeHandling) -> bool:
        """Tell whether by a handling a robot has in its hand what it had before its first node."""
        begins = (h.node, h.waypoint) == (0, 0)
        return begins and h.holder == self.chains[h.robot].robot
