"""Handovers between two robots in the air, whatever is handed over, where meetings are given.

Gathers the candidates of the integer program, whatever is built, and why others are none (APEX-MR App. B).
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from planning.cell.workcell import Attachment, CellObject, PlacedRobot, Workcell
from planning.kinematics.kinematics import inverse_kinematics
from planning.steps.skill import (
    LARGEST_TURN,
    NOTHING,
    Objects,
    Obstruction,
    SkillContacts,
    SkillPath,
    SkillScene,
    SkillTargets,
    Subgoal,
    gripped,
    joint_distance,
)
from planning.steps.skill_trial import find_obstruction, resolve_skill
from planning.tasks.assignment import (
    AssignmentProblem,
    PrimaryCandidate,
    Rejection,
    SupportCandidate,
)
from planning.transforms import Array, Transform


@dataclass(frozen=True)
class MeetingPlace:
    """A place in the air where one robot may hand an object over to another.

    Attributes:
        giver: who brings the object.
        receiver: who takes it.
        item: what is handed over.
        given: how the giver holds it.
        taken: how the receiver holds it then.
        at: pose of the object in the world as it changes hands.
        pre: where the tool of the receiver comes from, and goes to with the object.
        receive: where that tool is meanwhile.
        targets: what the giver does.
        rest: where the giver stands before and after, shape (n,).
    """

    giver: PlacedRobot
    receiver: PlacedRobot
    item: CellObject
    given: Attachment
    taken: Attachment
    at: Transform
    pre: Subgoal
    receive: Subgoal
    targets: SkillTargets
    rest: Array


@dataclass(frozen=True)
class Handover:
    """A handover that nothing is in the way of.

    Attributes:
        meeting: where the two robots meet.
        pre: where the receiver comes from and goes to with the object, shape (n,).
        receive: where it stands while it is given the object, shape (n,).
        give: the giver's skill.
    """

    meeting: MeetingPlace
    pre: Array
    receive: Array
    give: SkillPath


def find_handover(
    cell: Workcell, around: Objects, meeting: MeetingPlace
) -> Handover | Obstruction | None:
    """Return the handover at a meeting, in the receiver's first posture that is free.

    Args:
        cell: all robots but the two stand at HOME.
        around: all other objects.
        meeting: of the two.

    Returns:
        What is in the way in the first posture where none is free; None where the receiver has no
        posture at all.
    """
    giver, receiver, item = meeting.giver, meeting.receiver, meeting.item
    home = {robot.name: robot.home for robot in cell.robots}
    giving, taking = gripped(giver.name, item.name), gripped(receiver.name, item.name)
    reason: Obstruction | None = None
    for pre, receive in _ready_postures(receiver, meeting.pre, meeting.receive):
        scene = SkillScene(
            cell,
            {**around, item.name: (item, meeting.taken)},
            {**home, receiver.name: receive},
            SkillContacts(taking, taking, taking),
            (item.name, meeting.taken),
        )
        if clash := _receiver_clash(scene, meeting, pre):
            reason = reason or clash
            continue
        scene = replace(
            scene,
            objects={**around, item.name: (item, meeting.given)},
            contacts=SkillContacts(giving, giving | taking, NOTHING),
        )
        found = resolve_skill(giver, [meeting.targets], scene)
        if not isinstance(found, Obstruction):
            return Handover(meeting, pre, receive, found.path)
        reason = reason or found
    return reason


def _receiver_clash(
    scene: SkillScene, meeting: MeetingPlace, pre: Array
) -> Obstruction | None:
    """Return what the receiver touches on its way in, or out with the object.

    Args:
        scene: with the receiver where it receives and the object in its hand.
        meeting: of the two robots.
        pre: where the receiver comes from and goes to, shape (n,).
    """
    name, giver = meeting.receiver.name, meeting.giver.name
    receive = scene.configurations[name]
    coming = SkillPath("receive", name, pre[None], receive[None])
    empty = replace(
        scene,
        objects={k: v for k, v in scene.objects.items() if k != meeting.item.name},
        configurations={**scene.configurations, name: meeting.receiver.home},
        contacts=SkillContacts(NOTHING, NOTHING, NOTHING),
        handed=None,
    )
    if found := find_obstruction(coming, empty):
        return found
    leaving = SkillPath("receive", name, receive[None], pre[None])
    standing = {**empty.configurations, giver: meeting.rest}
    return find_obstruction(
        leaving, replace(scene, configurations=standing, handed=None)
    )


def _ready_postures(
    robot: PlacedRobot, pre: Subgoal, receive: Subgoal
) -> Iterator[tuple[Array, Array]]:
    """Yield the receiver's (pre, receive) postures, nearest to HOME first."""
    for start in inverse_kinematics(robot, pre.frame, pre.pose, robot.home):
        near = inverse_kinematics(robot, receive.frame, receive.pose, start, restarts=0)
        if near and np.abs(near[0] - start).max() <= LARGEST_TURN:
            yield start, near[0]


