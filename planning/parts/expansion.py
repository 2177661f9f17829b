"""Expansion of the choices of an assignment to tasks: pick, place, hold and process (APEX-MR IV-A)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from planning.contacts.interference import shapes_overlap_depth
from planning.contacts.touching import standing_fixtures
from planning.grips.grip import Grip
from planning.handling.handovers import Handover
from planning.handling.placement import (
    PlannedHandover,
    PlannedPlacement,
    PlannedSkill,
    PlannedSupport,
    write_placement,
    write_release,
    write_support,
)
from planning.handling.tool_changes import with_tools
from planning.parts.assembly import MachineWork, Work
from planning.parts.candidates import PartCandidates
from planning.parts.part_skills import held_pose, process_targets
from planning.parts.part_steps import PartStep
from planning.parts.spares import with_chosen_spares
from planning.steps.skill import SkillPath, contacts_with, handled_contact, tool_entity
from planning.steps.step_writer import StepWriter
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import Handling, StepTasks, TaskKind
from planning.transforms import Transform

_STRAYS = 2e-4
"""A carried part strays from its straight path by this: joints move evenly between its poses [m]."""


def step_tasks(
    candidates: PartCandidates, plan: TaskPlan, step: int, first: int
) -> StepTasks:
    """Return the tasks of a step of a plan, numbered from an index on."""
    chosen = with_chosen_spares(candidates, ((c.step, c.object) for c in plan.choices))
    return _Expansion(chosen, plan, step, first).tasks()


class _Expansion:
    """A step with its choice, and its tasks.

    Args:
        candidates: of all steps.
        plan: what was chosen.
        step: counted from 1.
        first: index of its first task.
    """

    def __init__(
        self, candidates: PartCandidates, plan: TaskPlan, step: int, first: int
    ) -> None:
        self._candidates, self._plan, self._choice = candidates, plan, plan[step]
        self._known = candidates.steps[step - 1]
        self._cell = with_tools(candidates.cell, self._choice.tools)
        self._paths = candidates.paths.planned(plan, step)
        self._build = StepWriter(self._cell, step, first, actuated=True)

    def tasks(self) -> StepTasks:
        """Return the tasks of the step; tool changes come first."""
        changes, build, step = self._candidates.changes, self._build, self._known.step
        number, supply = self._choice.step, self._candidates.assembly.supply
        before = {**changes.mounted, **self._plan.tools_before(number)}
        if build.first == 0:
            changes.begin(build)
        for robot, tool in sorted(self._choice.tools):
            if before[robot] != tool:
                changes.change(build, robot, before[robot], tool)
        if isinstance(self._known, PartStep):
            done = write_placement(build, self._placement(self._known))
        elif isinstance(step, Work):
            done = self._process(step)
        else:
            assert isinstance(step, MachineWork)
            shut: tuple[Handling, ...] = ()
            if step.door is not None:
                shut = _shut_door_handlings(
                    step.door, self._cell.object(step.door).start
                )
            about = step.machine, step.process, step.words, step.part, shut
            done = build.machine_task(*about)
        for earlier, last in self._candidates.paths.keeps.items():
            if last == number:
                self._let_go(earlier, done)
        if self._candidates.assembly.returns and number == len(self._candidates.steps):
            now = before | dict(self._choice.tools)
            for robot, tool in changes.mounted.items():
                if now[robot] != tool:
                    changes.change(build, robot, now[robot], tool)
        for lag in self._candidates.assembly.lags_after(step.name):
            words = f"{lag.least:g} s after {lag.step}"
            build.machine_task(str(lag.machine), TaskKind.LAG, words, None)
        if (leaving := supply.leaves.get(number)) is not None:
            gone = tuple(
                Handling(part, 1, Handling.GONE, pose) for part, pose in leaving.parts
            )
            build.machine_task(leaving.machine, TaskKind.LEAVE, "leaves", None, gone)
        for own in supply.changeovers_after.get(number, ()):
            build.machine_task(own.machine, TaskKind.CHANGEOVER, own.words, own.part)
        changes.allow_mounted(build, before)
        return self._with_depths(build.build())

    def _with_depths(self, tasks: StepTasks) -> StepTasks:
        """Return tasks with the penetration depths allowed to a part in its place and along its insertion."""
        known = self._known
        if not isinstance(known, PartStep):
            return tasks
        part, placed = known.part, standing_fixtures(self._cell) | known.others
        handling = self._candidates.assembly.handling(part.name)
        straight = (
            (known.place, np.array(handling.insertion), handling.approach),
            (part.start, -np.array(handling.extraction), handling.leave),
        )
        allowed = []
        for contact in tasks.allowed:
            (*_, other) = {contact.first, contact.second} - {part.name}
            if part.name in (contact.first, contact.second) and other in placed:
                item = part, part.start
                deep = shapes_overlap_depth(item, placed[other], straight)
                contact = replace(contact, depth=round(deep + _STRAYS, 6))
            allowed.append(contact)
        return replace(tasks, allowed=tuple(allowed))

    def _placement(self, step: PartStep) -> PlannedPlacement:
        """Return the pick, handover, hold and place of the part."""
        choice, part, paths = self._choice, step.part.name, self._candidates.paths
        *_, pick, place = self._paths
        kept = choice.step in paths.keeps
        if kept:
            place = replace(place, path=place.path[: place.change_at])
        relay = paths.relays.get(choice.primary)
        between: tuple[PlannedSkill, PlannedSkill] | PlannedHandover | None = None
        if relay is None:
            first = self._pick(part, pick, step.grips[choice.grasp], step.at_start)
        else:
            first = self._pick(part, relay.give.path, relay.give.grip, step.at_start)
            rest = relay.between
            if isinstance(rest, Handover):
                in_hand = self._in_hand(place.robot, relay.take.grip)
                between = PlannedHandover(rest, in_hand, by_home=True)
            else:
                coming = f"{part} to where it lies in between"
                contacts = contacts_with(part, rest.touched)
                laid, _ = relay.passing
                down = laid, coming, f"lay down {part}", rest.pose, contacts
                again = self._pick(part, pick, relay.take.grip, rest.touched)
                between = PlannedSkill(*down), again
        refill = self._candidates.assembly.supply.refills.get(choice.step)
        contacts = contacts_with(part, step.touched)
        coming, words = f"{part} to its place", f"place {part}"
        put = PlannedSkill(place, coming, words, step.place, contacts)
        return PlannedPlacement(
            part, replace(first, refill=refill), between, put, self._hold(), kept=kept
        )

    def _hold(self) -> PlannedSupport | None:
        """Return the grip of another robot on a part held meanwhile, None if nothing is."""
        path = self._candidates.paths.planned_hold(self._plan, self._choice.step)
        if path is None or self._known.held is None:
            return None
        part = self._known.held.part.name
        grips = PlannedSkill(path, f"to hold {part}", f"hold {part}")
        touched = handled_contact(self._cell.robot(path.robot), part)
        return PlannedSupport(grips, part, f"let go of {part}", touched)

    def _pick(
        self, part: str, path: SkillPath, grip: Grip, touched: Iterable[str]
    ) -> PlannedSkill:
        in_hand = self._in_hand(path.robot, grip)
        contacts = contacts_with(part, touched)
        return PlannedSkill(path, f"to {part}", f"pick {part}", in_hand, contacts)

    def _in_hand(self, robot: str, grip: Grip) -> Transform:
        """Return the pose of a gripped part in the flange frame of its robot."""
        frame = self._candidates.assembly.frame
        return held_pose(self._cell.robot(robot), frame, grip.pose)

    def _process(self, step: Work) -> int:
        """Write the hold if any, approach, process, and retreats; return the process."""
        build, known, words = self._build, self._known, step.words
        robot, owner = self._cell.robot(self._choice.robot), step.spot.owner
        part = owner if owner in known.around else None
        turn = step.process.turns[self._choice.grasp]
        targets = process_targets(step.process, known.place, turn)
        first, last = targets.first, targets.last
        (path,) = self._paths
        waypoints = np.vstack([path.lead, path.path])
        hold = self._hold()
        held = 0 if hold is None else write_support(build, hold)
        build.lead_in(path, f"to {words}")
        begun, done, back = (
            # A process may stay where it is.
            build.skill(
                SkillPath(
                    kind,
                    robot.name,
                    waypoints[begin : begin + 1],
                    waypoints[min(begin + 1, end) : end + 1],
                ),
                label,
                part,
            )
            for kind, begin, end, label in (
                (TaskKind.STRAIGHT, 0, first, f"approach to {words}"),
                (step.process.name, first, last, words),
                (TaskKind.STRAIGHT, last, len(waypoints) - 1, f"back from {words}"),
            )
        )
        build.allow(contacts_with(tool_entity(robot), known.touched), begun, done, back)
        build.home(robot.name)
        if hold is not None:
            write_release(build, hold, held, begun, done)
        return done

    def _let_go(self, step: int, done: int) -> None:
        """Write the retreat of the robot that held a part placed in an earlier step, after a task."""
        choice, paths = self._plan[step], self._candidates.paths
        back = paths.release(paths.planned(self._plan, step)[-1])
        cell = with_tools(self._candidates.cell, choice.tools)
        build, label = replace(self._build, cell=cell), f"let go of {choice.object}"
        index = build.skill(back, label, choice.object, lets_go=True)
        build.home(choice.robot)
        build.depend(done, index)
        build.allow(handled_contact(cell.robot(choice.robot), choice.object), index)


def _shut_door_handlings(door: str, pose: Transform) -> tuple[Handling, Handling]:
    """Return the handlings by which a door appears when a task begins, and is gone at its end.

    So no robot may be there for as long as the task may last, and it rests nowhere in between.
    """
    return Handling(door, 0, None, pose), Handling(door, 1, Handling.GONE, pose)
