"""From choices to tasks: pick, carry over HOME, place, for every step (APEX-MR IV-A)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

from planning.parts.candidates import PartCandidates, held_pose
from planning.skills.contacts import gripped, touching
from planning.skills.step_builder import StepBuilder
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import StepTasks, Task
from planning.tasks.work import AssemblyWork


def part_work(candidates: PartCandidates) -> AssemblyWork:
    """Return the assembly work of part candidates, for assignment and motion planning."""
    return AssemblyWork(
        candidates.problem,
        partial(_expand_step, candidates),
        partial(_waits, candidates),
    )


def _expand_step(
    candidates: PartCandidates, plan: TaskPlan, step: int, first_index: int
) -> StepTasks:
    """Return the tasks of a step as the plan chooses it.

    Every transit ends at the configuration that the next skill starts from, or at HOME, where
    robots stop between pick and place and after it.
    """
    choice, handled = plan[step], candidates.steps[step - 1]
    robot, part = candidates.cell.robot(choice.robot), choice.object
    grip = handled.grips[choice.grasp].pose
    pick, place = candidates.paths[step, choice.robot, choice.grasp]
    build = StepBuilder(step, first_index)
    build.lead_in(pick, f"to {part}", None)
    held = held_pose(robot, candidates.frame, grip)
    picked = build.skill(pick, f"pick {part}", part, robot.name, held)
    build.transit(robot.name, robot.home, f"HOME with {part}", part)
    build.lead_in(place, f"{part} to its place", part)
    placed = build.skill(place, f"place {part}", part, None, handled.goal)
    build.transit(robot.name, robot.home, "HOME", None)
    carrying = build.of_robot(robot.name, picked, placed)
    build.allow(gripped(robot.name, part), *carrying)
    build.allow(touching(part, handled.at_start), picked)
    build.allow(touching(part, handled.at_goal), placed)
    return build.build()


def _waits(
    candidates: PartCandidates, steps: Sequence[StepTasks]
) -> Iterator[tuple[Task, Task]]:
    """Yield what waits for what.

    A part is placed after those that it touches in its place, and picked after those that it
    touched in the stock and that were placed before it. Steps that do not touch need not wait
    for each other: what else must be kept in order follows from collisions.
    """
    done: dict[str, dict[str, Task]] = {"pick": {}, "place-down": {}}
    start_contacts = _stock_contacts(candidates)
    for step in steps:
        for task in step.tasks:
            if task.object is None or task.kind not in done:
                continue
            touched = (
                start_contacts[task.object]
                if task.kind == "pick"
                else candidates.steps[step.step - 1].at_goal
            )
            before = done[task.kind]
            for name in touched:
                if name in before:
                    yield before[name], task
            before[task.object] = task


def _stock_contacts(candidates: PartCandidates) -> dict[str, frozenset[str]]:
    """Return what each part touches at the start, whichever of the two is picked first."""
    parts = [step.part.name for step in candidates.steps]
    touched = {
        step.part.name: {other for other in step.at_start if other in parts}
        for step in candidates.steps
    }
    return {
        name: frozenset(touched[name] | {k for k in parts if name in touched[k]})
        for name in parts
    }
