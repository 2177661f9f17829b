"""Checks of reach: parts, places of work and racks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

from planning.cell.workcell import CellObject, PlacedRobot
from planning.errors import InfeasibleStepError
from planning.grips.grip import Grip
from planning.grips.tool_grips import robot_grips
from planning.handling.skill_targets import SkillTargets, is_possible_in_some_posture
from planning.handling.tool_changes import find_tool_changes
from planning.parts.assembly import PartHandling, PlacePart
from planning.parts.part_skills import pick_targets, place_targets, process_targets
from planning.parts.part_steps import steps_in_order
from planning.transforms import Transform
from twin.checks.finding import (
    CheckContext,
    Finding,
    Findings,
    format_position,
)
from twin.checks.reach import (
    distance_from_first_joint,
    idle_robot,
    is_beyond_reach,
    reach_bound,
)
from twin.document.yaml_text import KeyPath
from twin.kinds.parts.ordered_parts import OrderedParts

_MOST_GRIPS = 40
"""Grips of a part that are tried by each robot."""

Targets = Callable[[Transform], SkillTargets]
"""Returns the tool poses of approach to a grip and departure from it."""


def _beyond(robots: list[PlacedRobot], frame: str, target: Transform) -> str:
    """Return the distance of the nearest robot, where no arm is long enough for a pose."""
    if not all(is_beyond_reach(robot, frame, target) for robot in robots):
        return ""
    distances = {
        robot.name: distance_from_first_joint(robot, target) for robot in robots
    }
    nearest = min(robots, key=lambda r: distances[r.name] - reach_bound(r, frame))
    return (
        f"; {nearest.name}, the nearest, is {distances[nearest.name]:.2f} m away, and with its tool"
        f" {reach_bound(nearest, frame):.2f} m long"
    )


def check_part_reach(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield unreachable poses: an error where planning would fail, too."""
    yield from _check_racks(subject, parts)
    yield from _check_parts(subject, parts)


