"""Relays: transfers of a part between robots, or between grips, if no robot can do a step directly.

A part is laid on the upper face of a fixture, with any of its sides down, at a free place that is not its goal.
Another robot picks it up from there, or the same robot picks it up with another grip (regrasping). Places near
both robots are tried first. A handover in the air is planned only if there is no place to lay the part down.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, permutations, product

import numpy as np

from planning.cell.workcell import (
    Attachment,
    Fixture,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.contacts.touching import nearby_entities, standing_fixtures
from planning.grips.closing_fingers import finger_obstacles
from planning.grips.fingers import firm_grips
from planning.grips.grip import Grip
from planning.grips.tool_grips import explain_overload, robot_grips
from planning.handling.handovers import Handover, MeetingPlace, find_handover
from planning.handling.skill_contacts import grip_contact
from planning.handling.skill_targets import Subgoal
from planning.handling.tool_changes import mounted_tool, with_each_tool
from planning.kinematics.kinematics import frame_pose, inverse_kinematics
from planning.parts.part_skills import PartSkills, SkillTry, handover_targets, held_pose
from planning.parts.part_steps import PartStep
from planning.steps.skill import Obstruction, SkillPath, joint_distance
from planning.tasks.assignment import NO_TOOLS, Tools
from planning.transforms import (
    Array,
    Transform,
    inverse,
    read_only_copy,
    rotation,
    translation,
)

_SPACING = 0.1
"""Distance of the spots that are tried on a fixture [m]."""

_MOST_SPOTS, _FEW_SPOTS = 100, 12
"""Spots that are looked at, and those in reach of which all sides of a part are tried."""

_MOST_GRIPS = 12
"""Greatest number of picks, and of placements, per robot."""

_ENOUGH = 3
"""Number of feasible spots among which the cheapest is chosen."""

_CLEAR = 0.0005
"""A part comes to lie so far above a fixture [m]."""

_UPRIGHT = np.cos(np.radians(1.0))
_SIDES = (("x", 0), ("x", 1), ("x", 2), ("x", 3), ("y", 1), ("y", 3))
"""Quarter turns by which each side of a part comes to lie below."""

_PALM, _PALMS = 0.08, 0.1
"""Palms are so far behind the tips of tools, and at least so far from each other [m]."""

_MOST_PAIRS, _MOST_MEETINGS = 8, 48
"""Pairs of grips, and meetings with them, that are tried for each pair of robots."""

_MEETING_HEIGHTS = (0.4, 0.3, 0.5, 0.6)
"""Heights above the middle between two bases at which a part is handed over [m]."""


Skill = Callable[[PlacedRobot, PartStep, Transform], SkillTry]
"""Returns the pick or the place-down of a step by a robot and a grip."""


@dataclass(frozen=True)
class IntermediatePlace:
    """Intermediate pose of a part in a relay.

    Attributes:
        pose: pose of its centre in the world.
        touched: contacts there, with the distances [m].
    """

    pose: Transform
    touched: Mapping[str, float]


@dataclass(frozen=True)
class RelayEnd:
    """Pick of a part, or its place-down, at one end of a relay.

    Attributes:
        robot: the robot.
        grip: its grip on the part.
        tried: its pick where the part is at the start, or its place-down at the goal.
        path: the resulting path.
    """

    robot: PlacedRobot
    grip: Grip
    tried: SkillTry
    path: SkillPath

    @property
    def cost(self) -> float:
        """Joint distance from HOME [rad]."""
        return joint_distance(self.robot.home, self.path.contact)


@dataclass(frozen=True)
class Relay:
    """A candidate for a step in which the part changes hands in between.

    Attributes:
        give: the robot that picks the part, and lays it down or hands it over.
        take: the robot that receives and places it; may be the one that laid it down.
        between: the intermediate place, or the handover.
        passing: skills between the pick and the place.
        cost: joint distance of all from HOME [rad].
    """

    give: RelayEnd
    take: RelayEnd
    between: IntermediatePlace | Handover
    passing: tuple[SkillPath, ...]
    cost: float

    @property
    def paths(self) -> tuple[SkillPath, ...]:
        """All skills in order, from the pick to the place."""
        return self.give.path, *self.passing, self.take.path

    @property
    def robots(self) -> tuple[str, str]:
        """Names of the robots that pick the part and place it."""
        return self.give.robot.name, self.take.robot.name


def find_relays(
    cell: Workcell, skills_with: Callable[[Tools], PartSkills], step: PartStep
) -> list[tuple[Relay, Tools]]:
    """Return relays for a step, with any tools on the robots, and the tools needed.

    In the air it does so only where there is no place to lay it down in between.

    Args:
        cell: with robots as plans know them.
        skills_with: returns the skills of robots that have certain tools on them.
        step: that no robot can do alone.
    """
    chosen = list(product(*(list(with_each_tool([robot])) for robot in cell.robots)))
    every = [
        _Passing(skills_with(NO_TOOLS.union(*map(mounted_tool, robots))), step)
        for robots in chosen
    ]
    for find in (_Passing.intermediate_placements, _Passing.handed_over):
        found: list[tuple[Relay, Tools]] = []
        known: set[tuple[str, str, Tools]] = set()
        for robots, passing in zip(chosen, every, strict=True):
            new = set()
            for relay in sorted(find(passing), key=lambda relay: relay.cost):
                own = (mounted_tool(r) for r in robots if r.name in relay.robots)
                tools = NO_TOOLS.union(*own)
                if (*relay.robots, tools) not in known:
                    new.add((*relay.robots, tools))
                    found.append((relay, tools))
            known |= new
        if found:
            break
    return found


class _Passing:
    """Search for relays with given tools on the robots.

    Args:
        skills: of the robots.
        step: that no robot can do alone.
    """

    def __init__(self, skills: PartSkills, step: PartStep) -> None:
        self._skills, self._step = skills, step
        self._cell, self._assembly = skills.cell, skills.assembly
        self._handling = self._assembly.handling(step.part.name)
        self._picks = self._ends(skills.pick, step.part.start)
        self._places = self._ends(skills.place, step.place)

    def intermediate_placements(self) -> Iterator[Relay]:
        """Yield relays with the part laid down in between, one per place."""
        if not self._picks or not self._places:
            return
        count, step = 0, self._step
        for rest in self._rests():
            there = replace(step, place=rest.pose, touched=rest.touched)
            placed = replace(step.part, start=rest.pose)
            taken = replace(step, part=placed, at_start=rest.touched)
            laid = self._through(self._skills.place, there, rest, self._picks)
            if not laid:
                continue
            up = self._through(self._skills.pick, taken, rest, self._places)
            relays = [
                Relay(
                    give,
                    take,
                    rest,
                    (down.path, again.path),
                    give.cost + down.cost + again.cost + take.cost,
                )
                for (give, down), (take, again) in product(laid, up)
            ]
            if relays:
                count += 1
                yield min(relays, key=lambda relay: relay.cost)
            if count == _ENOUGH:
                return

    def handed_over(self) -> Iterator[Relay]:
        """Yield relays with a handover in the air, one per pair of robots.

        The giver brings the part into the receiver's open fingers, along the receiver's tool, and
        leaves along its own. They meet between their bases, at some heights.
        """
        for giver, receiver in permutations(self._cell.robots, 2):
            tries = islice(self._meetings(giver, receiver), _MOST_MEETINGS)
            relays = (self._handover(*meeting) for meeting in tries)
            yield from islice((relay for relay in relays if relay is not None), 1)

    def _ends(self, skill: Skill, at: Transform) -> list[RelayEnd]:
        """Return picks, or placements, of the part at its current place, a few per robot."""
        step, out = self._step, list[RelayEnd]()
        for robot in self._cell.robots:
            heavy = explain_overload(robot, step.part) is not None
            if heavy or not step.step.done_by(robot.name):
                continue
            count = 0
            found = robot_grips(robot, step.part.shape, at, at, self._handling.grips)
            frame, friction = self._assembly.frame, self._assembly.friction
            own = dict(enumerate(found))
            firm = firm_grips(robot, step.part, own, frame, (at,), friction)
            for grip in firm.values():
                if self._skills.misfit(robot, step.part, grip) is not None:
                    continue
                end = _end(skill, robot, step, grip)
                carried = self._skills.pick(robot, step, grip.pose)
                if end is None or carried.carried_home() is not None:
                    continue
                out.append(end)
                count += 1
                if count == _MOST_GRIPS:
                    break
        return out

    def _through(
        self,
        skill: Skill,
        step: PartStep,
        rest: IntermediatePlace,
        ends: Sequence[RelayEnd],
    ) -> list[tuple[RelayEnd, RelayEnd]]:
        """Return the ends whose robots also reach the intermediate place, one grip each."""
        robots = {end.robot.name: end.robot for end in ends}
        about = step.part.shape, rest.pose, rest.pose, self._handling.grips
        good = {
            (name, grip.pose.tobytes())
            for name, robot in robots.items()
            for grip in robot_grips(robot, *about)
        }
        out: dict[str, tuple[RelayEnd, RelayEnd]] = {}
        for end in ends:
            name = end.robot.name
            if name not in out and (name, end.grip.pose.tobytes()) in good:
                found = _end(skill, end.robot, step, end.grip)
                if found is not None:
                    out[name] = end, found
        return list(out.values())

    def _rests(self) -> Iterator[IntermediatePlace]:
        """Yield intermediate places of the part, nearest to the robots first."""
        step, part, touch = self._step, self._step.part, self._assembly.touch
        fixtures = standing_fixtures(self._cell)
        own = {"goal": (part, step.place), "start": (part, part.start)}
        # As far from the robots as what they reach already.
        rings = []
        for side, at in ((self._picks, part.start), (self._places, step.place)):
            base = np.mean([end.robot.base[:3, 3] for end in side], axis=0)
            rings.append((base, float(np.linalg.norm(at[:3, 3] - base))))

        def away(spot: Array) -> float:
            apart = (abs(float(np.linalg.norm(spot - c)) - r) for c, r in rings)
            return round(sum(apart), 6)

        every = (spot for fixture in self._cell.fixtures for spot in _spots(fixture))
        spots = sorted(every, key=away)[:_MOST_SPOTS]
        for spot in islice(filter(self._in_reach, spots), _FEW_SPOTS):
            for turn in _turns(step):
                low, _ = part.shape.bounds(turn)
                rest = turn.copy()
                rest[:3, 3] = spot
                rest[2, 3] += _CLEAR - low[2]
                touched = nearby_entities((part, rest), fixtures | step.others, touch)
                free = min(touched.values(), default=-1.0) >= 0.0
                if not free or not touched.keys() <= fixtures.keys():
                    continue
                if nearby_entities((part, rest), own, touch):
                    continue  # no step lies on where it comes from or goes
                yield IntermediatePlace(read_only_copy(rest), touched)

    def _in_reach(self, spot: Array) -> bool:
        """Tell whether a robot at either end reaches a spot with its tool pointing down."""
        tool = rotation("x", np.pi)
        tool[:3, 3] = spot
        tool[2, 3] += self._assembly.usual.approach
        return all(
            any(
                inverse_kinematics(
                    robot, self._assembly.frame, tool, robot.home, restarts=3
                )
                for robot in {end.robot.name: end.robot for end in ends}.values()
            )
            for ends in (self._picks, self._places)
        )

    def _stand(self, robot: PlacedRobot) -> Array:
        """Return the origin of a robot's base; below its hand at HOME where others have that base, shape (3,) [m]."""
        if not robot.mounted_on:
            return np.asarray(robot.base[:3, 3])
        hand = frame_pose(robot, robot.home, self._assembly.frame)[:3, 3]
        return np.asarray(hand - (0.0, 0.0, _MEETING_HEIGHTS[0]))

    def _meetings(
        self, giver: PlacedRobot, receiver: PlacedRobot
    ) -> Iterator[tuple[RelayEnd, RelayEnd, Transform]]:
        """Yield joint holds of a part by two robots, with its pose: hands far apart first.

        The giver points to the receiver, or down; the receiver to the giver, or down.
        """
        own = [end for end in self._picks if end.robot is giver]
        other = [end for end in self._places if end.robot is receiver]
        pairs = [pair for pair in product(own, other) if _apart(*pair) >= _PALMS]
        pairs.sort(key=lambda pair: -round(_apart(*pair), 6))
        first, last = self._stand(giver), self._stand(receiver)
        to = last - first
        middle = first + 0.5 * to
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
                yield give, take, read_only_copy(part)

    def _handover(self, give: RelayEnd, take: RelayEnd, at: Transform) -> Relay | None:
        """Return the handover of the part at a pose, None if it is blocked."""
        giver, receiver, frame = give.robot, take.robot, self._assembly.frame
        tool = at @ take.grip.pose
        back = tool @ translation(0.0, 0.0, -self._handling.approach)
        coming = -self._handling.approach * tool[:3, 2]
        meeting = MeetingPlace(
            giver,
            receiver,
            self._step.part,
            Attachment(giver.name, held_pose(giver, frame, give.grip.pose)),
            Attachment(receiver.name, held_pose(receiver, frame, take.grip.pose)),
            at,
            Subgoal("pre-receive", frame, back),
            Subgoal("receive", frame, tool),
            handover_targets(frame, at @ give.grip.pose, coming, self._handling.leave),
            giver.home,
        )
        found = find_handover(self._cell, self._step.around, meeting)
        if not isinstance(found, Handover) or self._fingers_blocked(give, take, found):
            return None
        cost = give.cost + take.cost + joint_distance(giver.home, found.give.contact)
        cost += joint_distance(receiver.home, found.receive)
        return Relay(give, take, found, (found.give,), cost)

    def _fingers_blocked(self, give: RelayEnd, take: RelayEnd, found: Handover) -> bool:
        """Tell whether fingers would hit anything as the part changes hands, such as the other's."""
        part, meeting = self._step.part, found.meeting
        hands = {
            give.robot.name: (give, found.give.contact, meeting.given),
            take.robot.name: (take, found.receive, meeting.taken),
        }
        at = {robot.name: robot.home for robot in self._cell.robots}
        at |= {name: q for name, (_, q, _) in hands.items()}
        allowed = frozenset[frozenset[str]]().union(
            *(grip_contact(name, part.name) for name in hands)
        )
        places = {name: place for name, (_, place) in self._step.around.items()}
        return any(
            finger_obstacles(
                end.robot,
                self._assembly.frame,
                (part, end.grip.pose),
                q,
                (self._cell, WorldState(at, {**places, part.name: hold}), allowed),
            )
            for end, q, hold in hands.values()
        )


