"""Parts handed over in the air, where no robot can do a step alone and there is no place to lie."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, permutations, product

import numpy as np

from planning.cell.workcell import Attachment, PlacedRobot, Workcell
from planning.parts.assembly import Grip
from planning.parts.part_skills import PartSkills, handover_targets, held_pose
from planning.parts.part_steps import PartStep
from planning.parts.relays import End, Relay, find_ends, find_relays
from planning.steps.handovers import ready_postures, receiver_clash
from planning.steps.skill import (
    NOTHING,
    Obstruction,
    SkillContacts,
    SkillPath,
    Subgoal,
    gripped,
    joint_distance,
)
from planning.steps.skill_scene import SkillScene, resolve_skill
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

_PALM, _PALMS = 0.08, 0.1
"""Palms are so far behind the tips of tools, and at least so far from each other [m]."""

_MOST_PAIRS, _MOST_MEETINGS = 8, 48
"""Pairs of grips, and meetings with them, that are tried for each pair of robots."""

_HEIGHTS = (0.4, 0.3, 0.5, 0.6)
"""Heights above the middle between two bases at which a part is handed over [m]."""


@dataclass(frozen=True)
class Handover:
    """A way to do a step in which one robot hands the part over to another in the air.

    Attributes:
        giver: who picks the part.
        receiver: who takes it in its fingers, which stand open, and places it.
        give, take: grips of the two.
        pre: where the receiver comes from and goes to with the part, shape (n,).
        receive: where it stands while it is given the part, shape (n,).
        paths: pick and handover of the giver, place of the receiver.
        cost: joint distance of all from HOME.
    """

    giver: str
    receiver: str
    give: Grip
    take: Grip
    pre: Array
    receive: Array
    paths: tuple[SkillPath, SkillPath, SkillPath]
    cost: float


def find_ways_by_others(
    cell: Workcell, skills_with: Callable[[Tools], PartSkills], step: PartStep
) -> list[tuple[Relay | Handover, Tools]]:
    """Return ways in which a part changes hands, with any tools on the robots, and the tools needed.

    In the air it does so only where there is no place to lay it down in between.

    Args:
        cell: with robots as plans know them.
        skills_with: returns the skills of robots that have certain tools on them.
        step: that no robot can do alone.
    """
    choices = [list(with_each_tool([robot])) for robot in cell.robots]
    for find in (find_relays, find_handovers):
        found: list[tuple[Relay | Handover, Tools]] = []
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


def find_handovers(skills: PartSkills, step: PartStep) -> list[Handover]:
    """Return ways to do a step in which one robot hands the part over, the cheapest first.

    The giver brings the part into the receiver's open fingers, along the receiver's tool, and
    leaves along its own. They meet between their bases, at some heights.

    Args:
        skills: of the robots.
        step: that no robot can do alone.
    """
    picks, places = find_ends(skills, step)
    found: list[Handover] = []
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
        _HEIGHTS, (level, down), pairs[:_MOST_PAIRS], range(4)
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
) -> Handover | None:
    """Return how a part is handed over at a pose, None if something is in the way."""
    name, frame = step.part.name, skills.assembly.grips.frame
    giver, receiver = give.robot, take.robot
    ways = skills.assembly.ways(name)
    approach, leave = ways.approach, ways.leave
    tool = at @ take.grip.pose
    back = Subgoal("pre-receive", frame, tool @ translation(0.0, 0.0, -approach))
    given = Attachment(giver.name, held_pose(giver, frame, give.grip.pose))
    taken = Attachment(receiver.name, held_pose(receiver, frame, take.grip.pose))
    held = gripped(receiver.name, name)
    home = {robot.name: robot.home for robot in skills.cell.robots}
    coming = -approach * tool[:3, 2]
    targets = handover_targets(frame, at @ give.grip.pose, coming, leave)
    for pre, receive in ready_postures(receiver, back, Subgoal("receive", frame, tool)):
        scene = SkillScene(
            skills.cell,
            {**step.around, name: (step.part, taken)},
            {**home, receiver.name: receive},
            SkillContacts(held, held, held),
            (name, taken),
        )
        if receiver_clash(scene, receiver, pre, giver, giver.home):
            continue
        grip = gripped(giver.name, name)
        scene = replace(
            scene,
            objects={**step.around, name: (step.part, given)},
            contacts=SkillContacts(grip, grip | held, NOTHING),
        )
        found = resolve_skill(giver, targets, scene)
        if isinstance(found, Obstruction):
            continue
        cost = give.cost + take.cost + joint_distance(giver.home, found.path.contact)
        return Handover(
            giver.name,
            receiver.name,
            give.grip,
            take.grip,
            pre,
            receive,
            (give.path, found.path, take.path),
            cost + joint_distance(receiver.home, receive),
        )
    return None
