"""Collision checks of a multi-robot transit against the whole swept volumes of skills executed at the same time.

The duration of a skill, such as a pick, is not known in advance. So the transit cannot be synchronized with it, and
must avoid the whole swept volume of the skill. Geometry and tolerances are those of the conflict search, which
therefore finds no conflict between the two later.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from planning.motion.motion_plan import TaskMotion
from planning.motion.sequential import MARGIN
from planning.transforms import Array
from scheduling.conflicts.allowed_contacts import contact_table
from scheduling.conflicts.conflict_search import first_conflict
from scheduling.conflicts.derived_tpg import DerivedTpg, Occupant
from scheduling.conflicts.object_spans import ObjectSpan
from scheduling.conflicts.occupancy import chain_occupancy
from scheduling.graph.task_edges import TaskNodes
from scheduling.graph.temporal_plan_graph import pose_nodes
from scheduling.synchronous.composite import CompositeChecker


class ConcurrentSkillChecker:
    """Collision checks of a composite of robots while others do skills.

    Args:
        checker: of the robots that move, without those that do skills.
        graph: of the sequential plan.
        transits: the nodes of each moving robot's task there; what it carries follows from them.
        skills: what is done meanwhile.
    """

    def __init__(
        self,
        checker: CompositeChecker,
        graph: DerivedTpg,
        transits: Mapping[str, TaskNodes],
        skills: Sequence[Occupant],
    ) -> None:
        self.speed = checker.speed
        self._checker, self._graph, self._transits = checker, graph, transits
        self._skills = skills
        cell = graph.tpg.cell
        wider = replace(
            cell.clearances,
            robot_robot=cell.clearances.robot_robot + MARGIN,
            robot_object=cell.clearances.robot_object + MARGIN,
        )
        self._table = contact_table(
            graph.entities, len(cell.robots), graph.tpg.allowed, wider
        )
        self._held = {name: _in_hand(graph, nodes) for name, nodes in transits.items()}

    def configuration_free(self, q: Array) -> bool:
        """Tell whether all robots may stand at composite ``q`` during the skills, shape (n,)."""
        return self._checker.configuration_free(q) and self._clear(q, q)

    def motion_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether the composite line from ``q_a`` to ``q_b`` is free, shape (n,)."""
        return self._checker.motion_free(q_a, q_b) and self._clear(q_a, q_b)

    def seems_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether some configurations of the line are free, and all of it is clear of the skills."""
        return self._checker.seems_free(q_a, q_b) and self._clear(q_a, q_b)

    def motions(self, path: Array) -> dict[str, TaskMotion] | None:
        """Return the motion of each robot on a composite polyline; see ``CompositeChecker``."""
        found = self._checker.motions(path)
        if found is None or not all(
            self._clear_of_skills(name, motion.path) for name, motion in found.items()
        ):
            return None
        return found

    def _clear(self, q_a: Array, q_b: Array) -> bool:
        return all(
            self._clear_of_skills(name, np.stack([q_a[own], q_b[own]]))
            for name, own in zip(
                self._checker.robots, self._checker.joints, strict=True
            )
        )

    def _clear_of_skills(self, robot: str, path: Array) -> bool:
        """Tell whether a robot on a polyline, shape (w, n), is clear of the skills' swept volumes."""
        path = path if len(path) > 1 else np.repeat(path, 2, axis=0)
        count = len(path) - 1
        task = self._transits[robot].task
        nodes = pose_nodes(robot, path[0], path[1:], task, 0.0)
        held = [replace(span, end=(count, 0)) for span in self._held[robot]]
        own = chain_occupancy(self._graph.tpg.cell, nodes, held, self._graph.entities)
        floor = np.full(count, -1, dtype=np.int64)
        return all(
            first_conflict(
                own, skill.occupancy, floor, np.full(count, skill.nodes), self._table
            )
            is None
            for skill in self._skills
        )


def _in_hand(graph: DerivedTpg, nodes: TaskNodes) -> list[ObjectSpan]:
    """Return the objects that a robot carries throughout a transit, as spans from its first node on."""
    return [
        replace(span, start=(0, 0))
        for span in graph.spans[nodes.chain]
        if span.carried and span.start <= (nodes.first, 0) < span.end
    ]