def _end(
    skill: Skill, robot: PlacedRobot, step: PartStep, grip: Grip
) -> RelayEnd | None:
    """Return a robot's pick or placement of the part of a step by a grip, None if it cannot."""
    tried = skill(robot, step, grip.pose)
    found = tried.found()
    return (
        None if isinstance(found, Obstruction) else RelayEnd(robot, grip, tried, found)
    )


def _spots(fixture: Fixture) -> Iterator[Array]:
    """Yield spots on the upper face of an upright fixture [m]."""
    up = np.abs(fixture.pose[2, :3])
    axis = int(np.argmax(up))
    if up[axis] < _UPRIGHT:
        return
    flat = [k for k in range(3) if k != axis]
    counts = (int(0.5 * fixture.size[k] / _SPACING) for k in flat)
    for spot in product(*(np.arange(-n, n + 1) * _SPACING for n in counts)):
        inside = fixture.shape.middle.copy()
        inside[flat] += spot
        at = fixture.pose[:3, :3] @ inside + fixture.pose[:3, 3]
        at[2] += 0.5 * fixture.size[axis]
        yield at


def _turns(step: PartStep) -> Iterator[Transform]:
    """Yield orientations of a part at rest: as at the start, as in its place, then on each of its sides."""
    seen: set[bytes] = set()
    sides = (rotation(axis, quarter * np.pi / 2) for axis, quarter in _SIDES)
    for first in (step.part.start, step.place, *sides):
        placed = np.eye(4)
        placed[:3, :3] = first[:3, :3]
        if np.max(np.abs(placed[2, :3])) < _UPRIGHT:
            continue  # it would stand on an edge
        for quarter in range(4):
            turn = rotation("z", quarter * np.pi / 2) @ placed
            key = np.round(turn[:3, :3], 6).tobytes()
            if key not in seen:
                seen.add(key)
                yield turn


def _apart(give: RelayEnd, take: RelayEnd) -> float:
    """Return the distance of the palms of two hands on one part [m]."""
    palm = translation(0.0, 0.0, -_PALM)
    one, two = (end.grip.pose @ palm for end in (give, take))
    return float(np.linalg.norm(one[:3, 3] - two[:3, 3]))
