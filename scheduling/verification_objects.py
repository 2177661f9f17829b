"""Where every object is according to its handlings: in which hand, or at rest between which."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.transforms import Transform
from scheduling.temporal_plan_graph import NodeHandling, TemporalPlanGraph


@dataclass(frozen=True)
class Carried:
    """A robot holds an object from a moment of its chain on until another one, both included.

    A moment is (node, waypoint); waypoint 0 is the start of the node.

    Attributes:
        object: its name.
        chain: the robot's chain.
        start, end: first and last moment.
        pose: of the object's centre in the flange frame.
    """

    object: str
    chain: int
    start: tuple[int, int]
    end: tuple[int, int]
    pose: Transform


@dataclass(frozen=True)
class Resting:
    """An object (or fixture) lies in the world.

    Attributes:
        object: its name.
        pose: of its centre in the world.
        size: edge lengths, shape (3,) [m].
        put: chain, node and waypoint that put it there, None from the start on.
        taken: chain, node and waypoint that take it away, None if it stays.
    """

    object: str
    pose: Transform
    size: np.ndarray
    put: tuple[int, int, int] | None
    taken: tuple[int, int, int] | None


def planned_key(
    tpg: TemporalPlanGraph, chain: int, node: int
) -> tuple[float, int, int]:
    """Return what the total order sorts nodes by: planned start, task, node."""
    c = tpg.chains[chain]
    return float(c.planned_start[node]), int(c.task[node]), node


def object_histories(
    tpg: TemporalPlanGraph,
) -> tuple[list[Carried], list[Resting], list[tuple[NodeHandling, NodeHandling]]]:
    """Return who carries what when, what rests where, and consecutive handlings.

    Fixtures count as resting for ever.
    """
    cell = tpg.cell
    carried: list[Carried] = []
    resting = [Resting(f.name, f.pose, f.size, None, None) for f in cell.fixtures]
    consecutive: list[tuple[NodeHandling, NodeHandling]] = []
    index = {chain.robot: i for i, chain in enumerate(tpg.chains)}
    for item in cell.objects:
        events = sorted(
            (h for h in tpg.handlings if h.object == item.name),
            key=lambda h: (*planned_key(tpg, h.robot, h.node), h.waypoint),
        )
        consecutive += list(pairwise(events))
        holder: str | None = None
        pose = item.start
        last: NodeHandling | None = None
        for event in [*events, None]:
            if holder is None:
                put = None if last is None else (last.robot, last.node, last.waypoint)
                taken = (
                    None if event is None else (event.robot, event.node, event.waypoint)
                )
                resting.append(Resting(item.name, pose, item.size, put, taken))
            else:
                assert last is not None
                chain = index[holder]
                start = _moment(tpg, chain, last)
                if event is None:
                    end = (len(tpg.chains[chain]), 0)
                else:
                    end = _moment(tpg, chain, event)
                carried.append(Carried(item.name, chain, start, end, pose))
            if event is not None:
                holder, pose, last = event.holder, event.pose, event
    return carried, resting, consecutive


def _moment(tpg: TemporalPlanGraph, chain: int, event: NodeHandling) -> tuple[int, int]:
    """Return when an event happens on a chain: at its own moment, or while the robot stands."""
    if event.robot == chain:
        return event.node, event.waypoint
    key = planned_key(tpg, event.robot, event.node)
    node = 0
    while node < len(tpg.chains[chain]) and planned_key(tpg, chain, node) < key:
        node += 1
    return node, 0
