"""Order of parts whose straight way into their place leads through that of another one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from planning.construction.problem.contacts import NEAR
from planning.construction.problem.precedence import MOST_OVERLAP, PartGraph
from planning.parts.contact_graph import Lying, near_to
from planning.transforms import Array, translation

_STEP = 0.005
"""A straight way is looked at so often [m]."""


def with_insertions(
    graph: PartGraph,
    parts: Mapping[str, Lying],
    insertions: Mapping[str, Array],
    approach: float,
) -> PartGraph:
    """Return the graph in which a part also waits for those whose way in leads through it.

    Planning exempts from collisions what touches in place: it would not see that the way there
    leads through what it touches. Two that are in each other's way wait for each other, which
    ``never_placeable`` finds.

    Args:
        graph: the part graph.
        parts: every part in its place, by name.
        insertions: direction of the straight way in of each part, shape (3,).
        approach: length of that way [m].
    """
    carriers = dict(graph.carriers)
    for name, lying in parts.items():
        near = {k: parts[k] for k in sorted(graph.neighbours[name])}
        for other in near_to(lying, near, NEAR):
            settled = other in graph.carriers[name] or name in graph.carriers[other]
            if not settled and _leads_through(
                lying, near[other], insertions[name], approach
            ):
                carriers[other] |= {name}
    return replace(graph, carriers=carriers)


def _leads_through(
    lying: Lying, other: Lying, insertion: Array, approach: float
) -> bool:
    """Tell whether a part that comes to its place on a straight way meets another one."""
    item, pose = lying
    for away in np.linspace(0.0, approach, int(np.ceil(approach / _STEP)) + 1)[1:]:
        before = (item, translation(*(-away * insertion)) @ pose)
        if any(
            gap < -MOST_OVERLAP for gap in near_to(before, {"": other}, 0.0).values()
        ):
            return True
    return False
