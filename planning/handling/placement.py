"""Placement of an object as one assembly step: its planned skills and their tasks (APEX-MR IV-A).

Each kind of assembly supplies the skills, their paths and allowed contacts. Dependencies between tasks, waits
between robots, and contacts of carried objects are determined here for all kinds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import CellObject
from planning.handling.handovers import Handover
from planning.handling.skill_contacts import NOTHING
from planning.steps.skill import Pairs, SkillPath
from planning.steps.step_writer import StepWriter
from planning.tasks.refill import Refill
from planning.tasks.task import TaskKind
from planning.transforms import Transform


@dataclass(frozen=True)
class PlannedSkill:
    """A skill of a step.

    Attributes:
        path: in joint space, with the goals of the transits before it.
        coming: what those transits are, for people.
        words: what the skill is, for people.
        pose: of the object once it has changed hands, in the flange frame of who holds it then, or
            in the world; None where nothing changes hands.
        allowed: allowed contacts in it, besides the tool and what it handles.
        grazed: allowed contacts no deeper than the contact tolerance.
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
        by_home: whether the receiver continues via HOME.
    """

    handover: Handover
    pose: Transform
    by_home: bool = False


@dataclass(frozen=True)
class PlannedSupport:
    """Support, or hold, by another robot while the work of a step is done.

    Attributes:
        skill: at the end of which it stands there.
        item: the held object, None where it only presses against something.
        leaving: description of its retreat.
        touched: allowed contacts from the skill to the end of the retreat.
        brought: allowed contacts as the work is done.
        straight: whether the retreat is one straight motion, and not a transit a waypoint.
    """

    skill: PlannedSkill
    item: str | None
    leaving: str
    touched: Pairs
    brought: Pairs = NOTHING
    straight: bool = True


@dataclass(frozen=True)
class PlannedPlacement:
    """A planned step in which an object is placed.

    Attributes:
        item: name of the object.
        pick: its pick.
        between: how it changes hands on its way: how it is laid down and picked again, or
            handed over; None if it does not.
        place: how it is put in its place.
        support: what another robot does meanwhile, None for nothing.
        support_late: whether that one comes when the object is at its place already.
        kept: whether the robot that placed it stays, and keeps holding it.
    """

    item: str
    pick: PlannedSkill
    between: tuple[PlannedSkill, PlannedSkill] | PlannedHandover | None
    place: PlannedSkill
    support: PlannedSupport | None = None
    support_late: bool = False
    kept: bool = False


def write_placement(build: StepWriter, step: PlannedPlacement) -> int:
    """Write the tasks of a placement step; return the place.

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
    """Write the approach and the support, or hold, of a robot; return the skill."""
    skill = support.skill
    build.lead_in(skill.path, skill.coming)
    return _write_skill(build, support.item, skill)


def write_release(
    build: StepWriter, support: PlannedSupport, held: int, begun: int, done: int
) -> None:
    """Write the retreat of the supporting robot.

    Args:
        build: of the step.
        support: what is done.
        held: its task.
        begun, done: the first and the last task of the work that it is for.
    """
    path = support.skill.path
    waypoints = path.waypoints[-2::-1]
    if support.straight:
        straight = SkillPath(TaskKind.STRAIGHT, path.robot, path.path[-1:], waypoints)
        back = [build.skill(straight, support.leaving, support.item, lets_go=True)]
    else:
        back = [build.transit(path.robot, q, support.leaving) for q in waypoints]
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
    """Write transit, pick and the return HOME; return the pick."""
    robot = pick.path.robot
    build.lead_in(pick.path, pick.coming)
    picked = _write_skill(build, item, pick, robot)
    build.home(robot, item)
    return picked


def _write_put(build: StepWriter, item: str, taken: int, put: PlannedSkill) -> int:
    """Write the placement of an object picked in an earlier task; return the skill."""
    done = _write_skill(build, item, put)
    build.allow_carried(put.path.robot, item, taken, done)
    return done


def _write_handover(
    build: StepWriter, item: str, picked: int, handover: PlannedHandover
) -> int:
    """Write the handover of a picked object; return how the receiver takes it away."""
    found, meeting = handover.handover, handover.handover.meeting
    giver, receiver = meeting.giver.name, meeting.receiver.name
    retreats = not np.array_equal(meeting.rest, meeting.giver.home)
    build.transit(receiver, found.pre, "to the handover")
    ready = build.transit(receiver, found.receive, "ready to receive")
    if retreats:
        build.transit(giver, meeting.rest, f"{item} to the handover", item)
    build.lead_in(found.give, f"{item} to {receiver}", item)
    given = build.skill(found.give, f"hand over {item}", item, receiver, handover.pose)
    build.depend(ready, given)
    # The receiver stands at the end of its task "ready" while the object is brought.
    build.allow_carried(giver, item, picked, given, ready)
    if retreats:
        build.transit(giver, meeting.rest, "back from the handover")
    build.home(giver)
    taken = build.transit(receiver, found.pre, f"take {item}", item)
    build.depend(given, taken)
    build.allow_carried(receiver, item, taken, taken, ready, given)
    if handover.by_home:
        build.home(receiver, item)
    return taken
