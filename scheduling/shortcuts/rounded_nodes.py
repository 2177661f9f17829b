"""Nodes along a bend, in the place of as many nodes of straight ways."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.timing.rounded_path import BlendedPath
from planning.transforms import Array
from scheduling.graph.drive import RoundedCorners
from scheduling.graph.temporal_plan_graph import NodeChain
from scheduling.motion_times import node_ends

_SAME = 1e-9
"""Ways that differ by less are the same [s]."""

_LEAST = 1e-5
"""What is left of a node beside a bend is no shorter [s]."""


class BentNodes(NamedTuple):
    """Nodes along a bend.

    Attributes:
        first: the first node that they replace.
        nodes: as many others, as a chain of their own.
        way: where they begin and end, shape (nodes + 1,) [s].
    """

    first: int
    nodes: NodeChain
    way: Array


def bent_nodes(
    chain: NodeChain,
    room: range,
    way: Array,
    path: BlendedPath,
    low: float,
    high: float,
) -> BentNodes | None:
    """Return nodes that round some corners by one curve, None where there is no place for them.

    What is left of the nodes in which it begins and ends comes before and after it.

    Args:
        chain: whose nodes are to be replaced.
        room: nodes that may be: on the straight ways of ``path``.
        way: where they begin and end, shape (len(room) + 1,) [s].
        path: the whole way.
        low, high: where the bend begins and ends: within no window of a corner [s].
    """
    at = path.at[1:-1]
    corners = (at > low) & (at < high)
    # The last node that begins before the bend, and the first one that ends after it.
    first = int(np.searchsorted(way, low + _SAME, side="right")) - 1
    last = int(np.searchsorted(way, high - _SAME, side="left")) - 1
    if first < 0 or last >= len(room):
        return None
    left = low - float(way[first]), float(way[last + 1]) - high
    if any(_SAME < gap < _LEAST for gap in left):
        return None
    before, after = (bool(gap > _SAME) for gap in left)
    own = last - first + 1 - before - after
    if own < 1 and before and first > 0:
        first, own = first - 1, own + 1
    if own < 1 and after and last + 1 < len(room):
        last, own = last + 1, own + 1
    if own < 1:
        return None
    count = max(own, path.chords(low, high))
    points = path.states(low + (high - low) * np.linspace(0.0, 1.0, count + 1))[0]
    marks = np.linspace(0, count, own + 1).round().astype(np.int64)
    counts = np.array([*[1] * before, *np.diff(marks), *[1] * after], dtype=np.int64)
    ends = node_ends(chain, room.start + first, room.start + last + 1)
    waypoints = points if before else points[1:]
    if after:
        waypoints = np.vstack([waypoints, ends[-1:]])
    else:
        waypoints[-1] = ends[-1]
    inner = low + (high - low) * marks / count
    edges = [*way[first : first + before], *inner, *way[last + 1 : last + 1 + after]]
    nodes = slice(room.start + first, room.start + last + 1)
    rank = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    bend = NodeChain(
        chain.robot,
        ends[0],
        waypoints,
        (rank + 1) / np.repeat(counts, counts),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        chain.task[nodes],
        np.zeros(len(counts), dtype=np.bool_),
        chain.duration[nodes],
        chain.planned_start[nodes],
        corners=RoundedCorners(
            np.array([int(before)]),
            np.array([int(before) + own]),
            np.array([high - low]),
            np.zeros(int(corners.sum()), dtype=np.int64),
            at[corners] - low,
            path.window[corners],
            path.points[1:-1][corners],
        ),
    )
    return BentNodes(nodes.start, bend, np.array(edges))
