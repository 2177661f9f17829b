"""Location of each object over the course of a plan: held by a robot, or at rest between two nodes.

A held object has a constant pose in the flange frame of one robot, so it moves only with that robot. Therefore
only transfers need checks: an object must be picked up where it was put down.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from planning.cell.shape import Shape
from planning.cell.workcell import CellObject
from planning.tasks.task import Handling, TaskKind
from planning.transforms import Array, Transform
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)
from scheduling.verification.problems import Problem, node_problem

_Moment = tuple[int, int, int]
"""Chain, node and waypoint; 0 is the start of the node."""

FlangeAt = Callable[[int, int, int], Transform]
"""World pose of a chain's flange at a moment: chain, node and waypoint; 0 is the node's start."""

JUMP = 1e-4
"""No point of an object may be further away from where it was as it changes hands [m]."""


@dataclass(frozen=True)
class Carried:
    """An object held by a robot between two moments of its chain, both included.

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
    """An object (or fixture) at rest in the world.

    Attributes:
        object: its name.
        pose: of its frame in the world.
        shape: its shape.
        put: chain, node and waypoint that put it there, None from the start on.
        taken: chain, node and waypoint that take it away, None if it stays.
        tasks: of the robot in whose hand it rests, None when it lies in the world.
        hand: name of that robot, or of one that is mounted on this fixture: its base error displaces it.
    """

    object: str
    pose: Transform
    shape: Shape
    put: _Moment | None
    taken: _Moment | None
    tasks: tuple[int, ...] | None = None
    hand: str | None = None


def planned_key(
    tpg: TemporalPlanGraph, chain: int, node: int
) -> tuple[float, int, int]:
    """Return the sort key of the total order: planned start, task, node."""
    c = tpg.chains[chain]
    return float(c.planned_start[node]), int(c.task[node]), node


@dataclass(frozen=True)
class ObjectLocation:
    """Location of an object between two of its handlings.

    Attributes:
        holder: the robot that holds it, None at rest, GONE once it has left the cell.
        pose: of its centre in the holder's flange frame, or in the world.
        put: chain, node and waypoint from which on it is there, None from the start on, in a hand too.
        taken: those from which on it is elsewhere, None if it stays.
        present: False for what has not come up yet.
    """

    holder: str | None
    pose: Transform
    put: _Moment | None
    taken: _Moment | None
    present: bool = True


def object_locations(tpg: TemporalPlanGraph) -> dict[str, list[ObjectLocation]]:
    """Return the locations of every object, in planned order, its start first."""
    found: dict[str, list[ObjectLocation]] = {}
    handled: dict[str, list[NodeHandling]] = {
        item.name: [] for item in tpg.cell.objects
    }
    for handling in tpg.handlings:
        handled[handling.object].append(handling)
    for item in tpg.cell.objects:
        events = handled[item.name]
        events.sort(key=lambda h: (*planned_key(tpg, h.robot, h.node), h.waypoint))
        when: list[_Moment | None] = [(h.robot, h.node, h.waypoint) for h in events]
        first: tuple[str | None, Transform] = None, item.start
        if events and tpg.holds_before(events[0]):
            first, events, when = (
                (events[0].holder, events[0].pose),
                events[1:],
                when[1:],
            )
        at = [first, *((h.holder, h.pose) for h in events)]
        found[item.name] = [
            ObjectLocation(
                *place, put, taken, present=put is not None or not item.later
            )
            for place, put, taken in zip(at, [None, *when], [*when, None], strict=True)
        ]
    return found


def object_histories(
    tpg: TemporalPlanGraph, flange: FlangeAt
) -> tuple[list[Carried], list[Resting]]:
    """Return the histories of all objects: carried by robots, or at rest.

    Fixtures rest at all times. An object that is passed from hand to hand rests, in the
    hand of the robot that stands, until that robot moves (or from when it stood still).

    Args:
        tpg: the plan.
        flange: see ``FlangeAt``.
    """
    carried: list[Carried] = []
    moved_with = {
        fixture.name: robot.name
        for robot in reversed(tpg.cell.robots)
        for fixture in robot.mounted_on
    }
    resting = [
        Resting(f.name, f.pose, f.shape, None, None, None, moved_with.get(f.name))
        for f in tpg.cell.fixtures
    ]
    places = ((name, at) for name, own in object_locations(tpg).items() for at in own)
    for name, at in places:
        shape = tpg.cell.object(name).shape
        if at.holder == Handling.GONE or not at.present:
            continue
        if at.holder is None:
            resting.append(Resting(name, at.pose, shape, at.put, at.taken))
            continue
        chain = tpg.chain_index[at.holder]
        count = len(tpg.chains[chain])
        start, end = at.put or (chain, 0, 0), at.taken or (chain, count, 0)
        given, fetched = start[0] != chain, end[0] != chain
        if given:
            start = stand_during(tpg, chain, start)
            until = start if start[1] < count else None
            hand, tasks = flange(*start) @ at.pose, _tasks(tpg, chain, start[1])
            resting.append(Resting(name, hand, shape, at.put, until, tasks, at.holder))
        if fetched:
            end = stand_during(tpg, chain, end)
            stood = _end_before(tpg.chains[chain], end)
            hand, tasks = flange(*end) @ at.pose, _tasks(tpg, chain, end[1])
            resting.append(
                Resting(name, hand, shape, stood, at.taken, tasks, at.holder)
            )
        carried.append(
            Carried(name, chain, start[1:], end[1:], at.pose, given, fetched)
        )
    return carried, resting


