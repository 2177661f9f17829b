"""Expansion of the assigned steps of a LEGO assembly to skills with allowed contacts (APEX-MR IV-A)."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from planning.cell.workcell import CellObject, Workcell
from planning.geometry.robot_bodies import entity_name
from planning.handling.handovers import Handover
from planning.handling.placement import (
    PlannedHandover,
    PlannedPlacement,
    PlannedSkill,
    PlannedSupport,
    write_placement,
)
from planning.handling.skill_contacts import NOTHING, grip_contact
from planning.handling.skill_trial import ResolvedSkill
from planning.handling.task_history import TaskHistory
from planning.kinematics.kinematics import frame_pose
from planning.lego.bricks.assembly import GridSpan, LegoAssembly, OnGrid, PlacedBrick
from planning.lego.bricks.brick_world import (
    BrickWorld,
    copy_name,
    next_copy,
    press_from_number,
    station_of,
)
from planning.lego.skills.brick_contacts import (
    Bricks,
    resting_contacts,
    resting_room,
    support_contacts,
)
from planning.lego.skills.candidates import LazyBrickCandidates, LegoCandidates
from planning.lego.skills.support_targets import supported_span
from planning.steps.skill import Obstruction, Pairs, contacts_with
from planning.steps.step_writer import StepWriter
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import StepTasks, Task
from planning.transforms import Array, Transform, inverse

PLACES = ("place-down", "place-up")
SUPPORTS = ("support-bottom", "support-top")


@dataclass(frozen=True)
class LegoWork(Assembly):
    """A LEGO assembly with its candidates, for assignment and motion planning.

    Attributes:
        candidates: of the steps of the problem.
        lazy: source of the candidates of first steps; None where those of all are found.
    """

    candidates: LegoCandidates
    lazy: LazyBrickCandidates | None = field(default=None, repr=False, kw_only=True)

    @property
    def built(self) -> LegoAssembly:
        """The plate, the stock and the steps."""
        return self.candidates.world.assembly

    def first(self, count: int) -> LegoWork:
        """Return the assembly of a number of first steps."""
        return (
            super().first(count)
            if self.lazy is None
            else lego_work(self.lazy.first(count))
        )

    def expand(self, plan: TaskPlan, step: int, first: int) -> StepTasks:
        """Return the tasks of a step; the bricks of earlier choices stand around it."""
        build = StepWriter(self.candidates.world.cell, step, first)
        write_placement(
            build, _ChosenBrickStep(self.candidates, plan, step).placement()
        )
        return build.build()

    def waits(self, steps: Sequence[StepTasks]) -> Iterator[tuple[Task, Task]]:
        """Yield the precedence pairs of steps.

        A place waits for the place before it, and so does a support; a brick of the stock is picked
        after those that stood on it, a station's once it has come up.
        """
        world, history = self.candidates.world, TaskHistory()
        brought = {
            handling.object: task
            for task in (task for step in steps for task in step.tasks)
            for handling in task.handlings
            if handling.object != task.object
        }
        for task in (task for step in steps for task in step.tasks):
            if task.kind in (*PLACES, *SUPPORTS):
                yield from history.before(task, "placed", "the brick before")
            if task.kind in PLACES:
                history.put("placed", "the brick before", task)
            if task.kind == "pick" and task.object is not None:
                source = station_of(task.object, world.stations)
                yield from history.before(task, "picked", *world.above[source])
                history.put("picked", source, task)
                if task.object in brought:
                    yield brought[task.object], task


def lego_work(candidates: LegoCandidates) -> LegoWork:
    """Return the assembly of LEGO candidates, for assignment and motion planning."""
    return LegoWork(candidates.problem, candidates)


def lazy_lego_work(cell: Workcell, assembly: LegoAssembly) -> LegoWork:
    """Return an assembly whose candidates are found as ``first`` asks for steps."""
    lazy = LazyBrickCandidates(cell, assembly)
    return replace(lego_work(lazy.first(0)), lazy=lazy)


def _bricks_taken(
    plan: TaskPlan, step: int, stations: Collection[str]
) -> tuple[list[str], Mapping[str, int]]:
    """Return the bricks taken up to a step of a plan, and the brick at each station after it.

    Of steps that have taken their bricks it is these; the others take those that come up from then on.

    Args:
        plan: the choices, and what has been taken.
        step: the last one, from 1.
        stations: names of the feeding stations.

    Returns:
        An object for each step, and the number of a brick by station.
    """
    number = dict.fromkeys(stations, 1)
    for name in plan.present:
        if (source := station_of(name, stations)) != name:
            number[source] = max(number[source], int(name.rpartition(".")[2]))
    names: list[str] = []
    for choice in plan.choices[:step]:
        source = choice.object
        if choice.step in plan.taken:
            names.append(plan.taken[choice.step])
        elif source in stations:
            names.append(copy_name(source, number[source]))
            number[source] += 1
        else:
            names.append(source)
    return names, number


class _ChosenBrickStep:
    """A step with its choice, and the bricks around it at that time."""

    def __init__(self, candidates: LegoCandidates, plan: TaskPlan, step: int) -> None:
        self.skills = candidates.skills
        self.world: BrickWorld = candidates.world
        self.choice = plan[step]
        self.work = self.world.step(step)
        source, stations = self.choice.object, self.world.stations
        self._taken, self._next = _bricks_taken(plan, step, stations)
        self.brick = self._taken[-1]
        self.refill: CellObject | None = None
        if source in stations:
            item = self.world.stock_at_rest[source][0]
            self.refill = next_copy(item, source, self._next[source])

    def placement(self) -> PlannedPlacement:
        """Return pick, handover if any, support if any, and place."""
        robot, step, grasp = self.choice.robot, self.choice.step, self.choice.grasp
        by, giver = self.choice.support, self.choice.primary.partner
        support, between, up = None, None, self.work.up
        if by is not None:
            held = _option(self.skills.support(by.robot, step, by.pose))
            support = self._support(held, by.pose)
        if giver is not None:
            handover = self.skills.handover(giver, robot, step, grasp)
            assert isinstance(handover, Handover), handover
            flange = inverse(self._flange(robot, handover.receive))
            in_hand = flange @ handover.meeting.at
            between = PlannedHandover(handover, in_hand)
        pick = self._pick(giver or robot)
        place = self._place(_option(self.skills.place(robot, step, grasp, by)))
        return PlannedPlacement(
            self.brick, pick, between, place, support, support_late=up
        )

    def _pick(self, robot: str) -> PlannedSkill:
        brick, source = self.brick, self.choice.object
        option = _option(self.skills.pick(robot, source, self.choice.grasp))
        start = self.world.stock_at_rest[source][1].pose
        held = inverse(self._flange(robot, option.path.contact)) @ start
        item = self.world.stock[source]
        near = self.world.bricks_near_stock(source, self.choice.step)
        neighbours = self._standing(near)
        if self.refill is not None:
            neighbours.pop(self.refill.name)
        touched, grazed = self._touched(option)
        return PlannedSkill(
            option.path,
            f"to {brick}",
            f"pick {brick}",
            held,
            self._at_rest(robot, item, start, neighbours) | touched,
            grazed,
            self.refill,
        )

    def _place(self, option: ResolvedSkill) -> PlannedSkill:
        path = option.path
        goal = self.world.goal(self.choice.step)[1].pose
        others = self._standing_near(resting_room(self.work))
        touched, grazed = self._touched(option)
        below = " from below" if self.work.up else ""
        return PlannedSkill(
            path,
            f"{self.brick} to its place",
            f"place {self.brick}{below}",
            goal,
            self._at_rest(path.robot, self.work, goal, others) | touched,
            grazed,
        )

    def _support(self, option: ResolvedSkill, choice: int) -> PlannedSupport:
        path, support = option.path, self.work.supports[choice]
        bricks = self._standing_near(supported_span(support))
        bricks[self.brick] = self.work
        pressed = support_contacts(path.robot, support, bricks)
        touched, grazed = self._touched(option)
        words = f"support step {self.choice.step}"
        skill = PlannedSkill(path, "to its support", words, None, touched, grazed)
        return PlannedSupport(
            skill,
            None,
            "back from its support",
            pressed,
            # What the placing robot brings touches the standing tool as well.
            pressed & grip_contact(path.robot, self.brick),
            straight=False,
        )

    def _at_rest(
        self, robot: str, at: OnGrid, pose: Transform, others: Bricks
    ) -> Pairs:
        """Return the contacts of the brick where it is picked or placed."""
        item = PlacedBrick(self.brick, at.brick, at.cell)
        press, fixtures = press_from_number(self.choice.grasp), self.world.cell.fixtures
        return resting_contacts(robot, item, pose, press, others, fixtures)

    def _touched(self, option: ResolvedSkill) -> tuple[Pairs, Pairs]:
        """Return the present bricks that the tool leans on or grazes in a skill."""
        tool = entity_name(option.path.robot, "tool")
        later = self.world.goal_numbers
        found = {True: NOTHING, False: NOTHING}
        for known, leans in option.touched.items():
            if later.get(known, 0) < self.choice.step:
                found[leans] |= contacts_with(tool, self._standing({known: self.work}))
        return found[True], found[False]

    def _standing(self, near: Bricks) -> dict[str, OnGrid]:
        """Return bricks of stock and earlier goals by their names once the brick has been picked."""
        stations, numbers = self.world.stations, self.world.goal_numbers
        out: dict[str, OnGrid] = {}
        for name, brick in near.items():
            if name in stations:
                out[copy_name(name, self._next[name])] = brick
            elif name in numbers:
                out[self._taken[numbers[name] - 1]] = brick
            elif name not in self._taken:
                out[name] = brick
        return out

    def _standing_near(self, span: GridSpan) -> dict[str, OnGrid]:
        """Return the bricks near a block above the plate when the brick has been picked."""
        return self._standing(self.world.bricks_near(span, self.choice.step))

    def _flange(self, robot: str, q: Array) -> Transform:
        return frame_pose(self.world.cell.robot(robot), q)


def _option(found: ResolvedSkill | Obstruction) -> ResolvedSkill:
    assert isinstance(found, ResolvedSkill), found
    return found
