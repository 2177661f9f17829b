"""Writes the tasks of one step one after another.

A step in which an object is put somewhere: as a plan does it, and as tasks (APEX-MR IV-A).

A kind of assembly says which skills along which paths these are, and what may touch in them. What comes
after what, who waits for whom, and who touches what it carries is the same for all.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.steps.handovers import Handover
from planning.steps.skill import NOTHING, Pairs, SkillPath, handled
from planning.tasks.task import (
    ARRIVE,
    CLOSE,
    HOLD,
    OPEN,
    PRESENT,
    STILL,
    STRAIGHT,
    TRANSIT,
    Actuation,
    AllowedContact,
    Handling,
    StepTasks,
    Task,
)
from planning.tasks.work import Refill
from planning.transforms import Array, Transform, readonly


@dataclass
class StepWriter:
    """Appends tasks and remembers what depends on what and what may touch what.

    Attributes:
        cell: robots with the tools on them that they have in the step.
        step: assembly step, counted from 1.
        first: index of the first task.
        actuated: whether it takes its time to close and to open a tool; else that is a part of skills.
    """

    cell: Workcell
    step: int
    first: int
    actuated: bool = False
    _tasks: list[Task] = field(default_factory=list)
    _dependencies: list[tuple[int, int]] = field(default_factory=list)
    _allowed: dict[tuple[bool, str, str], set[int]] = field(
        default_factory=lambda: defaultdict(set)
    )
    _objects: list[CellObject] = field(default_factory=list)

    def transit(
        self,
        robot: str,
        to: Array,
        label: str,
        carries: str | None = None,
        *,
        goal: bool = False,
    ) -> int:
        """Append a transit and return its index; with ``goal`` it may not be cut short."""
        path = np.atleast_2d(to)
        return self._append(robot, TRANSIT, label, path, (), carries, goal=goal)

    def home(self, robot: str, carries: str | None = None) -> int:
        """Append the transit of a robot to HOME, with what it carries."""
        label = f"HOME with {carries}" if carries else "HOME"
        return self.transit(robot, self.cell.robot(robot).home, label, carries)

    def stand(self, robot: PlacedRobot, label: str, handling: Handling) -> int:
        """Append a task in which something changes hands and the robot stays at HOME."""
        path = robot.home[None]
        return self._append(robot.name, TRANSIT, label, path, (handling,))

    def skill(
        self,
        path: SkillPath,
        label: str,
        item: str | None,
        holder: str | None = None,
        pose: Transform | None = None,
        refill: CellObject | None = None,
        *,
        lets_go: bool = False,
    ) -> int:
        """Append a skill and return its index.

        Where tools are actuated, the configuration in which one closes or opens comes once more for
        each time that it does, and what changes hands then does so when that is over.

        Args:
            path: in joint space.
            label: for people.
            item: the object it is about.
            holder: who holds it once it has changed hands, None when it is put down.
            pose: of the object then; None for skills in which nothing changes hands.
            refill: object that comes up where it first is, at the end of the skill.
            lets_go: whether its robot lets go of something before it moves.
        """
        at, acts = self._acts(path, holder, lets_go=lets_go)
        # The path counts from its start, which the task's own leaves out.
        still = np.repeat(path.waypoints[at : at + 1], len(acts), axis=0)
        way = np.vstack([path.path[:at], still, path.path[at:]])
        change_at = None if path.change_at is None else path.change_at + len(acts)
        handlings: tuple[Handling, ...] = ()
        if pose is not None and item is not None and change_at is not None:
            change = Handling(item, change_at, holder, readonly(pose))
            handlings = (change,)
        if refill is not None:
            coming = Handling(refill.name, len(way), None, refill.start)
            handlings = (*handlings, coming)
            self._objects.append(refill)
        actuations = tuple(
            Actuation(at + k, act, robot, self.cell.robot(robot).tool)
            for k, (act, robot) in enumerate(acts, start=1)
        )
        robot, kind = path.robot, path.skill
        return self._append(
            robot, kind, label, way, handlings, item, actuations=actuations
        )

    def _acts(
        self, path: SkillPath, holder: str | None, *, lets_go: bool
    ) -> tuple[int, tuple[tuple[str, str], ...]]:
        """Return the waypoint of a skill at which tools close or open, and which do what in turn."""
        own, last = path.robot, len(path.path)
        at = last if path.change_at is None else path.change_at
        if not self.actuated:
            return at, ()
        if lets_go:
            return 0, ((OPEN, own),)
        if path.skill in ("pick", HOLD):
            return at, ((CLOSE, own),)
        if path.skill == "handover":
            assert holder is not None
            return at, ((CLOSE, holder), (OPEN, own))
        # Who stays where it put something down keeps hold of it.
        opens = path.skill == "place-down" and at < last
        return at, ((OPEN, own),) if opens else ()

    def unmoved(
        self,
        machine: str,
        kind: str,
        label: str,
        item: str | None,
        handlings: tuple[Handling, ...] = (),
    ) -> int:
        """Append a task of a machine, at an object if any, and return its index."""
        return self._append(machine, kind, label, STILL, handlings, item)

    def refill(self, refill: Refill, emptied: int) -> None:
        """Append how machines bring what comes up once a task has emptied its source."""
        name = refill.parts[0][0]
        if refill.arrivals is not None:
            come = self.unmoved(refill.arrivals, ARRIVE, f"{name} arrives", name)
            self.depend(come, come + 1)
        up = tuple(Handling(part, 1, None, pose) for part, pose in refill.parts)
        there = self.unmoved(refill.machine, PRESENT, f"{name} comes up", name, up)
        self.depend(emptied, there)

    def lead_in(self, path: SkillPath, label: str, carries: str | None = None) -> None:
        """Append the transits to where a skill starts."""
        for goal in path.lead:
            self.transit(path.robot, goal, label, carries)

    def depend(self, before: int, after: int) -> None:
        """Let one task wait for another."""
        self._dependencies.append((before, after))

    def allow(self, pairs: Pairs, *tasks: int, grazing: bool = False) -> None:
        """Allow contacts during some tasks, if grazing no deeper than the contact tolerance."""
        for pair in pairs:
            first, second = sorted(pair)
            self._allowed[grazing, first, second].update(tasks)

    @property
    def tasks(self) -> tuple[Task, ...]:
        """The tasks so far."""
        return tuple(self._tasks)

    def allow_carried(
        self, robot: str, item: str, first: int, last: int, *also: int
    ) -> None:
        """Let a robot's tool touch what it carries from one of its tasks to another.

        Args:
            robot: who carries it.
            item: the object.
            first, last: its first and last task with it.
            also: tasks of others in which they touch.
        """
        own = [
            task.index
            for task in self._tasks
            if task.robot == robot and first <= task.index <= last
        ]
        self.allow(handled(self.cell.robot(robot), item), *own, *also)

    def build(self) -> StepTasks:
        """Return the step."""
        allowed = (
            AllowedContact(first, second, frozenset(tasks), grazing)
            for (grazing, first, second), tasks in sorted(self._allowed.items())
        )
        return StepTasks(
            self.step,
            tuple(self._tasks),
            tuple(sorted(self._dependencies)),
            tuple(allowed),
            tuple(self._objects),
        )

    def _append(
        self,
        robot: str,
        kind: str,
        label: str,
        path: Array,
        handlings: tuple[Handling, ...] = (),
        item: str | None = None,
        *,
        goal: bool = False,
        actuations: tuple[Actuation, ...] = (),
    ) -> int:
        index, way = self.first + len(self._tasks), readonly(path)
        about = index, robot, kind, self.step, label, way, handlings, item, goal
        self._tasks.append(Task(*about, actuations))
        return index


@dataclass(frozen=True)
class PlannedSkill:
    """A skill of a step.

    Attributes:
        path: in joint space, with the goals of the transits before it.
        coming: what those transits are, for people.
        words: what the skill is, for people.
        pose: of the object once it has changed hands, in the flange frame of who holds it then, or
            in the world; None where nothing changes hands.
        allowed: who may touch whom in it, besides the tool and what it handles.
        grazed: who may touch whom no deeper than the contact tolerance.
        refill: what comes up where the other one was picked: an object at once, or what machines
            bring; None for nothing.
    """

    path: SkillPath
    coming: str
    words: str
    pose: Transform | None = None
    allowed: Pairs = NOTHING
    grazed: Pairs = NOTHING
    refill: CellObject | Refill | None = None


@dataclass(frozen=True)
class PlannedHandover:
    """A handover of a step.

    Attributes:
        handover: postures of the two robots, and the skill of the giver.
        pose: of the object in the flange frame of the receiver.
        by_home: whether the receiver goes on by way of HOME.
    """

    handover: Handover
    pose: Transform
    by_home: bool = False


@dataclass(frozen=True)
class PlannedSupport:
    """What another robot supports, or holds, while the work of a step is done.

    Attributes:
        skill: at the end of which it stands there.
        item: what it holds, None where it only presses against something.
        leaving: what its way back is, for people.
        touched: who may touch whom from the skill to the end of the way back.
        brought: who may touch whom as the work is done.
        straight: whether the way back is one straight motion, and not a transit a waypoint.
    """

    skill: PlannedSkill
    item: str | None
    leaving: str
    touched: Pairs
    brought: Pairs = NOTHING
    straight: bool = True


@dataclass(frozen=True)
class PlannedPlacement:
    """A step in which an object is put somewhere, as a plan does it.

    Attributes:
        item: name of the object.
        pick: how it is taken up first.
        between: how it changes hands on its way: how it is laid down and taken up again, or
            handed over; None if it does not.
        place: how it is put in its place.
        support: what another robot does meanwhile, None for nothing.
        support_late: whether that one comes when the object is at its place already.
        kept: whether the robot that placed it stays, and keeps hold of it.
    """

    item: str
    pick: PlannedSkill
    between: tuple[PlannedSkill, PlannedSkill] | PlannedHandover | None
    place: PlannedSkill
    support: PlannedSupport | None = None
    support_late: bool = False
    kept: bool = False


def write_placement(build: StepWriter, step: PlannedPlacement) -> int:
    """Write the tasks of a step in which an object is put somewhere; return the place.

    Every transit ends at the configuration that the next skill starts from, or at HOME, where
    robots stop between pick and place and at the end of their part.
    """
    item, place, between = step.item, step.place, step.between
    taken = _write_pick(build, item, step.pick)
    if isinstance(between, PlannedHandover):
        taken = _write_handover(build, item, taken, between)
    elif between is not None:
        down, up = between
        build.lead_in(down.path, down.coming, item)
        laid = _write_put(build, item, taken, down)
        build.home(down.path.robot)
        taken = _write_pick(build, item, up)
        build.depend(laid, taken)
    held = 0
    if step.support is not None and not step.support_late:
        held = write_support(build, step.support)
    build.lead_in(place.path, place.coming, item)
    if step.support is not None and step.support_late:
        held = write_support(build, step.support)
    placed = _write_put(build, item, taken, place)
    if not step.kept:
        build.home(place.path.robot)
    if step.support is not None:
        write_release(build, step.support, held, placed, placed)
    return placed


def write_support(build: StepWriter, support: PlannedSupport) -> int:
    """Write how a robot comes to support or hold something; return the skill."""
    skill = support.skill
    build.lead_in(skill.path, skill.coming)
    return _write_skill(build, support.item, skill)


def write_release(
    build: StepWriter, support: PlannedSupport, held: int, begun: int, done: int
) -> None:
    """Write the way back of who supports.

    Args:
        build: of the step.
        support: what is done.
        held: its task.
        begun, done: the first and the last task of the work that it is for.
    """
    path = support.skill.path
    way = path.waypoints[-2::-1]
    if support.straight:
        straight = SkillPath(STRAIGHT, path.robot, path.path[-1:], way)
        back = [build.skill(straight, support.leaving, support.item, lets_go=True)]
    else:
        back = [build.transit(path.robot, q, support.leaving) for q in way]
    build.home(path.robot)
    build.depend(held, begun)
    build.depend(done, back[0])
    build.allow(support.touched, held, *back)
    build.allow(support.brought, done)


def _write_skill(
    build: StepWriter, item: str | None, skill: PlannedSkill, holder: str | None = None
) -> int:
    more = skill.refill
    at_once = more if isinstance(more, CellObject) else None
    done = build.skill(skill.path, skill.words, item, holder, skill.pose, at_once)
    build.allow(skill.allowed, done)
    build.allow(skill.grazed, done, grazing=True)
    if isinstance(more, Refill):
        build.refill(more, done)
    return done


def _write_pick(build: StepWriter, item: str, pick: PlannedSkill) -> int:
    """Write transit, pick and the way HOME; return the pick."""
    robot = pick.path.robot
    build.lead_in(pick.path, pick.coming)
    picked = _write_skill(build, item, pick, robot)
    build.home(robot, item)
    return picked


def _write_put(build: StepWriter, item: str, taken: int, put: PlannedSkill) -> int:
    """Write how an object is put down that was taken in an earlier task; return the skill."""
    done = _write_skill(build, item, put)
    build.allow_carried(put.path.robot, item, taken, done)
    return done


def _write_handover(
    build: StepWriter, item: str, picked: int, way: PlannedHandover
) -> int:
    """Write how a picked object is handed over; return how the receiver takes it away."""
    found, meeting = way.handover, way.handover.meeting
    giver, receiver = meeting.giver.name, meeting.receiver.name
    aside = not np.array_equal(meeting.rest, meeting.giver.home)
    build.transit(receiver, found.pre, "to the handover")
    ready = build.transit(receiver, found.receive, "ready to receive")
    if aside:
        build.transit(giver, meeting.rest, f"{item} to the handover", item)
    build.lead_in(found.give, f"{item} to {receiver}", item)
    given = build.skill(found.give, f"hand over {item}", item, receiver, way.pose)
    build.depend(ready, given)
    # The receiver stands at the end of its task "ready" while the object is brought.
    build.allow_carried(giver, item, picked, given, ready)
    if aside:
        build.transit(giver, meeting.rest, "back from the handover")
    build.home(giver)
    taken = build.transit(receiver, found.pre, f"take {item}", item)
    build.depend(given, taken)
    build.allow_carried(receiver, item, taken, taken, ready, given)
    if way.by_home:
        build.home(receiver, item)
    return taken
