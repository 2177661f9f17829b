"""Conflicts between the tasks of a sequential plan, by what their nodes occupy."""

from __future__ import annotations

from bisect import bisect_left, bisect_right

from planning.motion.motion_plan import MotionPlan
from scheduling.build_nodes import build_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.ordering.relations import TaskRelations


class SweptTaskConflicts:
    """Conflicts of tasks, decided as those of nodes are; implements TaskConflicts.

    Args:
        plan: the sequential plan.
    """

    def __init__(self, plan: MotionPlan) -> None:
        tpg = build_nodes(plan)
        self._chain = tpg.chain_index
        self._relations = TaskRelations(DerivedTpg(tpg))
        units = self._relations.units
        self._unit = {unit.task: k for k, unit in enumerate(units)}
        self._of_chain = [
            [units[k].task for k in own] for own in self._relations.of_chain
        ]
        self._robot_tasks = {
            robot.name: [t.index for t in plan.tasks if t.robot == robot.name]
            for robot in plan.cell.robots
        }

    def sweeps(self, first: int, second: int) -> bool:
        """Tell whether two tasks of different robots conflict if done at any times."""
        if first not in self._unit or second not in self._unit:
            return False
        return not self._relations.sweeps_clear(self._unit[first], self._unit[second])

    def hold(self, robot: str, after: int | None, task: int) -> bool:
        """Tell whether a task runs into a robot that stands where one of its tasks ended."""
        own = self._robot_tasks[robot]
        before = own[: bisect_left(own, task)]
        if task not in self._unit or after == (before[-1] if before else None):
            # The sequential plan has it stand there during the task.
            return False
        if robot not in self._chain:
            return not self._relations.idle_clear(robot, self._unit[task])
        chain = self._chain[robot]
        done = 0 if after is None else bisect_right(self._of_chain[chain], after)
        return not self._relations.stands_clear(chain, done, self._unit[task])

    def left_behind(self, first: int, task: int) -> bool:
        """Tell whether a task runs into an object where the task ``first`` leaves it."""
        return self._rests_in_the_way(self._relations.left_by, first, task)

    def not_yet_taken(self, task: int, later: int) -> bool:
        """Tell whether a task runs into an object that the task ``later`` picks up."""
        return self._rests_in_the_way(self._relations.taken_by, later, task)

    def _rests_in_the_way(
        self, rests: dict[int, list[int]], other: int, task: int
    ) -> bool:
        if other not in self._unit or task not in self._unit:
            return False
        return not all(
            self._relations.rest_clear(number, self._unit[task])
            for number in rests.get(self._unit[other], ())
        )
