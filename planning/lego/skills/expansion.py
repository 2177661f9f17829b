"""From choices to tasks: the sequence of transits and skills of every step (APEX-MR IV-A)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

from planning.cell.workcell import CellObject
from planning.geometry.robot_bodies import entity
from planning.kinematics.kinematics import frame_pose
from planning.lego.bricks.assembly import BrickType, Cell
from planning.lego.bricks.brick_world import BrickWorld, press_of
from planning.lego.bricks.grid import Span, box_from_top
from planning.lego.bricks.objects import copy_name, next_copy, object_names, source_of
from planning.lego.skills.allowed_contacts import (
    Bricks,
    contacts_at_rest,
    room_at_rest,
    supporting,
)
from planning.lego.skills.candidates import LegoCandidates
from planning.lego.skills.handovers import HandoverOption
from planning.lego.skills.options import SkillOption
from planning.lego.skills.targets import supported_span
from planning.steps.skill import Obstruction, SkillPath, gripped, touching
from planning.steps.step_writer import StepBuilder
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import StepTasks, Task
from planning.tasks.work import AssemblyWork
from planning.transforms import Array, Transform, inverse

PLACES = ("place-down", "place-up")
SUPPORTS = ("support-bottom", "support-top")


def lego_work(candidates: LegoCandidates) -> AssemblyWork:
    """Return the assembly work of LEGO candidates, for assignment and motion planning."""
    return AssemblyWork(
        candidates.problem,
        partial(_expand_step, candidates),
        partial(_waits, candidates),
        candidates.world.assembly,
    )


def _expand_step(
    candidates: LegoCandidates, plan: TaskPlan, step: int, first_index: int
) -> StepTasks:
    """Return the tasks of a step as the plan chooses it.

    Every transit ends at the configuration that the next skill starts from, or at HOME, where
    robots stop between pick and place and at the end of their part.
    The plan must have the choices of the earlier steps, whose bricks stand around.
    """
    expander = _Expander(candidates, plan, StepBuilder(step, first_index))
    if candidates.world.step(step).up:
        expander.place_up()
    else:
        expander.place_down()
    return expander.builder.build()


def _waits(
    candidates: LegoCandidates, steps: Sequence[StepTasks]
) -> Iterator[tuple[Task, Task]]:
    """Yield what waits for what between steps.

    A place waits for the place before it, and so does a support; a brick of the stock is picked
    after those that stood on it, a station's after the one before it.
    """
    world = candidates.world
    last_place: Task | None = None
    picked: dict[str, Task] = {}
    for step in steps:
        place: Task | None = None
        for task in step.tasks:
            if task.kind in PLACES:
                place = task
            if task.kind in (*PLACES, *SUPPORTS) and last_place is not None:
                yield last_place, task
            if task.kind == "pick" and task.object is not None:
                source = source_of(task.object, world.stations)
                for name in {*world.above(source), source} & picked.keys():
                    yield picked[name], task
                picked[source] = task
        last_place = place or last_place


class _Expander:
    """Writes the tasks of one step into a builder."""

    def __init__(
        self, candidates: LegoCandidates, plan: TaskPlan, builder: StepBuilder
    ) -> None:
        self.skills, self.handovers = candidates.skills, candidates.handovers
        self.world: BrickWorld = candidates.world
        self.choice = plan[builder.step]
        self.builder = builder
        self.work = self.world.step(builder.step)
        source, stations = self.choice.object, self.world.stations
        sources = [c.object for c in plan.choices if c.step <= builder.step]
        *self._used, self.brick = object_names(sources, stations)
        self._picked = Counter(sources)
        self.refill: CellObject | None = None
        if source in stations:
            item = self.world.stock_at_rest[source][0]
            self.refill = next_copy(item, source, self._picked[source] + 1)

    def _standing(
        self, near: Mapping[str, tuple[Cell, BrickType]]
    ) -> dict[str, tuple[Cell, BrickType]]:
        """Return bricks by what they are called and where they are when the brick has been picked.

        Args:
            near: some bricks of the stock, and of the goals of earlier steps.
        """
        stations, numbers = self.world.stations, self.world.goal_numbers
        out = {}
        for name, brick in near.items():
            if name in stations:
                out[copy_name(name, self._picked[name] + 1)] = brick
            elif name in numbers:
                out[self._used[numbers[name] - 1]] = brick
            elif name not in self._picked:
                out[name] = brick
        return out

    def _standing_near(self, span: Span) -> dict[str, tuple[Cell, BrickType]]:
        """Return the bricks near some room above the plate when the brick has been picked."""
        return self._standing(self.world.cells_near(span, self.builder.step))

    def place_down(self) -> None:
        """Write pick, the support if any, place, and the ways back."""
        build, robot = self.builder, self.choice.robot
        place, support = self._cooperation()
        picked = self._pick(robot)
        held = 0 if support is None else self._support(support)
        build.lead_in(place.path, f"{self.brick} to its place", self.brick)
        placed = self._place(place, f"place {self.brick}")
        carrying = build.of_robot(robot, picked, placed)
        build.allow(gripped(robot, self.brick), *carrying)
        self._home(robot)
        if support is not None:
            self._retract(support.path, held, placed)

    def place_up(self) -> None:
        """Write pick, handover, support from above, place from below, and the ways back."""
        build, receiver = self.builder, self.choice.robot
        giver = self.choice.primary.partner
        place, support = self._cooperation()
        assert giver is not None
        assert support is not None
        step, grasp = self.choice.step, self.choice.grasp
        handover = self.handovers.handover(giver, receiver, step, grasp)
        assert isinstance(handover, HandoverOption), handover
        picked = self._pick(giver)
        build.transit(receiver, handover.pre_receive, "to the handover", None)
        ready = build.transit(receiver, handover.receive, "ready to receive", None)
        build.transit(giver, handover.rest, f"{self.brick} to the handover", self.brick)
        build.lead_in(handover.give, f"{self.brick} to {receiver}", self.brick)
        box = box_from_top(handover.top, self.work.brick)
        in_hand = inverse(self._flange(receiver, handover.receive)) @ box
        given = build.skill(
            handover.give, f"hand over {self.brick}", self.brick, receiver, in_hand
        )
        build.depend(ready, given)
        # The receiver stands at the end of its task "ready" while the brick is pressed on.
        carrying = build.of_robot(giver, picked, given)
        build.allow(gripped(giver, self.brick), *carrying, ready)
        build.transit(giver, handover.rest, "back from the handover", None)
        self._home(giver)
        taken = build.transit(
            receiver, handover.pre_receive, f"take {self.brick}", self.brick
        )
        build.depend(given, taken)
        build.lead_in(place.path, f"{self.brick} to its place", self.brick)
        held = self._support(support)
        placed = self._place(place, f"place {self.brick} from below")
        carrying = build.of_robot(receiver, taken, placed)
        build.allow(gripped(receiver, self.brick), ready, given, *carrying)
        self._home(receiver)
        self._retract(support.path, held, placed)

    def _cooperation(self) -> tuple[SkillOption, SkillOption | None]:
        """Return the place beside the support, and the support if there is one."""
        robot, step, grasp = self.choice.robot, self.choice.step, self.choice.grasp
        by = self.choice.support
        if by is None:
            return _option(self.skills.place(robot, step, grasp, None)), None
        place = _option(self.skills.place(robot, step, grasp, by))
        return place, _option(self.skills.support(by.robot, step, by.pose))

    def _pick(self, robot: str) -> int:
        """Write transit, pick and the way HOME; return the pick."""
        build, brick = self.builder, self.brick
        option = _option(self.skills.pick(robot, self.choice.object, self.choice.grasp))
        path = option.path
        build.lead_in(path, f"to {brick}", None)
        start = self.world.stock_at_rest[self.choice.object][1].pose
        held = inverse(self._flange(robot, path.contact)) @ start
        picked = build.skill(path, f"pick {brick}", brick, robot, held, self.refill)
        cell = self.world.stock[self.choice.object].cell
        near = self.world.cells_near_stock(self.choice.object, build.step)
        beside = self._standing(near)
        if self.refill is not None:
            beside.pop(self.refill.name)
        self._allow_at_rest(picked, robot, cell, start, beside)
        self._allow_touched(picked, option)
        self._home(robot, brick)
        return picked

    def _place(self, option: SkillOption, label: str) -> int:
        """Write the place itself; return it."""
        goal, path = self.world.goal(self.choice.step)[1].pose, option.path
        placed = self.builder.skill(path, label, self.brick, None, goal)
        cell = self.work.cell
        others = self._standing_near(room_at_rest(cell, self.work.brick))
        self._allow_at_rest(placed, path.robot, cell, goal, others)
        self._allow_touched(placed, option)
        return placed

    def _allow_at_rest(
        self, task: int, robot: str, cell: Cell, pose: Transform, others: Bricks
    ) -> None:
        """Allow the contacts of the brick where it is picked or placed."""
        seat, fixtures = (cell, self.work.brick, pose), self.world.cell.fixtures
        press = press_of(self.choice.grasp)
        pairs = contacts_at_rest(robot, self.brick, seat, press, others, fixtures)
        self.builder.allow(pairs, task)

    def _allow_touched(self, task: int, option: SkillOption) -> None:
        """Allow what the tool grazes or leans on in a skill, as far as it is there by then."""
        build, tool = self.builder, entity(option.path.robot, "tool")
        later, brick = self.world.goal_numbers, (self.work.cell, self.work.brick)
        for known, leans in option.touched.items():
            if later.get(known, 0) < build.step:
                allow = build.allow if leans else build.graze
                allow(touching(tool, self._standing({known: brick})), task)

    def _support(self, option: SkillOption) -> int:
        """Write transit and support; return the support."""
        self.builder.lead_in(option.path, "to its support", None)
        label = f"support step {self.choice.step}"
        held = self.builder.skill(option.path, label, None)
        self._allow_touched(held, option)
        return held

    def _retract(self, path: SkillPath, held: int, placed: int) -> None:
        """Write the supporting robot's way back, once the brick is placed."""
        build, robot = self.builder, path.robot
        ways_back = [
            build.transit(robot, q, "back from its support", None)
            for q in path.waypoints[-2::-1]
        ]
        build.depend(held, placed)
        build.depend(placed, ways_back[0])
        self._home(robot)
        assert self.choice.support is not None
        support = self.work.supports[self.choice.support.pose]
        bricks = self._standing_near(supported_span(support))
        bricks[self.brick] = self.work.cell, self.work.brick
        touched = supporting(robot, support, bricks)
        build.allow(touched, held, *ways_back)
        # What the placing robot brings touches the standing tool as well.
        build.allow(touched & gripped(robot, self.brick), placed)

    def _home(self, robot: str, carries: str | None = None) -> int:
        label = f"HOME with {carries}" if carries else "HOME"
        home = self.world.cell.robot(robot).home
        return self.builder.transit(robot, home, label, carries)

    def _flange(self, robot: str, q: Array) -> Transform:
        return frame_pose(self.world.cell.robot(robot), q)


def _option(found: SkillOption | Obstruction) -> SkillOption:
    assert isinstance(found, SkillOption), found
    return found
