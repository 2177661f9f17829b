"""Synchronous baseline: robots work in slots and wait for each other (APEX-MR, section V-A and appendix E).

In a slot every robot does its next task or waits. The next slot starts when all robots have finished. Tasks
that cannot be done at the same time keep the order of the sequential plan. A robot without conflicts follows
its path of the sequential plan with its own timing. Transits that would collide are planned jointly, as one
robot with all joints. Optionally, as in the paper, all transits of a slot are planned jointly.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.cell.workcell import WorldState
from planning.errors import TransitError
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.motion.sequential import MARGIN, MotionSettings
from planning.motion.speed import path_duration
from planning.motion.transit import RrtConnect
from planning.progress import Progress, no_progress
from planning.tasks.task import TaskKind, apply_handlings
from planning.tasks.task_graph import task_graph
from planning.transforms import Indices
from scheduling.build_nodes import build_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.ordering.relations import TaskRelations
from scheduling.synchronous.composite import CompositeChecker, without_robots
from scheduling.synchronous.concurrent_skills import ConcurrentSkillChecker

_SHORTEST = 1e-3
"""Duration of a slot without motion, so that slots do not start simultaneously [s]."""


class TaskConflicts:
    """Conflicts between tasks of a sequential plan, by the occupancy of their nodes.

    Tasks are given by index. Motions are those of the sequential plan, with what is carried,
    picked up and put down; contacts that the plan allows are no conflicts.

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
        """Tell whether two tasks of different robots conflict if executed at any times."""
        if first not in self._unit or second not in self._unit:
            return False
        return not self._relations.sweeps_clear(self._unit[first], self._unit[second])

    def hold(self, robot: str, after: int | None, task: int) -> bool:
        """Tell whether a task collides with a robot standing where one of its tasks ended.

        Args:
            robot: the standing robot.
            after: its task, None for before its first.
            task: a task of another robot.
        """
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

    def concurrent_skill_checker(
        self, checker: CompositeChecker, transits: Sequence[int], skills: Sequence[int]
    ) -> ConcurrentSkillChecker:
        """Return checks of robots in transit while others do skills.

        Args:
            checker: of the robots that move, without those that do skills.
            transits: their tasks.
            skills: the tasks that are done meanwhile.
        """
        relations = self._relations
        nodes = [relations.units[self._unit[task]] for task in transits]
        return ConcurrentSkillChecker(
            checker,
            relations.graph,
            dict(zip(checker.robots, nodes, strict=True)),
            [relations.occupant(self._unit[t]) for t in skills if t in self._unit],
        )

    def meets_left_object(self, first: int, task: int) -> bool:
        """Tell whether a task collides with an object where the task ``first`` leaves it."""
        return self._rests_in_the_way(self._relations.left_by, first, task)

    def meets_untaken_object(self, task: int, later: int) -> bool:
        """Tell whether a task collides with an object that the task ``later`` picks up."""
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


@dataclass(frozen=True)
class SynchronousPlan:
    """A plan in slots.

    Attributes:
        motion_plan: with the tasks of the sequential plan, timed by slots.
        slot_of_task: slot of each task, from 0, in the order of the tasks, shape (tasks,).
        jointly_planned: groups of transits that were planned as one robot; one alone, where
            all that was done beside it were skills.
    """

    motion_plan: MotionPlan
    slot_of_task: Indices
    jointly_planned: tuple[tuple[int, ...], ...] = ()


@dataclass
class _Slot:
    """A slot that is being filled.

    Attributes:
        motions: what each task in it does, times from the start of the slot.
        joint: tasks that move in lock step.
    """

    motions: dict[int, TaskMotion] = field(default_factory=dict)
    joint: tuple[int, ...] = ()

    @property
    def seconds(self) -> float:
        return max((float(m.time[-1]) for m in self.motions.values()), default=0.0)


def plan_synchronous(
    plan: MotionPlan,
    settings: MotionSettings,
    conflicts: TaskConflicts | None = None,
    progress: Progress = no_progress,
    *,
    always_jointly: bool = False,
) -> SynchronousPlan:
    """Turn a sequential plan into one in slots.

    A task comes into a slot when its dependencies are done, it is clear of what the others do
    in the slot, and where it ends is clear of all earlier tasks that are still to come: so the
    earliest task left can always be done as in the sequential plan, and there is no deadlock.

    Args:
        plan: one task after another.
        settings: of the sequential plan: speeds, step, attempts and seed.
        conflicts: of the tasks of ``plan``, where they are known.
        progress: called with the tasks done and the tasks in all.
        always_jointly: plan all transits of a slot in which several robots move as one robot,
            beside what skills in it sweep, however long that takes; by default only those that
            would collide, where that saves time.

    Raises:
        TransitError: the sequential plan does not hold on its own.
    """
    conflicts = conflicts or TaskConflicts(plan)
    planner = _Planner(plan, settings, conflicts, always_jointly=always_jointly)
    return planner.plan(progress)