def stand_during(tpg: TemporalPlanGraph, chain: int, moment: _Moment) -> _Moment:
    """Return the configuration of a chain, by the planned order, at an event on another one.

    The result is a moment: the chain, the node before which it stands, and 0.
    """
    nodes = range(len(tpg.chains[chain]))
    key = planned_key(tpg, moment[0], moment[1])
    node = bisect_left(nodes, key, key=lambda n: planned_key(tpg, chain, n))
    return chain, node, 0


def _end_before(chain: NodeChain, stand: _Moment) -> _Moment | None:
    """Return the moment from which a robot stands before a node, None from the start on."""
    index, node, _ = stand
    if node == 0:
        return None
    return index, node - 1, int(chain.first[node] - chain.first[node - 1])


def _tasks(tpg: TemporalPlanGraph, chain: int, node: int) -> tuple[int, ...]:
    task = tpg.chains[chain].task
    return tuple(int(task[k]) for k in (node - 1, node) if 0 <= k < len(task))


def jumps(tpg: TemporalPlanGraph, flange: FlangeAt) -> Iterator[Problem]:
    """Yield discontinuities of objects, and handlings by robots that do not hold them.

    Args:
        tpg: the plan.
        flange: see ``FlangeAt``.
    """
    for name, places in object_locations(tpg).items():
        if (holder := places[0].holder) is not None:
            item, chain = tpg.cell.object(name), tpg.chain_index[holder]
            there = flange(chain, 0, 0) @ places[0].pose
            if (apart := distance_of(item, item.start, there)) > JUMP:
                text = f"{name!r} is {apart * 1e3:.2f} mm away from where {holder!r} has it at the start"
                yield node_problem(tpg, "jump", (chain, 0), text)
        for before, after in pairwise(places):
            assert after.put is not None
            wrong = _wrong(tpg, tpg.cell.object(name), before, after, flange)
            if wrong is not None:
                yield node_problem(tpg, "jump", after.put[:2], f"{name!r} {wrong}")


def distance_of(item: CellObject, first: Transform, second: Transform) -> float:
    """Return a bound on the displacement of an object's bounding box between poses [m]."""
    shape = item.shape
    ends = np.stack([shape.low, shape.high])
    corners = np.array(list(product(*ends.T)))
    away = _placed(first, corners) - _placed(second, corners)
    return float(np.linalg.norm(away, axis=1).max())


def _placed(pose: Transform, points: Array) -> Array:
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def _wrong(
    tpg: TemporalPlanGraph,
    item: CellObject,
    before: ObjectLocation,
    after: ObjectLocation,
    flange: FlangeAt,
) -> str | None:
    """Return the fault of a change of hands, None for none."""
    assert after.put is not None
    moment, holder, to = after.put, before.holder, after.holder
    who = tpg.chains[moment[0]].robot

    def world_pose(at: ObjectLocation) -> Transform:
        """Return its location at a moment, whether in a hand or at rest."""
        if at.holder is None:
            return at.pose
        chain, there = tpg.chain_index[at.holder], moment
        if chain != moment[0]:
            there = stand_during(tpg, chain, moment)
        return np.asarray(flange(*there) @ at.pose)

    if holder == Handling.GONE:
        return "is handled after it has left the cell"
    if not before.present and to is not None:
        return "is handled before it has come up"
    chain, node = moment[:2]
    kind = tpg.tasks[int(tpg.chains[chain].task[node])].kind
    # What a robot lets go of over a bin falls into it.
    falls = before.put is not None and before.put[:2] == moment[:2]
    lost = to == Handling.GONE and (
        falls or kind in (TaskKind.FAILED, TaskKind.TAKEN_OUT)
    )
    # A robot that failed to pick it has measured its pose.
    found = kind == TaskKind.FAILED and before.present and holder is None and to is None
    if found:
        return None
    takes = tpg.cell.is_machine(who) or lost
    if before.present and who not in (holder, to) and not takes:
        return f"changes hands, and {who!r} neither has it nor gets it"
    if to == Handling.GONE:
        return None
    apart = distance_of(item, world_pose(before), world_pose(after))
    words = _words(holder, to, before.present)
    return words.format(f"{apart * 1e3:.2f} mm") if apart > JUMP else None


def _words(holder: str | None, to: str | None, present: bool) -> str:
    """Return a description of the event, with a placeholder for the distance."""
    if holder is None and to is not None:
        return f"is taken by {to!r} {{}} away from where it lies"
    if holder is None:
        at = "where it is to come up" if not present else "where it lies, by itself"
        return f"is put {{}} away from {at}"
    if to is None:
        return f"is put down {{}} away from where it is in the hand of {holder!r}"
    return f"is given to {to!r} {{}} away from where {holder!r} has it"
