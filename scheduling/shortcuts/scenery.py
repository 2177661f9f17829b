"""Collision checks of a path against fixtures, idle robots and objects at rest."""

from __future__ import annotations

from itertools import pairwise

from planning.cell.workcell import Attachment, Workcell, WorldState
from planning.geometry.scene_checker import SceneChecker
from planning.motion.sequential import MARGIN
from planning.transforms import Array
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.object_spans import Rest
from scheduling.graph.reduction import NodeOrder


class Scenery:
    """Checks paths that are to take the place of nodes; remembers the scenes."""

    def __init__(self) -> None:
        self._checkers: dict[object, SceneChecker] = {}

    def free(
        self, graph: DerivedTpg, index: int, first: int, last: int, path: Array
    ) -> bool:
        """Tell whether a path is free in place of some nodes.

        Args:
            graph: as it is.
            index: chain of the nodes.
            first, last: the nodes.
            path: polyline, shape (w, n).
        """
        chain = graph.tpg.chains[index]
        present = tuple(
            rest
            for rest in graph.history.rests
            if rest.holder is None
            and _may_lie_there(graph.order, rest, index, first, last)
        )
        tasks = frozenset(chain.task[first : last + 1].tolist())
        # Within the tasks of a run, a robot carries the same.
        key = (index, tasks, frozenset((r.object, r.pose.tobytes()) for r in present))
        checker = self._checkers.get(key)
        if checker is None:
            checker = _checker(graph, index, first, tasks, present)
            self._checkers[key] = checker
        return all(checker.motion_free(a, b) for a, b in pairwise(path))


def _may_lie_there(
    order: NodeOrder, rest: Rest, index: int, first: int, last: int
) -> bool:
    """Tell whether an object may be at rest while nodes are under way."""
    too_late = rest.after is not None and order.precedes(index, last, *rest.after)
    gone = rest.before is not None and (
        rest.before == (index, first - 1)
        or order.precedes(*rest.before, index, first - 1)
    )
    return not (too_late or gone)


def _checker(
    graph: DerivedTpg,
    index: int,
    first: int,
    tasks: frozenset[int],
    present: tuple[Rest, ...],
) -> SceneChecker:
    """Return a checker against all that does not move: no robot that has nodes."""
    tpg = graph.tpg
    robot = tpg.chains[index].robot
    busy = tpg.chain_index
    handled = {handling.object for handling in tpg.handlings}
    attachments = {
        item.name: Attachment(None, item.start)
        for item in tpg.cell.objects
        if item.name not in handled and item.start is not None
    }
    for rest in present:
        attachments[rest.object] = Attachment(None, rest.pose)
    for span in graph.spans[index]:
        if span.carried and span.start <= (first, 0) < span.end:
            attachments[span.object] = Attachment(robot, span.pose)
    robots = tuple(r for r in tpg.cell.robots if r.name == robot or r.name not in busy)
    cell = Workcell(robots, tpg.cell.fixtures, tpg.cell.objects, tpg.cell.clearances)
    state = WorldState({r.name: r.home for r in robots}, attachments)
    allowed = frozenset(
        frozenset((c.first, c.second)) for c in tpg.allowed if tasks <= c.tasks
    )
    return SceneChecker(cell, robot, state, allowed, margin=MARGIN)
