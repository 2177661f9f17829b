"""Histories of the handled objects, node by node: carried, at rest within a node, or between.

Objects follow their handlings in planned order; one that comes up later is nowhere before its
first, which lets it rest where it is. An object that a robot takes over from another
waits in the standing receiver's hand until the receiver's next node, which then carries it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.errors import PlanInvariantError
from planning.geometry.scene_checker import flange_pose
from planning.transforms import Indices, Transform
from scheduling.graph.reduction import NodeOrder
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)

Moment = tuple[int, int]
"""A node, and a waypoint of it: 0 = when it starts, k = at its k-th waypoint."""

Node = tuple[int, int]
"""A chain, and a node of it."""


@dataclass(frozen=True)
class ObjectSpan:
    """An object is part of a robot's occupancy.

    Attributes:
        object: its name.
        robot: index of the chain.
        start, end: from which moment on, and until which.
        carried: True when it moves with the flange, False when it rests in the world.
        pose: of its centre in the flange frame, or in the world.
    """

    object: str
    robot: int
    start: Moment
    end: Moment
    carried: bool
    pose: Transform


@dataclass(frozen=True)
class Rest:
    """An object is at rest, or in the hand of a robot that stands, between two nodes.

    Attributes:
        object: its name.
        after: node that leaves it there, None from the start on.
        before: node that takes it away, None to the end.
        pose: of its centre in the world.
        holder: chain of the robot that stands with it in its hand, None when it lies.
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
    """Return where every handled object is.

    Args:
        tpg: the graph; its edges are not looked at.
        ranks: place of every node in the total order.

    Raises:
        PlanInvariantError: an object is put down by a robot that does not hold it, an object
            that comes up later is handled before it is there, or a handling names something
            unknown.
    """
    handled: dict[str, list[NodeHandling]] = {h.object: [] for h in tpg.handlings}
    for handling in handlings_in_order(tpg, ranks):
        handled[handling.object].append(handling)
    spans: list[ObjectSpan] = []
    rests: list[Rest] = []
    for name, events in handled.items():
        _trace_object(tpg, ranks, name, events, spans, rests)
    return ObjectHistory(tuple(spans), tuple(rests))


def handlings_in_order(
    tpg: TemporalPlanGraph, ranks: Sequence[Indices]
) -> list[NodeHandling]:
    """Return what changes hands, in the total order of the nodes."""
    return sorted(tpg.handlings, key=lambda h: (ranks[h.robot][h.node], h.waypoint))


def _trace_object(
    tpg: TemporalPlanGraph,
    ranks: Sequence[Indices],
    name: str,
    events: list[NodeHandling],
    spans: list[ObjectSpan],
    rests: list[Rest],
) -> None:
    index = tpg.chain_index
    holder: int | None = None
    item = tpg.cell.object(name)
    pose = item.start
    after: Node | None = None  # node that left the object where it rests
    since: Moment = (0, 0)  # moment from which the holder carries it
    rest_from: Moment | None = None  # set while it rests within the node of ``after``
    if item.later:
        first, events = events[0], events[1:]
        if first.holder is not None:
            raise PlanInvariantError(
                f"task {tpg.chains[first.robot].task[first.node]} handles {name!r}, which"
                " is not there yet"
            )
        pose, after = first.pose, (first.robot, first.node)
        rest_from = (first.node, first.waypoint)
    for event in events:
        chain = tpg.chains[event.robot]
        here: Moment = (event.node, event.waypoint)
        node: Node = (event.robot, event.node)
        if holder == event.robot:
            spans.append(ObjectSpan(name, holder, since, here, True, pose))
        elif holder is None:
            # At rest until now: within this node, and between the nodes before it.
            begin: Moment = (event.node, 0)
            if after == node and rest_from is not None:
                begin = rest_from
            elif after is not None and rest_from is not None:
                spans.append(_tail(tpg.chains, name, after, rest_from, pose))
            spans.append(ObjectSpan(name, event.robot, begin, here, False, pose))
            if after != node:
                rests.append(Rest(name, after, node, pose))
        else:
            # The receiver takes it from the hand of a robot that stands.
            last = _last_before(ranks, holder, node)
            spans.append(
                ObjectSpan(
                    name, holder, since, _end_of(tpg.chains[holder], last), True, pose
                )
            )
            held = _hand(tpg, holder, last) @ pose
            spans.append(
                ObjectSpan(name, event.robot, (event.node, 0), here, False, held)
            )
            stood = (holder, last) if last >= 0 else None
            rests.append(Rest(name, stood, node, held, holder, stood))
        rest_from = None
        if event.holder is None:
            if holder != event.robot:
                raise PlanInvariantError(
                    f"task {chain.task[event.node]} of robot {chain.robot!r} puts down"
                    f" {name!r}, which it does not hold"
                )
            holder, pose, after, rest_from = None, event.pose, node, here
        elif event.holder == chain.robot:
            holder, pose, since, after = event.robot, event.pose, here, None
        else:
            if event.holder not in index:
                raise PlanInvariantError(
                    f"task {chain.task[event.node]} hands {name!r} to {event.holder!r},"
                    " a robot that has no node",
                    choices=tuple(index),
                )
            receiver = index[event.holder]
            last = _last_before(ranks, receiver, node)
            held = _hand(tpg, receiver, last) @ event.pose
            spans.append(_tail(tpg.chains, name, node, here, held))
            following: Node | None = (receiver, last + 1)
            if last + 1 >= len(tpg.chains[receiver]):
                following = None
            stood = (receiver, last) if last >= 0 else None
            rests.append(Rest(name, node, following, held, receiver, stood))
            holder, pose, since, after = receiver, event.pose, (last + 1, 0), None
    if holder is None:
        if after is not None and rest_from is not None:
            spans.append(_tail(tpg.chains, name, after, rest_from, pose))
        rests.append(Rest(name, after, None, pose))
    else:
        # Kept to the end, the hold after the last node included.
        end = (len(tpg.chains[holder]), 0)
        spans.append(ObjectSpan(name, holder, since, end, True, pose))


def _last_before(ranks: Sequence[Indices], robot: int, node: Node) -> int:
    """Return the last node of ``robot`` before ``node`` in the total order, or -1."""
    return int(ranks[robot].searchsorted(ranks[node[0]][node[1]])) - 1


def _end_of(chain: NodeChain, node: int) -> Moment:
    if node < 0:
        return (0, 0)
    return (node, int(chain.first[node + 1] - chain.first[node]))


def _tail(
    chains: Sequence[NodeChain], name: str, node: Node, start: Moment, pose: Transform
) -> ObjectSpan:
    """Return the span of an object at rest from ``start`` to the end of its node."""
    return ObjectSpan(
        name, node[0], start, _end_of(chains[node[0]], node[1]), False, pose
    )


def _hand(tpg: TemporalPlanGraph, robot: int, node: int) -> Transform:
    """Return the flange pose of a robot that stands after ``node`` (-1: at its start)."""
    chain = tpg.chains[robot]
    q = chain.start if node < 0 else chain.waypoints[chain.first[node + 1] - 1]
    return flange_pose(tpg.cell.robot(chain.robot), q)


def while_at_rest(
    order: NodeOrder, rest: Rest, robot: int, count: int
) -> tuple[int, int]:
    """Return the nodes of a robot, ``range(floor + 1, limit)``, that meet an object at rest.

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