class _Planner:
    """Fills slot after slot."""

    def __init__(
        self,
        plan: MotionPlan,
        settings: MotionSettings,
        conflicts: TaskConflicts,
        *,
        always_jointly: bool,
    ) -> None:
        self.sequential = plan
        self.settings = settings
        self.conflicts = conflicts
        self.always_jointly = always_jointly
        self.tasks = {task.index: task for task in plan.tasks}
        self.motions = {
            task.index: motion
            for task, motion in zip(plan.tasks, plan.motions, strict=True)
        }
        self.before = _prerequisites(plan)
        self.queue: dict[str, list[int]] = {r.name: [] for r in plan.cell.robots}
        for task in reversed(plan.tasks):
            self.queue[task.robot].append(task.index)
        self.out: dict[int, TaskMotion] = {}
        self.slot_of: dict[int, int] = {}
        self.last: dict[str, int] = {}
        self.state: WorldState = plan.cell.start_state()
        self.handles = {t.index for t in plan.tasks if t.handlings}

    def plan(self, progress: Progress) -> SynchronousPlan:
        groups: list[tuple[int, ...]] = []
        clock, number = 0.0, 0
        while len(self.out) < len(self.tasks):
            self._finish_still(clock, number)
            slot = self._fill()
            if not slot.motions:
                break
            for index, motion in slot.motions.items():
                timed = TaskMotion(motion.path, clock + motion.time)
                self._finish(index, timed, number)
            if slot.joint:
                groups.append(slot.joint)
            clock += max(slot.seconds, _SHORTEST)
            number += 1
            progress(len(self.out), len(self.tasks))
        order = [task.index for task in self.sequential.tasks]
        plan = replace(
            self.sequential, motions=tuple(self.out[index] for index in order)
        )
        slots = np.array([self.slot_of[index] for index in order], dtype=np.int64)
        return SynchronousPlan(plan, slots, tuple(groups))

    def _finish(self, index: int, motion: TaskMotion, slot: int) -> None:
        task = self.tasks[index]
        self.out[index], self.slot_of[index] = motion, slot
        self.queue[task.robot].pop()
        self.last[task.robot] = index
        self.state = apply_handlings(
            self.state.with_robot(task.robot, motion.path[-1]), task.handlings
        )

    def _finish_still(self, clock: float, slot: int) -> None:
        """Complete all tasks in which nothing moves and nothing changes hands."""
        again = True
        while again:
            again = False
            for queue in self.queue.values():
                while queue and self._is_still(queue[-1]) and self._ready(queue[-1]):
                    path = self.motions[queue[-1]].path
                    still = TaskMotion(path, np.full(len(path), clock))
                    self._finish(queue[-1], still, slot)
                    again = True

    def _is_still(self, index: int) -> bool:
        return (
            self.tasks[index].kind == TaskKind.TRANSIT
            and index not in self.handles
            and not np.any(np.diff(self.motions[index].path, axis=0))
        )

    def _ready(self, index: int) -> bool:
        return self.before[index] <= self.out.keys()

    def _fill(self) -> _Slot:
        slot = _Slot()
        candidates = sorted(queue[-1] for queue in self.queue.values() if queue)
        for position, index in enumerate(candidates):
            if not self._ready(index):
                problem = "what it depends on is not done"
            else:
                problem = self._admit(slot, index)
            if problem and position == 0:
                task = self.tasks[index]
                raise TransitError(
                    f"task {index} ({task.label}) of robot {task.robot!r} cannot be done"
                    f" as in the sequential plan: {problem}"
                )
        if not self.always_jointly or self._plan_slot(slot):
            return slot
        # Not all of them together: as many as possible, in the order of the plan.
        refused, slot = tuple(slot.motions), _Slot()
        for index in filter(self._ready, candidates):
            if self._admit(slot, index):
                continue
            if tuple(slot.motions) == refused or not self._plan_slot(slot):
                del slot.motions[index]
        return slot

    def _plan_slot(self, slot: _Slot) -> bool:
        """Plan the transits of a slot as one composite, in parallel to its skills; tell whether it succeeded."""
        if len(slot.motions) < 2:
            return True
        skills = [index for index in slot.motions if not self._is_transit(index)]
        transits = tuple(index for index in slot.motions if index not in skills)
        if not transits:
            return True
        motions = self._plan_composite(transits, np.inf, skills)
        if motions is None:
            return False
        slot.motions |= {i: motions[self.tasks[i].robot] for i in transits}
        slot.joint = transits
        return True

    def _is_transit(self, index: int) -> bool:
        return self.tasks[index].kind == TaskKind.TRANSIT and index not in self.handles

    def _admit(self, slot: _Slot, index: int) -> str:
        """Add a task to the slot; return the reason if it is refused, empty when added."""
        task, conflicts = self.tasks[index], self.conflicts
        earlier = self._earlier(index, slot)
        for later in earlier | (slot.motions.keys() & self.handles):
            if conflicts.meets_untaken_object(index, later):
                return f"it runs into an object that task {later} takes away"
        moving = {self.tasks[other].robot for other in slot.motions}
        for robot in self.queue:
            if robot in moving or robot == task.robot:
                continue
            if conflicts.hold(robot, self.last.get(robot), index):
                return f"robot {robot!r} stands in its way"
        for other in earlier:
            if conflicts.hold(task.robot, index, other) or (
                index in self.handles and conflicts.meets_left_object(index, other)
            ):
                return f"it would block task {other}"
        if self.always_jointly:
            fixed = [i for i in (*slot.motions, index) if not self._is_transit(i)]
            if index in fixed and any(conflicts.sweeps(index, i) for i in fixed[:-1]):
                return "it is in the way of another robot's skill"
        # A robot in lock step has left its sequential path, the only one known.
        elif slot.joint or any(conflicts.sweeps(index, i) for i in slot.motions):
            return self._move_together(slot, index)
        motion = self.motions[index]
        slot.motions[index] = TaskMotion(motion.path, motion.time - motion.time[0])
        return ""

    def _earlier(self, index: int, slot: _Slot) -> set[int]:
        """Return the tasks of others that precede it in the sequential plan, but not here."""
        found = set()
        for robot, queue in self.queue.items():
            if robot == self.tasks[index].robot:
                continue
            for other in reversed(queue):
                if other > index:
                    break
                if other not in slot.motions:
                    found.add(other)
        return found

    def _move_together(self, slot: _Slot, index: int) -> str:
        """Replan the transits of the slot as one composite, where that saves time."""
        indices = (*slot.motions, index)
        if not all(map(self._is_transit, indices)):
            return "it is in the way of another robot's skill, or that in its"
        own = self.motions[index].time
        without = slot.seconds + float(own[-1] - own[0])
        motions = self._plan_composite(indices, without)
        if motions is None:
            return f"tasks {indices} cannot be done at once"
        slot.motions = {i: motions[self.tasks[i].robot] for i in indices}
        slot.joint = indices
        return ""

    def _plan_composite(
        self, indices: Sequence[int], without: float, skills: Sequence[int] = ()
    ) -> Mapping[str, TaskMotion] | None:
        """Return motions of a composite path that takes less time than separate ones.

        Args:
            indices: transits.
            without: what the tasks take apart [s].
            skills: tasks that others do meanwhile.
        """
        settings, cell = self.settings, self.sequential.cell
        robots = [self.tasks[i].robot for i in indices]
        busy = [self.tasks[i].robot for i in skills]
        if skills:
            cell = without_robots(cell, self.state, busy)
        together = CompositeChecker(
            cell,
            dict(zip(robots, indices, strict=True)),
            self.state,
            self.last,
            self.sequential.allowed,
            settings.speeds,
            step=settings.step,
            margin=MARGIN,
        )
        checker: CompositeChecker | ConcurrentSkillChecker = together
        if skills:
            checker = self.conflicts.concurrent_skill_checker(together, indices, skills)
        start = np.concatenate([self.state.configurations[name] for name in robots])
        goal = np.concatenate([self.tasks[i].path[-1] for i in indices])
        if not (checker.configuration_free(start) and checker.configuration_free(goal)):
            return None
        models = [cell.robot(name).model for name in robots]
        planner = RrtConnect(
            np.concatenate([model.lower for model in models]),
            np.concatenate([model.upper for model in models]),
            checker.speed,
            reach=0.7 * float(np.sqrt(len(robots))),
            checks=2000,
            smoothing=120 * len(robots),
        )
        for attempt in range(settings.attempts):
            seed = (settings.seed * 1_000_003 + max(indices)) * 64 + attempt
            path = planner.plan(checker, start, goal, seed)
            if path is None or path_duration(path, checker.speed) >= without:
                continue
            motions = checker.motions(path)
            if motions is not None:
                return motions
        return None


def _prerequisites(plan: MotionPlan) -> dict[int, set[int]]:
    """Return the tasks that must be done before each task.

    Those it depends on, the one before it of its robot, and those that handled its object.
    """
    graph = task_graph(plan.tasks, plan.dependencies)
    before = {task.index: set(graph.predecessors(task.index)) for task in plan.tasks}
    last: dict[str, int] = {}
    for task in plan.tasks:
        names = [handling.object for handling in task.handlings]
        before[task.index].update(last[name] for name in names if name in last)
        last.update(dict.fromkeys(names, task.index))
    return before
