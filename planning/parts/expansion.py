"""From choices to tasks: pick, carry over HOME, place, or a process, for every step (APEX-MR IV-A)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.geometry.robot_bodies import entity
from planning.parts.assembly import Grip
from planning.parts.candidates import PartCandidates
from planning.parts.handovers import Handover
from planning.parts.part_skills import held_pose
from planning.parts.part_steps import PartStep, WorkStep
from planning.parts.relays import Relay
from planning.parts.targets import process_targets
from planning.parts.waits import waiting_tasks
from planning.skills.contacts import gripped, touching
from planning.skills.joint_paths import SkillPath
from planning.skills.step_builder import StepBuilder
from planning.tasks.assignment import StepChoice, TaskPlan
from planning.tasks.task import STRAIGHT, StepTasks
from planning.tasks.work import AssemblyWork
from planning.transforms import Array


def part_work(candidates: PartCandidates) -> AssemblyWork:
    """Return the assembly work of part candidates, for assignment and motion planning."""
    return AssemblyWork(
        candidates.problem,
        partial(_expand_step, candidates),
        partial(waiting_tasks, candidates.steps, candidates.balance),
    )


def _expand_step(
    candidates: PartCandidates, plan: TaskPlan, step: int, first_index: int
) -> StepTasks:
    """Return the tasks of a step as the plan chooses it.

    Every transit ends at the configuration that the next skill starts from, or at HOME, where
    robots stop between pick and place and after it.
    """
    expander = _Expander(candidates, plan[step], StepBuilder(step, first_index))
    handled = candidates.steps[step - 1]
    if isinstance(handled, PartStep):
        expander.place(handled)
    else:
        expander.work(handled)
    return expander.build.build()


class _Expander:
    """Writes the tasks of one step into a builder."""

    def __init__(
        self, candidates: PartCandidates, choice: StepChoice, build: StepBuilder
    ) -> None:
        self.candidates, self.choice, self.build = candidates, choice, build

    def place(self, step: PartStep) -> None:
        """Write pick, the hold if any, place, and the ways back."""
        choice, build = self.choice, self.build
        robot, part = self.candidates.cell.robot(choice.robot), choice.object
        *_, pick, place = self.candidates.paths_of(choice)
        way = choice.step, choice.robot, choice.grasp
        relay = self.candidates.relays.get(way)
        if isinstance(relay, Handover):
            picked = self._hand_over(step, relay)
        elif relay is not None:
            laid = self._lay_down(step, relay)
            picked = self._pick(robot, part, pick, relay.take)
            build.allow(touching(part, relay.touched), picked)
            build.depend(laid, picked)
        else:
            picked = self._pick(robot, part, pick, step.grips[choice.grasp])
            build.allow(touching(part, step.at_start), picked)
        held = self._hold(step)
        build.lead_in(place, f"{part} to its place", part)
        placed = build.skill(place, f"place {part}", part, None, step.goal)
        build.transit(robot.name, robot.home, "HOME", None)
        carrying = build.of_robot(robot.name, picked, placed)
        build.allow(gripped(robot.name, part), *carrying)
        build.allow(touching(part, step.at_goal), placed)
        if held is not None:
            self._let_go(step, held, placed, placed)

    def _pick(self, robot: PlacedRobot, part: str, path: SkillPath, grip: Grip) -> int:
        """Write transit, pick and the way HOME with a part; return the pick."""
        build = self.build
        build.lead_in(path, f"to {part}", None)
        in_hand = held_pose(robot, self.candidates.frame, grip.pose)
        picked = build.skill(path, f"pick {part}", part, robot.name, in_hand)
        build.transit(robot.name, robot.home, f"HOME with {part}", part)
        return picked

    def _lay_down(self, step: PartStep, relay: Relay) -> int:
        """Write how the part is picked first and laid down in between; return the latter."""
        build, part = self.build, step.part.name
        robot = self.candidates.cell.robot(relay.giver)
        pick, down, *_ = relay.paths
        picked = self._pick(robot, part, pick, relay.give)
        build.lead_in(down, f"{part} to where it lies in between", part)
        laid = build.skill(down, f"lay down {part}", part, None, relay.rest)
        build.transit(robot.name, robot.home, "HOME", None)
        carrying = build.of_robot(robot.name, picked, laid)
        build.allow(gripped(robot.name, part), *carrying)
        build.allow(touching(part, step.at_start), picked)
        build.allow(touching(part, relay.touched), laid)
        return laid

    def _hand_over(self, step: PartStep, way: Handover) -> int:
        """Write pick and handover; return the task with which the receiver takes the part."""
        build, part, cell = self.build, step.part.name, self.candidates.cell
        giver, receiver = cell.robot(way.giver), cell.robot(way.receiver)
        pick, give, _ = way.paths
        picked = self._pick(giver, part, pick, way.give)
        build.transit(receiver.name, way.pre, "to the handover", None)
        ready = build.transit(receiver.name, way.receive, "ready to receive", None)
        build.lead_in(give, f"{part} to {receiver.name}", part)
        in_hand = held_pose(receiver, self.candidates.frame, way.take.pose)
        given = build.skill(give, f"hand over {part}", part, receiver.name, in_hand)
        build.depend(ready, given)
        carrying = build.of_robot(giver.name, picked, given)
        # The receiver stands at the end of its task "ready" while the part is brought.
        build.allow(gripped(giver.name, part), *carrying, ready)
        build.allow(touching(part, step.at_start), picked)
        build.transit(giver.name, giver.home, "HOME", None)
        taken = build.transit(receiver.name, way.pre, f"take {part}", part)
        build.depend(given, taken)
        build.allow(gripped(receiver.name, part), ready, given)
        build.transit(receiver.name, receiver.home, f"HOME with {part}", part)
        return taken

    def work(self, step: WorkStep) -> None:
        """Write the hold if any, approach, process, and the ways back."""
        choice, build, process = self.choice, self.build, step.step.process
        robot = self.candidates.cell.robot(choice.robot)
        (path,) = self.candidates.paths_of(choice)
        words, part = step.step.words, step.step.owner
        if part not in step.around:
            part = None
        targets = process_targets(process, step.place, process.turns[choice.grasp])
        way = [*path.lead, *path.path]
        held = self._hold(step)
        build.lead_in(path, f"to {words}", None)
        coming = f"approach to {words}"
        first = self._along(STRAIGHT, way[: targets.first + 1], coming, part)
        done = self._along(
            process.name, way[targets.first : targets.last + 1], words, part
        )
        back = self._along(STRAIGHT, way[targets.last :], f"back from {words}", part)
        tool = entity(robot.name, "tool")
        build.allow(touching(tool, step.touched), first, done, back)
        build.transit(robot.name, robot.home, "HOME", None)
        if held is not None:
            self._let_go(step, held, first, done)

    def _along(
        self, kind: str, way: Sequence[Array], label: str, part: str | None
    ) -> int:
        """Write a motion through configurations, the first of which is where it starts."""
        rest = way[1:] or way  # a process that stays where it is
        path = SkillPath(kind, self.choice.robot, np.array(way[:1]), np.array(rest))
        return self.build.skill(path, label, part)

    def _hold(self, step: PartStep | WorkStep) -> int | None:
        """Write how another robot grips what is held; return that task, None if nothing is."""
        path = self.candidates.hold_of(self.choice)
        if path is None or step.held is None:
            return None
        part = step.held.part.name
        self.build.lead_in(path, f"to hold {part}", None)
        return self.build.skill(path, f"hold {part}", part)

    def _let_go(
        self, step: PartStep | WorkStep, held: int, begun: int, done: int
    ) -> None:
        """Write the way back of who holds, once the other has done its work."""
        path, build = self.candidates.hold_of(self.choice), self.build
        assert path is not None
        assert step.held is not None
        part = step.held.part.name
        way_back = SkillPath(
            STRAIGHT, path.robot, path.path[-1:], path.waypoints[-2::-1]
        )
        back = build.skill(way_back, f"let go of {part}", part)
        home = self.candidates.cell.robot(path.robot).home
        build.transit(path.robot, home, "HOME", None)
        build.depend(held, begun)
        build.depend(done, back)
        build.allow(gripped(path.robot, part), held, back)
