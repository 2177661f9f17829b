"""Check of the safety invariant of a temporal plan graph.

The invariant has three conditions. (a) Two nodes of different robots that conflict are ordered. (b) A node that
conflicts with a robot at rest between its nodes u and u + 1, before its first or after its last node, precedes
u or follows u + 1. (c) A node that conflicts with an object at rest precedes the placement of the object or
follows its pick. Then no delay can bring two robots closer than the clearance.

If (a) holds, a node v can violate (b) or (c) only if u precedes v and v precedes u + 1: any other node also
conflicts with u or u + 1, whose occupancies contain the robot at rest. Only such nodes v are checked.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.errors import PlanInvariantError
from planning.geometry.exact import TOLERANCE
from planning.parallel import map_in_parallel
from planning.transforms import Indices
from scheduling.conflicts.conflict_search import first_conflict
from scheduling.conflicts.derived_tpg import (
    DerivedTpg,
    occupant_of_holds,
    occupant_of_rest,
    occupant_of_standing_robot,
)
from scheduling.conflicts.object_spans import Node, Rest, nodes_meeting_rest
from scheduling.conflicts.occupancy import Occupancy


def check_invariant(
    graph: DerivedTpg, *, searched: bool = False, before: Sequence[int] = ()
) -> None:
    """Check that a graph is safe for any delays.

    The exact decision calls close what is within its tolerance of the clearance. That only
    adds an edge where edges are drawn; here it would refuse a good plan, so the tolerance is
    subtracted from the clearance.

    Args:
        graph: the graph.
        searched: True when the edges come straight from ``find_motion_edges`` over the
            occupancies of the graph: that search has refused every pair of nodes that its
            edges do not order, so (a) holds and is not searched a second time.
        before: number of first nodes of each chain, by default none, for which (c) was checked in a graph of their own.

    Raises:
        PlanInvariantError: names the two nodes, or the node and what stands, that are not
            kept apart.
    """
    _check_objects_in_order(graph)
    if not searched:
        _check_nodes(graph)
    _check_holds(graph)
    _check_robots_without_nodes(graph)
    _check_rests(graph, before)


def _check_nodes(graph: DerivedTpg) -> None:
    """Check (a): unordered nodes do not conflict."""
    for i in range(len(graph.tpg.chains)):
        for k in range(i):
            floor, limit = graph.order.last_before(i, k), graph.order.first_after(i, k)
            found = _conflict(graph, graph.occupancies[i], k, floor, limit)
            if found is not None:
                v, u = found
                raise PlanInvariantError(
                    f"{graph.node_name(i, v)} and {graph.node_name(k, u)} conflict and"
                    " neither waits for the other"
                )


def _check_holds(graph: DerivedTpg) -> None:
    """Check (b) for robots that have nodes."""
    chains = graph.tpg.chains
    for k in range(len(chains)):
        for i in range(len(chains)):
            if i == k:
                continue
            # Hold h is between nodes h - 1 and h.
            first = np.concatenate([[0], graph.order.first_after(k, i)])
            stop = np.concatenate([graph.order.last_before(k, i) + 1, [len(chains[i])]])
            holds = np.flatnonzero(first < stop)
            if len(holds) == 0:
                continue
            standing = occupant_of_holds(graph, k, holds).occupancy
            found = _conflict(graph, standing, i, first[holds] - 1, stop[holds])
            if found is not None:
                h, v = found
                raise PlanInvariantError(
                    f"{graph.node_name(i, v)} runs into robot {chains[k].robot!r}, which"
                    f" stands {_hold_name(graph, k, int(holds[h]))}"
                )


def _check_robots_without_nodes(graph: DerivedTpg) -> None:
    """Check (b) for robots without nodes, which always stand."""
    tpg = graph.tpg
    for robot in tpg.cell.robots:
        if robot.name in tpg.chain_index:
            continue
        standing = occupant_of_standing_robot(graph, robot).occupancy
        for i, chain in enumerate(tpg.chains):
            window = np.full(1, -1), np.full(1, len(chain))
            found = _conflict(graph, standing, i, *window)
            if found is not None:
                raise PlanInvariantError(
                    f"{graph.node_name(i, found[1])} runs into robot {robot.name!r}, which"
                    " stands at HOME all the time"
                )


def _check_objects_in_order(graph: DerivedTpg) -> None:
    """Check that the handlings of an object are ordered under any delays."""
    for rest in graph.history.rests:
        for u, v in ((rest.after, rest.before), (rest.stood, rest.after)):
            if u is None or v is None:
                continue
            if u != v and not graph.order.precedes(*u, *v):
                raise PlanInvariantError(
                    f"{graph.node_name(*v)} handles {rest.object!r} but does not wait for"
                    f" {graph.node_name(*u)}, which does so before"
                )


def _check_rests(graph: DerivedTpg, before: Sequence[int] = ()) -> None:
    """Check (c), but not again for nodes and rests of the same graph of first nodes."""

    def node_into(rest: Rest) -> Node | None:
        occupancy = occupant_of_rest(graph, rest).occupancy
        ends = [node for node in (rest.after, rest.before) if node is not None]
        checked = before and any(node < before[chain] for chain, node in ends)
        for i, chain in enumerate(graph.tpg.chains):
            floor, limit = nodes_meeting_rest(graph.order, rest, i, len(chain))
            if checked:
                floor = max(floor, before[i] - 1)
            if floor + 1 < limit:
                window = np.full(1, floor), np.full(1, limit)
                found = _conflict(graph, occupancy, i, *window)
                if found is not None:
                    return i, found[1]
        return None

    rests = graph.history.rests
    for rest, node in zip(rests, map_in_parallel(node_into, rests), strict=True):
        if node is not None:
            raise PlanInvariantError(
                f"{graph.node_name(*node)} runs into {rest.object!r}"
                f" {_rest_name(graph, rest)}"
            )


def _conflict(
    graph: DerivedTpg, a: Occupancy, chain: int, floor: Indices, limit: Indices
) -> tuple[int, int] | None:
    b = graph.occupancies[chain]
    return first_conflict(a, b, floor, limit, graph.table, TOLERANCE)


def _hold_name(graph: DerivedTpg, chain: int, hold: int) -> str:
    if hold == 0:
        return f"before {graph.node_name(chain, 0)}"
    before = graph.node_name(chain, hold - 1)
    if hold == len(graph.tpg.chains[chain]):
        return f"after {before}"
    return f"between {before} and {graph.node_name(chain, hold)}"


def _rest_name(graph: DerivedTpg, rest: Rest) -> str:
    parts = ["at rest" if rest.holder is None else "in a standing robot's hand"]
    if rest.after is not None:
        parts.append(f"after {graph.node_name(*rest.after)}")
    if rest.before is not None:
        parts.append(f"before {graph.node_name(*rest.before)}")
    return " ".join(parts)
