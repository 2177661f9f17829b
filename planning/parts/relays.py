"""Parts that change hands on their way, where nobody can do a step alone: laid down, or in the air.

A part is laid on any of its sides on the upper face of a fixture, where nothing else is and its own
place is not. The robot that takes it up from there may be the one that laid it down, with another
grip: regrasping. Places near to both robots are tried first. In the air a part changes hands only
where there is no place to lay it down.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, permutations, product

import numpy as np

from planning.cell.workcell import Attachment, Fixture, PlacedRobot, Workcell
from planning.contacts.precedence import near_to, standing
from planning.kinematics.kinematics import inverse_kinematics
from planning.parts.assembly import Grip, PartAssembly
from planning.parts.part_skills import PartSkills, handover_targets, held_pose
from planning.parts.part_steps import PartStep
from planning.parts.tool_grips import overload, robot_grips
from planning.steps.handovers import Handover, MeetingPlace, find_handover
from planning.steps.skill import Obstruction, SkillPath, Subgoal, joint_distance
from planning.steps.tool_changes import mounted_tool, with_each_tool
from planning.tasks.assignment import NO_TOOLS, Tools
from planning.transforms import (
    Array,
    Transform,
    inverse,
    readonly,
    rotation,
    translation,
)

_SPACING = 0.1
"""Distance of the spots that are tried on a fixture [m]."""

_MOST_SPOTS, _FEW_SPOTS = 100, 12
"""Spots that are looked at, and those in reach of which all sides of a part are tried."""

_MOST_GRIPS = 12
"""Ways of each robot to pick the part, and to place it, that are found at most."""

_ENOUGH = 3
"""Spots with a way over them, among which the cheapest is taken."""

_CLEAR = 0.0005
"""A part comes to lie so far above a fixture [m]."""

_UPRIGHT = np.cos(np.radians(1.0))


_PALM, _PALMS = 0.08, 0.1
"""Palms are so far behind the tips of tools, and at least so far from each other [m]."""

_MOST_PAIRS, _MOST_MEETINGS = 8, 48
"""Pairs of grips, and meetings with them, that are tried for each pair of robots."""

_MEETING_HEIGHTS = (0.4, 0.3, 0.5, 0.6)
"""Heights above the middle between two bases at which a part is handed over [m]."""


@dataclass(frozen=True)
class LaidDown:
    """Where a part lies in between.

    Attributes:
        pose: of its centre in the world.
        touched: what it touches there, with the distances [m].
    """

    pose: Transform
    touched: Mapping[str, float]


@dataclass(frozen=True)
class Relay:
    """A way to do a step in which the part changes hands in between.

    Attributes:
        giver: who picks the part, and lays it down or hands it over.
        receiver: who takes it up or is handed it, and places it; may be who laid it down.
        give, take: grips of the two.
        between: where it is laid down, or how it is handed over.
        paths: all skills in their order, from the pick to the place.
        cost: joint distance of all from HOME.
    """

    giver: str
    receiver: str
    give: Grip
    take: Grip
    between: LaidDown | Handover
    paths: tuple[SkillPath, ...]
    cost: float


@dataclass(frozen=True)
class End:
    """Pick of a part by a robot, or its place-down, at one end of the part's way.

    Attributes:
        robot: who does it.
        grip: how it holds the part.
        path: its pick where the part is at the start, or its place-down at the goal.
        cost: joint distance from HOME.
    """

    robot: PlacedRobot
    grip: Grip
    path: SkillPath
    cost: float


def find_relays(
    cell: Workcell, skills_with: Callable[[Tools], PartSkills], step: PartStep
) -> list[tuple[Relay, Tools]]:
    """Return ways in which a part changes hands, with any tools on the robots, and the tools needed.

    In the air it does so only where there is no place to lay it down in between.

    Args:
        cell: with robots as plans know them.
        skills_with: returns the skills of robots that have certain tools on them.
        step: that no robot can do alone.
    """
    choices = [list(with_each_tool([robot])) for robot in cell.robots]
    for find in (_laid_down, _handed_over):
        found: list[tuple[Relay, Tools]] = []
        known: set[tuple[str, str, Tools]] = set()
        for chosen in product(*choices):
            new = set()
            for way in find(
                skills_with(NO_TOOLS.union(*map(mounted_tool, chosen))), step
            ):
                pair = way.giver, way.receiver
                tools = NO_TOOLS.union(
                    *(mounted_tool(r) for r in chosen if r.name in pair)
                )
                if (*pair, tools) not in known:
                    new.add((*pair, tools))
                    found.append((way, tools))
            known |= new
        if found:
            break
    return found


def _laid_down(skills: PartSkills, step: PartStep) -> list[Relay]:
    """Return ways to do a step with the part laid down in between, the cheapest of each pair first.

    Args:
        skills: of the robots.
        step: that no robot can do alone.
    """
    picks, places = _find_ends(skills, step)
    if not picks or not places:
        return []
    found: list[Relay] = []
    for rest in _rests(skills.cell, skills.assembly, step, (picks, places)):
        there = replace(step, goal=rest.pose, at_goal=rest.touched)
        lying = replace(step.part, start=rest.pose)
        taken = replace(step, part=lying, at_start=rest.touched)
        laid = _through(skills, there, picks, pick=False)
        if not laid:
            continue
        up = _through(skills, taken, places, pick=True)
        ways = [_over(rest, *pair) for pair in product(laid, up)]
        if ways:
            found.append(min(ways, key=lambda way: way.cost))
        if len(found) == _ENOUGH:
            break
    return sorted(found, key=lambda way: way.cost)


def _over(
    rest: LaidDown,
    first: tuple[End, SkillPath, float],
    then: tuple[End, SkillPath, float],
) -> Relay:
    (give, down, down_cost), (take, up, up_cost) = first, then
    return Relay(
        give.robot.name,
        take.robot.name,
        give.grip,
        take.grip,
        rest,
        (give.path, down, up, take.path),
        give.cost + down_cost + up_cost + take.cost,
    )


def _find_ends(skills: PartSkills, step: PartStep) -> tuple[list[End], list[End]]:
    """Return how robots can pick the part of a step, and how they can place it, some ways each."""
    return _ends(skills, step, pick=True), _ends(skills, step, pick=False)


def _ends(skills: PartSkills, step: PartStep, *, pick: bool) -> list[End]:
    at = step.part.start if pick else step.goal
    out = []
    rules = skills.assembly.handling(step.part.name).grips
    for robot in skills.cell.robots:
        if not step.step.done_by(robot.name) or overload(robot, step.part) is not None:
            continue
        count = 0
        for grip in robot_grips(robot, step.part.shape, at, at, rules):
            if skills.misfit(robot, step.part, grip) is not None:
                continue
            way = skills.pick if pick else skills.place
            path = way(robot, step, grip.pose)
            if isinstance(path, Obstruction):
                continue
            if skills.carried_home(robot, step, grip.pose) is not None:
                continue
            cost = joint_distance(robot.home, path.contact)
            out.append(End(robot, grip, path, cost))
            count += 1
            if count == _MOST_GRIPS:
                break
    return out


def _through(
    skills: PartSkills,
    step: PartStep,
    ends: Sequence[End],
    *,
    pick: bool,
) -> list[tuple[End, SkillPath, float]]:
    """Return the ends whose robots also reach the part where it is laid down, one way each."""
    rest = step.part.start if pick else step.goal
    rules = skills.assembly.handling(step.part.name).grips
    robots = {end.robot.name: end.robot for end in ends}
    good = {
        (name, grip.pose.tobytes())
        for name, robot in robots.items()
        for grip in robot_grips(robot, step.part.shape, rest, rest, rules)
    }
    out = []
    reached: set[str] = set()
    for end in ends:
        way_there = end.robot.name, end.grip.pose.tobytes()
        if end.robot.name in reached or way_there not in good:
            continue
        way = skills.pick if pick else skills.place
        path = way(end.robot, step, end.grip.pose)
        if not isinstance(path, Obstruction):
            reached.add(end.robot.name)
            cost = joint_distance(end.robot.home, path.contact)
            out.append((end, path, cost))
    return out


def _rests(
    cell: Workcell,
    assembly: PartAssembly,
    step: PartStep,
    ends: tuple[Sequence[End], Sequence[End]],
) -> Iterator[LaidDown]:
    """Yield where a part can lie in between, nearest to the robots first."""
    lying = standing(cell) | {
        name: (item, at.pose) for name, (item, at) in step.around.items()
    }
    own = {"goal": (step.part, step.goal), "start": (step.part, step.part.start)}
    # As far from the robots as what they reach already.
    rings = []
    for side, at in zip(ends, (step.part.start, step.goal), strict=True):
        base = np.mean([end.robot.base[:3, 3] for end in side], axis=0)
        rings.append((base, float(np.linalg.norm(at[:3, 3] - base))))

    def away(spot: Array) -> float:
        return round(sum(abs(float(np.linalg.norm(spot - c)) - r) for c, r in rings), 6)

    spots = sorted((s for fixture in cell.fixtures for s in _spots(fixture)), key=away)
    near = (spot for spot in spots[:_MOST_SPOTS] if _in_reach(spot, assembly, ends))
    for spot in islice(near, _FEW_SPOTS):
        for turn in _turns(step):
            low, _ = step.part.shape.bounds(turn)
            rest = turn.copy()
            rest[:3, 3] = spot
            rest[2, 3] += _CLEAR - low[2]
            touched = near_to((step.part, rest), lying, assembly.touch)
            fixtures = {fixture.name for fixture in cell.fixtures}
            free = min(touched.values(), default=-1.0) >= 0.0
            if not free or not touched.keys() <= fixtures:
                continue
            if near_to((step.part, rest), own, assembly.touch):
                continue  # no step lies on where it comes from or goes
            yield LaidDown(readonly(rest), touched)


def _in_reach(
    spot: Array, assembly: PartAssembly, ends: tuple[Sequence[End], Sequence[End]]
) -> bool:
    """Tell whether a robot of either side reaches above a spot with its tool down."""
    tool = rotation("x", np.pi)
    tool[:3, 3] = spot
    tool[2, 3] += assembly.approach
    return all(
        any(
            inverse_kinematics(
                robot, assembly.grips.frame, tool, robot.home, restarts=3
            )
            for robot in {end.robot.name: end.robot for end in side}.values()
        )
        for side in ends
    )


def _spots(fixture: Fixture) -> Iterator[Array]:
    """Yield spots on the upper face of a fixture that stands upright [m]."""
    up = np.abs(fixture.pose[2, :3])
    axis = int(np.argmax(up))
    if up[axis] < _UPRIGHT:
        return
    flat = [k for k in range(3) if k != axis]
    sides = [
        np.arange(-(n := int(0.5 * fixture.size[k] / _SPACING)), n + 1) * _SPACING
        for k in flat
    ]
    for a, b in product(*sides):
        inside = fixture.shape.middle.copy()
        inside[flat] += a, b
        at = fixture.pose[:3, :3] @ inside + fixture.pose[:3, 3]
        at[2] += 0.5 * fixture.size[axis]
        yield at


def _turns(step: PartStep) -> Iterator[Transform]:
    """Yield how a part can lie: as at the start, as in its place, then on each of its sides."""
    seen: set[bytes] = set()
    for first in (step.part.start, step.goal, *_sides()):
        lying = np.eye(4)
        lying[:3, :3] = first[:3, :3]
        if np.max(np.abs(lying[2, :3])) < _UPRIGHT:
            continue  # it would stand on an edge
        for quarter in range(4):
            turn = rotation("z", quarter * np.pi / 2) @ lying
            key = np.round(turn[:3, :3], 6).tobytes()
            if key not in seen:
                seen.add(key)
                yield turn


def _sides() -> Iterator[Transform]:
    for axis, quarter in (("x", 0), ("x", 1), ("x", 2), ("x", 3), ("y", 1), ("y", 3)):
        yield rotation(axis, quarter * np.pi / 2)


def _handed_over(skills: PartSkills, step: PartStep) -> list[Relay]:
    """Return ways to do a step in which one robot hands the part over, the cheapest first.

    The giver brings the part into the receiver's open fingers, along the receiver's tool, and
    leaves along its own. They meet between their bases, at some heights.

    Args:
        skills: of the robots.
        step: that no robot can do alone.
    """
    picks, places = _find_ends(skills, step)
    found: list[Relay] = []
    for giver, receiver in permutations(skills.cell.robots, 2):
        tries = islice(_meetings(picks, places, giver, receiver), _MOST_MEETINGS)
        ways = (_handover(skills, step, *meeting) for meeting in tries)
        found += islice((way for way in ways if way is not None), 1)
    return sorted(found, key=lambda way: way.cost)


def _meetings(
    picks: Sequence[End],
    places: Sequence[End],
    giver: PlacedRobot,
    receiver: PlacedRobot,
) -> Iterator[tuple[End, End, Transform]]:
    """Yield how two robots hold a part between them, and its pose: hands far apart come first.

    The giver points to the receiver, or down; the receiver to the giver, or down.
    """
    own = [end for end in picks if end.robot is giver]
    other = [end for end in places if end.robot is receiver]
    pairs = [pair for pair in product(own, other) if _apart(*pair) >= _PALMS]
    pairs.sort(key=lambda pair: -round(_apart(*pair), 6))
    to = receiver.base[:3, 3] - giver.base[:3, 3]
    middle = giver.base[:3, 3] + 0.5 * to
    bearing = float(np.arctan2(to[1], to[0]))
    level = rotation("z", bearing) @ rotation("y", np.pi / 2)
    down = rotation("z", bearing) @ rotation("x", np.pi)
    for height, pointing, (give, take), quarter in product(
        _MEETING_HEIGHTS, (level, down), pairs[:_MOST_PAIRS], range(4)
    ):
        tool = pointing @ rotation("z", quarter * np.pi / 2)
        part = tool @ inverse(give.grip.pose)
        part[:3, 3] = middle
        part[2, 3] += height
        facing = (part @ take.grip.pose)[:3, 2]
        if facing @ level[:3, 2] < -0.5 or facing[2] < -0.8:
            yield give, take, readonly(part)


def _apart(give: End, take: End) -> float:
    """Return how far the palms of two hands on one part are from each other [m]."""
    palm = translation(0.0, 0.0, -_PALM)
    one, two = (end.grip.pose @ palm for end in (give, take))
    return float(np.linalg.norm(one[:3, 3] - two[:3, 3]))


def _handover(
    skills: PartSkills, step: PartStep, give: End, take: End, at: Transform
) -> Relay | None:
    """Return how a part is handed over at a pose, None if something is in the way."""
    part, frame = step.part, skills.assembly.grips.frame
    giver, receiver = give.robot, take.robot
    ways = skills.assembly.handling(part.name)
    tool = at @ take.grip.pose
    back = tool @ translation(0.0, 0.0, -ways.approach)
    coming = -ways.approach * tool[:3, 2]
    meeting = MeetingPlace(
        giver,
        receiver,
        part,
        Attachment(giver.name, held_pose(giver, frame, give.grip.pose)),
        Attachment(receiver.name, held_pose(receiver, frame, take.grip.pose)),
        at,
        Subgoal("pre-receive", frame, back),
        Subgoal("receive", frame, tool),
        handover_targets(frame, at @ give.grip.pose, coming, ways.leave),
        giver.home,
    )
    found = find_handover(skills.cell, step.around, meeting)
    if not isinstance(found, Handover):
        return None
    cost = give.cost + take.cost + joint_distance(giver.home, found.give.contact)
    return Relay(
        giver.name,
        receiver.name,
        give.grip,
        take.grip,
        found,
        (give.path, found.give, take.path),
        cost + joint_distance(receiver.home, found.receive),
    )
