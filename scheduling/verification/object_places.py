"""Histories of objects by their handlings: in which hand, or at rest between which nodes."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass

from planning.cell.shape import Shape
from planning.tasks.task import GONE
from planning.transforms import Transform
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)

FlangeAt = Callable[[int, int, int], Transform]
"""World pose of a chain's flange at a moment: chain, node and waypoint; 0 is the node's start."""


@dataclass(frozen=True)
class Carried:
    """A robot holds an object from a moment of its chain on until another one, both included.

    A moment is (node, waypoint); waypoint 0 is the start of the node.

    Attributes:
        object: its name.
        chain: the robot's chain.
        start, end: first and last moment.
        pose: of the object's centre in the flange frame.
        given, fetched: True when another robot puts it into the hand at the start, or takes it
            from there at the end, while this robot stands: the stand is not counted.
    """

    object: str
    chain: int
    start: tuple[int, int]
    end: tuple[int, int]
    pose: Transform
    given: bool = False
    fetched: bool = False


@dataclass(frozen=True)
class Resting:
    """An object (or fixture) lies in the world.

    Attributes:
        object: its name.
        pose: of its frame in the world.
        shape: what it is.
        put: chain, node and waypoint that put it there, None from the start on.
        taken: chain, node and waypoint that take it away, None if it stays.
        tasks: of the robot in whose hand it rests, None when it lies in the world.
    """

    object: str
    pose: Transform
    shape: Shape
    put: tuple[int, int, int] | None
    taken: tuple[int, int, int] | None
    tasks: tuple[int, ...] | None = None


def planned_key(
    tpg: TemporalPlanGraph, chain: int, node: int
) -> tuple[float, int, int]:
    """Return the sort key of the total order: planned start, task, node."""
    c = tpg.chains[chain]
    return float(c.planned_start[node]), int(c.task[node]), node


def handled_objects(tpg: TemporalPlanGraph) -> dict[str, list[NodeHandling]]:
    """Return the handlings of every object, in planned order."""
    found: dict[str, list[NodeHandling]] = {item.name: [] for item in tpg.cell.objects}
    for handling in tpg.handlings:
        found[handling.object].append(handling)
    for events in found.values():
        events.sort(key=lambda h: (*planned_key(tpg, h.robot, h.node), h.waypoint))
    return found


def object_histories(
    tpg: TemporalPlanGraph, flange: FlangeAt
) -> tuple[list[Carried], list[Resting]]:
    """Return the histories of all objects: carried by robots, or at rest.

    Fixtures count as resting for ever. An object that is passed from hand to hand rests, in the
    hand of the robot that stands, until that robot moves (or from when it stood still).

    Args:
        tpg: the plan.
        flange: see ``FlangeAt``.
    """
    carried: list[Carried] = []
    resting = [Resting(f.name, f.pose, f.shape, None, None) for f in tpg.cell.fixtures]
    index = tpg.chain_index
    for name, events in handled_objects(tpg).items():
        item = tpg.cell.object(name)
        holder: str | None = None
        pose = item.start
        put: tuple[int, int, int] | None = None
        if item.later:  # it is nowhere until its first handling
            if not events:
                continue
            up, events = events[0], events[1:]
            pose, put = up.pose, (up.robot, up.node, up.waypoint)
        for event in [*events, None]:
            taken = None if event is None else (event.robot, event.node, event.waypoint)
            if holder == GONE:
                break
            if holder is None:
                resting.append(Resting(name, pose, item.shape, put, taken))
            else:
                assert put is not None
                chain = index[holder]
                count = len(tpg.chains[chain])
                given = put[0] != chain
                start = stand_during(tpg, chain, put) if given else put
                if given:
                    leaves = start if start[1] < count else None
                    hand = flange(*start) @ pose
                    tasks = _tasks(tpg, chain, start[1])
                    resting.append(Resting(name, hand, item.shape, put, leaves, tasks))
                end, fetched = taken or (chain, count, 0), False
                if taken is not None and taken[0] != chain:
                    end, fetched = stand_during(tpg, chain, taken), True
                    stood = _end_before(tpg.chains[chain], end)
                    hand = flange(*end) @ pose
                    tasks = _tasks(tpg, chain, end[1])
                    resting.append(Resting(name, hand, item.shape, stood, taken, tasks))
                carried.append(
                    Carried(name, chain, start[1:], end[1:], pose, given, fetched)
                )
            if event is not None:
                holder, pose, put = event.holder, event.pose, taken
    return carried, resting


def stand_during(
    tpg: TemporalPlanGraph, chain: int, moment: tuple[int, int, int]
) -> tuple[int, int, int]:
    """Return where a chain stands, by the planned order, when something happens on another one.

    The result is a moment: the chain, the node before which it stands, and 0.
    """
    nodes = range(len(tpg.chains[chain]))
    key = planned_key(tpg, moment[0], moment[1])
    node = bisect_left(nodes, key, key=lambda n: planned_key(tpg, chain, n))
    return chain, node, 0


def _end_before(
    chain: NodeChain, stand: tuple[int, int, int]
) -> tuple[int, int, int] | None:
    """Return the moment from which a robot stands before a node, None from the start on."""
    index, node, _ = stand
    if node == 0:
        return None
    return index, node - 1, int(chain.first[node] - chain.first[node - 1])


def _tasks(tpg: TemporalPlanGraph, chain: int, node: int) -> tuple[int, ...]:
    task = tpg.chains[chain].task
    return tuple(int(task[k]) for k in (node - 1, node) if 0 <= k < len(task))