Found = TypeVar("Found")


class CandidateCollector:
    """Gathers the candidates of an assembly step by step.

    Attributes:
        home: HOME of each robot, shape (n,).
        primaries, supports: the candidates, in the order in which they were found.
        incompatible: pairs of their numbers that cannot go together.
        clashing: pairs of numbers of primaries of different steps that cannot go together.
        dropped: numbers of primaries that are not to be taken after all.
        rejections: what is not a candidate, and why.
        blockers: by step, how often things were in the way.
    """

    def __init__(self, robots: Iterable[PlacedRobot]) -> None:
        self.home = {robot.name: robot.home for robot in robots}
        self.primaries: list[PrimaryCandidate] = []
        self.supports: list[SupportCandidate] = []
        self.incompatible: set[tuple[int, int]] = set()
        self.clashing: set[tuple[int, int]] = set()
        self.dropped: set[int] = set()
        self.rejections: list[Rejection] = []
        self.blockers: dict[int, Counter[str]] = defaultdict(Counter)

    def cost(self, *paths: SkillPath) -> float:
        """Return the joint distance from HOME to where each of some skills touches what it is for."""
        return sum(joint_distance(self.home[p.robot], p.contact) for p in paths)

    def accept(
        self, step: int, what: str, found: Found | Obstruction, robot: str | None = None
    ) -> Found | None:
        """Return what was found, None for what is in the way, which is noted as a reason.

        Args:
            step: counted from 1.
            what: was tried, for people.
            found: for it.
            robot: who would do it; None for nobody in particular.
        """
        if not isinstance(found, Obstruction):
            return found
        self.reject(step, what, found, robot)
        return None

    def reject(
        self,
        step: int,
        what: str,
        reason: Obstruction | str,
        robot: str | None = None,
    ) -> None:
        """Note why something is no candidate, and count what was in the way."""
        if isinstance(reason, str):
            reason = Obstruction(reason)
        self.rejections.append(Rejection(step, what, reason.words, robot, reason.by))
        if reason.by is not None:
            self.blockers[step][reason.by] += 1

    def problem(
        self, steps: Sequence[str], needs_support: Sequence[bool], **more: Any
    ) -> AssignmentProblem:
        """Return the problem of what was gathered.

        Args:
            steps: what they are, in words.
            needs_support: whether each is done by two robots.
            more: further attributes of ``AssignmentProblem``.
        """
        left = [p for p in range(len(self.primaries)) if p not in self.dropped]
        number = {p: k for k, p in enumerate(left)}
        return AssignmentProblem(
            robots=tuple(self.home),
            steps=tuple(steps),
            needs_support=tuple(needs_support),
            primaries=tuple(self.primaries[p] for p in left),
            supports=tuple(self.supports),
            incompatible=frozenset(
                (number[p], s) for p, s in self.incompatible if p in number
            ),
            rejections=tuple(self.rejections),
            clashing=frozenset(
                (number[p], number[q])
                for p, q in self.clashing
                if {p, q} <= number.keys()
            ),
            **more,
        )
