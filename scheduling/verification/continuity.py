"""Objects of a saved plan: each is one thing in one place or one hand, and jumps nowhere.

An object moves only with who holds it, at one pose of its own in that hand. So it is enough to look
at where it changes hands: where it is taken from and where it comes to must be one place.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from planning.cell.workcell import CellObject
from planning.tasks.task import GONE
from planning.transforms import Array, Transform
from scheduling.graph.temporal_plan_graph import NodeHandling, TemporalPlanGraph
from scheduling.verification.graph_structure import Problem, node_problem
from scheduling.verification.object_places import (
    FlangeAt,
    handled_objects,
    stand_during,
)

JUMP = 1e-4
"""No point of an object may be further away from where it was as it changes hands [m]."""


def jumps(tpg: TemporalPlanGraph, flange: FlangeAt) -> Iterator[Problem]:
    """Yield where objects jump, or are handled by who does not have them.

    Args:
        tpg: the plan.
        flange: see ``FlangeAt``.
    """
    for name, events in handled_objects(tpg).items():
        yield from _of_object(tpg, tpg.cell.object(name), events, flange)


def distance_of(item: CellObject, first: Transform, second: Transform) -> float:
    """Return how far the corners of the box around an object are from pose to pose, at most [m]."""
    shape = item.shape
    ends = np.stack([shape.low, shape.high])
    corners = np.array(list(product(*ends.T)))
    away = _placed(first, corners) - _placed(second, corners)
    return float(np.linalg.norm(away, axis=1).max())


def _placed(pose: Transform, points: Array) -> Array:
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def _of_object(
    tpg: TemporalPlanGraph,
    item: CellObject,
    events: list[NodeHandling],
    flange: FlangeAt,
) -> Iterator[Problem]:
    index = tpg.chain_index

    def in_world(event: NodeHandling, holder: str | None, pose: Transform) -> Transform:
        """Return where it is when something happens, if it is in a hand or at rest."""
        if holder is None:
            return pose
        moment = event.robot, event.node, event.waypoint
        chain = index[holder]
        if chain != event.robot:
            moment = stand_during(tpg, chain, moment)
        return np.asarray(flange(*moment) @ pose)

    holder, pose, there = None, item.start, not item.later
    for event in events:
        who, to = tpg.chains[event.robot].robot, event.holder
        wrong = None
        if holder == GONE:
            wrong = "is handled after it has left the cell"
        elif not there and to is not None:
            wrong = "is handled before it has come up"
        elif there and who not in (holder, to) and not tpg.cell.is_machine(who):
            wrong = f"changes hands, and {who!r} neither has it nor gets it"
        elif to != GONE:
            apart = distance_of(
                item, in_world(event, holder, pose), in_world(event, to, event.pose)
            )
            if apart > JUMP:
                words = _words(holder, to, there)
                wrong = words.format(f"{apart * 1e3:.2f} mm")
        if wrong is not None:
            where = event.robot, event.node
            yield node_problem(tpg, "jump", where, f"{item.name!r} {wrong}")
        holder, pose, there = to, event.pose, True


def _words(holder: str | None, to: str | None, there: bool) -> str:
    """Return what happens, with room for how far away from where it should."""
    if holder is None and to is not None:
        return f"is taken by {to!r} {{}} away from where it lies"
    if holder is None:
        at = "where it is to come up" if not there else "where it lies, by itself"
        return f"is put {{}} away from {at}"
    if to is None:
        return f"is put down {{}} away from where it is in the hand of {holder!r}"
    return f"is given to {to!r} {{}} away from where {holder!r} has it"