def _check_racks(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield the first rack at which a tool cannot be changed, by the planner."""
    cell, goals = subject.built, parts.listed.goals
    try:
        find_tool_changes(cell, goals)
    except InfeasibleStepError as error:
        yield Finding(subject.thing_at(error.thing, "rack"), error.message, error=True)


def _check_parts(subject: CheckContext, parts: OrderedParts) -> Findings:
    assembly, cell = parts.listed, subject.cell
    robots = [
        robot
        for robot in cell.robots
        if assembly.frame in {"flange", *robot.model.frames}
    ]
    if isinstance(parts.found, str):
        return  # said elsewhere
    yield from _check_works(subject, parts)
    if len(robots) < len(cell.robots):
        return  # said elsewhere: a robot has no such frame
    legs = list(_legs(subject, parts))
    for leg in legs:
        found = list(_check_leg(leg, robots, assembly.frame))
        group = next((own for own in assembly.alike if leg.part.name in own), ())
        if found and group:
            from_others = [replace(leg, part=cell.object(name)) for name in group]
            to_others = [
                replace(other, part=leg.part)
                for other in legs
                if other.part.name in group
            ]
            distances = [from_others]
            if len(group) == len(to_others):  # else it may stay where it is
                distances.append(to_others)
            if all(
                any(not list(_check_leg(own, robots, assembly.frame)) for own in others)
                for others in distances
            ):
                continue
        yield from found
    for robot in cell.robots:
        if not _serves(robot, legs, parts):
            yield idle_robot(subject, robot, len(assembly.steps))


def _serves(robot: PlacedRobot, legs: list[_PartLeg], parts: OrderedParts) -> bool:
    """Return whether a robot can take part in a step: in moving a part, or in a process."""
    frame = parts.listed.frame
    for leg in legs:
        shape, start, end = leg.part.shape, leg.part.start, leg.end
        distances, held = leg.handling, leg.step.hold
        if held is not None and not is_beyond_reach(
            robot, frame, parts.listed.goals[held]
        ):
            return True
        for at, targets in ((start, pick_targets), (end, place_targets)):
            grips = robot_grips(robot, shape, at, at, distances.grips)
            own = {robot.name: grips}
            if leg.step.done_by(robot.name) and _reaching(
                [robot], frame, at, own, partial(targets, frame, handling=distances)
            ):
                return True
    return any(
        is_possible_in_some_posture(
            robot, process_targets(process, known.place, turn).targets
        )
        for _, known, step, robots in parts.works()
        if robot in robots
        for process in (step.process,)
        for turn in process.turns
    )


def _check_leg(leg: _PartLeg, everybody: list[PlacedRobot], frame: str) -> Findings:
    part, name, end, distances = leg.part, leg.part.name, leg.end, leg.handling
    robots = [robot for robot in everybody if leg.step.done_by(robot.name)]
    nobody = "no robot"
    if leg.step.robots is not None:
        nobody = f"no robot that may do it ({', '.join(leg.step.robots)})"
    pick = partial(pick_targets, frame, handling=distances)
    place = partial(place_targets, frame, handling=distances)
    if any(
        _reaches(robot, frame, part.start @ grip.pose, pick)
        and _reaches(robot, frame, end @ grip.pose, place)
        for robot in robots
        for grip in robot_grips(robot, part.shape, part.start, end, distances.grips)[
            :_MOST_GRIPS
        ]
    ):
        return
    at_start, at_goal = (
        {
            r.name: robot_grips(r, part.shape, pose, pose, distances.grips)
            for r in robots
        }
        for pose in (part.start, end)
    )
    if not any(at_start.values()) or not any(at_goal.values()):
        return  # said elsewhere
    tried = max(len(g) for g in (*at_start.values(), *at_goal.values()))
    picks = _reaching(robots, frame, part.start, at_start, pick)
    places = _reaching(robots, frame, end, at_goal, place)
    if picks and places:
        yield Finding(
            leg.start_at,
            f"{nobody} picks and places {name} with one grip: {_list(picks)} where it lies,"
            f" {_list(places)} {leg.words}; the planner looks for a place to lay it down in"
            " between",
            code="one grip",
            parts=(name,),
        )
        return
    key, at, words = leg.start_at, part.start, "where it lies"
    if picks:
        key, at, words = leg.end_at, end, leg.words
    yield Finding(
        key,
        f"{nobody} reaches {name}: {words}, at {format_position(at[:3, 3].tolist())}; tried"
        f" {min(tried, _MOST_GRIPS)} grips, with approach_m {distances.approach:g} and leave_m"
        f" {distances.leave:g}{_beyond(robots, frame, at)}",
        error=tried <= _MOST_GRIPS,
        code="reach",
        parts=(name,),
        figures=tuple(at[:3, 3].tolist()),
    )


@dataclass(frozen=True)
class _PartLeg:
    """Leg of a part from its current place to its goal or an intermediate place.

    Attributes:
        step: in which it is brought there.
        part: at its ``start``, which is where this leg begins.
        end: pose of its frame where it is put.
        handling: its handling: grips and insertion.
        start_at, end_at: paths in the file.
        words: text on the end.
    """

    step: PlacePart
    part: CellObject
    end: Transform
    handling: PartHandling
    start_at: KeyPath
    end_at: KeyPath
    words: str


def _legs(subject: CheckContext, parts: OrderedParts) -> Iterator[_PartLeg]:
    """Yield the legs of all parts, in the order of the steps."""
    assembly, known = parts.listed, dict[str, KeyPath]()
    for number, step, where, end in steps_in_order(subject.cell, assembly):
        if not isinstance(step, PlacePart):
            continue
        name = step.part
        start_at = known.get(name, subject.thing_at(name, "start"))
        end_at, words = subject.thing_at(name, "goal"), "its place"
        if step.stop is not None:
            end_at, words = parts.step_at(number, "at"), step.stop.words
        known[name] = end_at
        part = replace(subject.cell.object(name), start=where[name])
        yield _PartLeg(
            step, part, end, assembly.handling(name), start_at, end_at, words
        )


def _check_works(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield places of work unreachable for all allowed robots."""
    for number, found, step, robots in parts.works():
        process = step.process
        if any(
            is_possible_in_some_posture(
                robot, process_targets(process, found.place, turn).targets
            )
            for robot in robots
            for turn in process.turns
        ):
            continue
        who = ", ".join(robot.name for robot in robots)
        yield Finding(
            parts.step_at(number),
            f"no robot reaches {step.spot.words}, at {format_position(found.place[:3, 3].tolist())}, with frame"
            f" {process.frame!r} and approach_m {process.approach:g}: tried {who or 'no robot'} in"
            f" {len(process.turns)} turns",
            error=True,
            code="reach",
            parts=(step.spot.owner or "",),
            figures=tuple(found.place[:3, 3].tolist()),
        )


def _reaching(
    robots: list[PlacedRobot],
    frame: str,
    at: Transform,
    grips: Mapping[str, list[Grip]],
    targets: Targets,
) -> set[str]:
    """Return the robots that can pick or place a part at a pose with one of some grips."""
    return {
        robot.name
        for robot in robots
        if any(
            _reaches(robot, frame, at @ grip.pose, targets)
            for grip in grips[robot.name][:_MOST_GRIPS]
        )
    }


def _reaches(robot: PlacedRobot, frame: str, grip: Transform, targets: Targets) -> bool:
    """Return whether a robot can pick or place with its tool at a pose."""
    if is_beyond_reach(robot, frame, grip):
        return False
    return is_possible_in_some_posture(robot, targets(grip))


def _list(names: set[str]) -> str:
    return ", ".join(sorted(names)) or "nobody"
