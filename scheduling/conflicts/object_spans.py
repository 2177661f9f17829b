"""Location of each handled object at each node: carried by a robot, or at rest within a node or between nodes.

Locations follow from the picks, placements and handovers in planned order. An object that is supplied later,
such as a further brick of a feeding station, does not exist before the node that delivers it. After a handover
the receiving robot holds the object at rest until its next node, in which it carries the object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.errors import PlanInvariantError
from planning.kinematics.kinematics import frame_pose
from planning.tasks.task import Handling, TaskKind
from planning.transforms import Indices, Transform
from scheduling.graph.temporal_plan_graph import NodeHandling, TemporalPlanGraph
from scheduling.graph.total_order import NodeOrder

Moment = tuple[int, int]
"""A node, and a waypoint of it: 0 = when it starts, k = at its k-th waypoint."""

_BEFORE: Moment = (-1, 0)
"""Before the first node: an object is held by a robot that stands at its start."""

Node = tuple[int, int]
"""A chain, and a node of it."""


@dataclass(frozen=True)
class ObjectSpan:
    """An interval of nodes in which an object is part of the swept volume of a robot.

    Attributes:
        object: its name.
        robot: index of the chain.
        start, end: first and last moment.
        carried: True when it moves with the flange, False when it rests in the world.
        pose: pose of its centre in the flange frame, or in the world.
    """

    object: str
    robot: int
    start: Moment
    end: Moment
    carried: bool
    pose: Transform


@dataclass(frozen=True)
class Rest:
    """An interval between two nodes in which an object is at rest, or held by a standing robot.

    Attributes:
        object: its name.
        after: node that puts it there, None from the start on.
        before: node that takes it away, None until the end.
        pose: pose of its centre in the world.
        holder: chain of the standing robot that holds it, None at rest.
        stood: last node of that robot before it stands, None when it stands from the start.
    """

    object: str
    after: Node | None
    before: Node | None
    pose: Transform
    holder: int | None = None
    stood: Node | None = None


@dataclass(frozen=True)
class ObjectHistory:
    """All spans and rests of all handled objects."""

    spans: tuple[ObjectSpan, ...]
    rests: tuple[Rest, ...]


def trace_objects(tpg: TemporalPlanGraph, ranks: Sequence[Indices]) -> ObjectHistory:
    """Return the history of every handled object.

    Args:
        tpg: the graph; its edges are not used.
        ranks: place of every node in the total order.

    Raises:
        PlanInvariantError: an object is put down by a robot that does not hold it, an object
            that comes up later is handled before it is there, or a handling names something
            unknown.
    """
    handled: dict[str, list[NodeHandling]] = {h.object: [] for h in tpg.handlings}
    for handling in handlings_in_order(tpg, ranks):
        handled[handling.object].append(handling)
    traces = [_Trace(tpg, ranks, name) for name in handled]
    for trace, events in zip(traces, handled.values(), strict=True):
        trace.follow(events)
    return ObjectHistory(
        tuple(span for trace in traces for span in trace.spans),
        tuple(rest for trace in traces for rest in trace.rests),
    )


def handlings_in_order(
    tpg: TemporalPlanGraph, ranks: Sequence[Indices]
) -> list[NodeHandling]:
    """Return all handlings, in the total order of the nodes."""
    return sorted(tpg.handlings, key=lambda h: (ranks[h.robot][h.node], h.waypoint))


@dataclass(frozen=True)
class _Place:
    """Place of an object from one handling to the next.

    Attributes:
        pose: of its centre in the world, or in the flange frame of the robot that carries it.
        holder: chain of that robot, None at rest.
        node: node that left it at rest, None from the start on, and where it is carried.
        since: moment from which it rests there, or is carried.
    """

    pose: Transform
    holder: int | None = None
    node: Node | None = None
    since: Moment = (0, 0)


class _Trace:
    """Follows one object through its handlings, and records its spans and rests."""

    def __init__(
        self, tpg: TemporalPlanGraph, ranks: Sequence[Indices], name: str
    ) -> None:
        self.spans: list[ObjectSpan] = []
        self.rests: list[Rest] = []
        self._tpg, self._ranks, self._name = tpg, ranks, name

    def follow(self, events: list[NodeHandling]) -> None:
        item = self._tpg.cell.object(self._name)
        place = _Place(item.start)
        if item.later:
            first, *events = events
            node, here = (first.robot, first.node), (first.node, first.waypoint)
            if first.holder is not None:
                raise PlanInvariantError(
                    f"task {self._task(node)} handles {self._name!r}, which is not there"
                    " yet"
                )
            place = _Place(first.pose, None, node, here)
        elif events and (taken := self._held_from_the_start(events[0])) is not None:
            place, (_, *events) = taken, events
        for event in events:
            self._until(place, event)
            if event.holder == Handling.GONE:
                self._leave(place, event, events)
                return
            place = self._after(place, event)
        self._to_the_end(place)

    def _held_from_the_start(self, event: NodeHandling) -> _Place | None:
        """Return the robot that holds an object before its first node, None if it takes it then."""
        if not self._tpg.holds_before(event):
            return None
        return _Place(event.pose, event.robot, None, _BEFORE)

    def _leave(
        self, place: _Place, event: NodeHandling, events: list[NodeHandling]
    ) -> None:
        """Check that an object that leaves is in no hand, and is not handled afterwards."""
        task = self._task((event.robot, event.node))
        if place.holder is not None:
            raise PlanInvariantError(
                f"task {task} takes {self._name!r} away, which a robot holds"
            )
        if event is not events[-1]:
            raise PlanInvariantError(
                f"{self._name!r} is handled after task {task}, which takes it away"
            )

    def _until(self, place: _Place, event: NodeHandling) -> None:
        node, here = (event.robot, event.node), (event.node, event.waypoint)
        if place.holder == event.robot:
            self._span(event.robot, place.since, here, True, place.pose)
        elif place.holder is not None:
            # The receiver takes it from the hand of a robot that stands.
            last = self._last_before(place.holder, node)
            end = self._end_of((place.holder, last))
            self._span(place.holder, place.since, end, True, place.pose)
            held = self._hand((place.holder, last)) @ place.pose
            self._span(event.robot, (event.node, 0), here, False, held)
            stood = (place.holder, last) if last >= 0 else None
            self.rests.append(Rest(self._name, stood, node, held, place.holder, stood))
        elif place.node == node:
            self._span(event.robot, place.since, here, False, place.pose)
        else:
            # At rest within the node that left it, between the nodes, and within this one.
            self._rest_of_node(place)
            self._span(event.robot, (event.node, 0), here, False, place.pose)
            self.rests.append(Rest(self._name, place.node, node, place.pose))

    def _after(self, place: _Place, event: NodeHandling) -> _Place:
        chain = self._tpg.chains[event.robot]
        node, here = (event.robot, event.node), (event.node, event.waypoint)
        if event.holder is None:
            tried = self._tpg.task_of(event).kind == TaskKind.FAILED
            found = place.holder is None and tried
            # A robot that failed to pick it has measured its pose.
            if place.holder != event.robot and not found:
                raise PlanInvariantError(
                    f"task {self._task(node)} of robot {chain.robot!r} puts down"
                    f" {self._name!r}, which it does not hold"
                )
            return _Place(event.pose, None, node, here)
        if event.holder == chain.robot:
            return _Place(event.pose, event.robot, None, here)
        index = self._tpg.chain_index
        if event.holder not in index:
            raise PlanInvariantError(
                f"task {self._task(node)} hands {self._name!r} to {event.holder!r}, a robot"
                " that has no node",
                choices=tuple(index),
            )
        receiver = index[event.holder]
        last = self._last_before(receiver, node)
        held = self._hand((receiver, last)) @ event.pose
        self._rest_of_node(_Place(held, None, node, here))
        is_continued = last + 1 < len(self._tpg.chains[receiver])
        following = (receiver, last + 1) if is_continued else None
        stood = (receiver, last) if last >= 0 else None
        self.rests.append(Rest(self._name, node, following, held, receiver, stood))
        return _Place(event.pose, receiver, None, (last + 1, 0))

    def _to_the_end(self, place: _Place) -> None:
        if place.holder is None:
            self._rest_of_node(place)
            self.rests.append(Rest(self._name, place.node, None, place.pose))
        else:
            # The hold after the last node is included.
            end = (len(self._tpg.chains[place.holder]), 0)
            self._span(place.holder, place.since, end, True, place.pose)

    def _rest_of_node(self, place: _Place) -> None:
        """Record that the object rests to the end of the node that released it, if any."""
        if place.node is not None:
            end = self._end_of(place.node)
            self._span(place.node[0], place.since, end, False, place.pose)

    def _span(
        self, chain: int, start: Moment, end: Moment, carried: bool, pose: Transform
    ) -> None:
        self.spans.append(ObjectSpan(self._name, chain, start, end, carried, pose))

    def _task(self, node: Node) -> int:
        return int(self._tpg.chains[node[0]].task[node[1]])

    def _last_before(self, chain: int, node: Node) -> int:
        """Return the last node of a chain before ``node`` in the total order, or -1."""
        return int(self._ranks[chain].searchsorted(self._ranks[node[0]][node[1]])) - 1

    def _end_of(self, node: Node) -> Moment:
        """Return the moment at which a node ends (-1: the start)."""
        chain, k = self._tpg.chains[node[0]], node[1]
        return (0, 0) if k < 0 else (k, int(chain.first[k + 1] - chain.first[k]))

    def _hand(self, node: Node) -> Transform:
        """Return the flange pose of a robot standing after a node (-1: at its start)."""
        chain, k = self._tpg.chains[node[0]], node[1]
        return frame_pose(self._tpg.cell.robot(chain.robot), chain.stands_at(k + 1))


def nodes_meeting_rest(
    order: NodeOrder, rest: Rest, robot: int, count: int
) -> tuple[int, int]:
    """Return the nodes of a robot, ``range(floor + 1, limit)``, that collide with an object at rest.

    Args:
        order: what precedes what.
        rest: where the object is, and between which nodes.
        robot: index of the robot's chain.
        count: how many nodes that has.
    """
    floor, limit = -1, count
    if rest.after is not None:
        k, u = rest.after
        floor = u if k == robot else int(np.searchsorted(order.of(robot)[:, k], u)) - 1
    if rest.before is not None:
        k, u = rest.before
        limit = u if k == robot else int(order.of(k)[u, robot]) + 1
    return floor, limit
