"""Audit of support tasks, in which a second robot holds the structure while the first one places a part.

During the whole placement, the second robot must be at rest with its tool at the structure.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from twin.audits.case import AuditCase, Violation
from twin.audits.grips import RIGHT, grip_mismatch
from twin.audits.motion.executed import Stay
from twin.audits.places import assign_objects_to_places
from twin.audits.worlds.world import FAR

SUPPORT = 0.003
"""A tool that holds against objects is no further away from one: studs, 1.7 mm high, are no part
of the boxes [m]."""

_SUPPORTS = ("support-bottom", "support-top")
_PLACES = ("place-down", "place-up")


def support_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield placements without their support, and handovers to moving robots.

    A step needs a support where the scenario says so, or where the plan has a support for it.
    While the node in which the object is put down lasts, one other robot must stand still with
    its tool at an object at rest. At a handover, one of the two must stand still while the node
    of the other lasts.
    """
    held = _held_objects(case)
    tools = {tool.name for tool in case.wanted.tools}
    for stay in case.handed():
        giver, taker = stay.giver, stay.holder
        if giver is None or giver not in case.robots or giver == taker:
            continue
        span = _node_span(case, giver, stay.t)
        if taker is not None and taker in case.robots:
            still = case.robots[taker].stands(*span)
            other = _node_span(case, taker, stay.t)
            if not still and not case.robots[giver].stands(*other):
                detail = f"{stay.object} changes hands while both move"
                yield Violation(stay.t, stay.t, giver, taker, 0.0, detail, "support")
        elif taker is None and stay.object in held:
            there = {k: s for k, s in case.at(stay.t).items() if k not in tools}
            hand = nearest_hand(case, span, giver, there)
            if hand.is_near:
                continue
            detail, gap = "nobody else stands still meanwhile", 0.0
            if hand.gap < FAR:
                gap = hand.gap
                detail = (
                    f"of those who stand still meanwhile, {hand.robot} is nearest to"
                )
                detail += f" an object, {gap * 1e3:.2f} mm away"
                detail += f", which {hand.loose}" if hand.loose else ""
            detail = f"is put down without its support: {detail}"
            yield Violation(*span, stay.object, hand.robot, gap, detail, "support")


def _held_objects(case: AuditCase) -> set[str]:
    """Return the objects that need a support when they are put down."""
    tasks, places = case.tpg.tasks, case.wanted.places
    steps = {task.step for task in tasks if task.kind in _SUPPORTS}
    planned = (t for t in tasks if t.kind in _PLACES and t.step in steps)
    out = {task.object for task in planned if task.object is not None}
    pairs = zip(
        places, assign_objects_to_places(case.cell, case.at(), places), strict=True
    )
    return out | {name for place, name in pairs if place.held and name is not None}


def _node_span(case: AuditCase, robot: str, t: float) -> tuple[float, float]:
    """Return the interval of motion of a robot's node at a time [s]."""
    rows, own = case.robots[robot], case.moved.get(robot)
    k = min(int(np.searchsorted(rows.t, t - 1e-9)), len(rows.t) - 1)
    node = int(rows.node[k])
    if own is None or not 0 <= node < len(own.begin) or np.isinf(own.begin[node]):
        return float(rows.t[k]), float(rows.t[k])
    return float(own.begin[node]), float(own.end[node])


@dataclass(frozen=True)
class NearestHand:
    """Nearest tool to some objects, among robots at rest.

    Attributes:
        robot: its robot; ``"nobody"`` if no robot is at rest.
        gap: how far it is from the nearest of them; ``FAR`` where there is none [m].
        closing: by how much its fingers close on that [m].
        loose: fault of its hold; empty for a valid or unknown one.
    """

    robot: str = "nobody"
    gap: float = FAR
    closing: float = 0.0
    loose: str = ""

    @property
    def before(self) -> tuple[bool, float]:
        """Sort key: a valid hold first, then the nearest."""
        return not self.is_near, self.gap - self.closing

    @property
    def is_near(self) -> bool:
        """Whether it holds the object."""
        return self.gap <= SUPPORT + self.closing and not self.loose


def nearest_hand(
    case: AuditCase,
    span: tuple[float, float],
    besides: str,
    there: Mapping[str, Stay],
) -> NearestHand:
    """Return the nearest tool to objects at rest, among robots at rest for some time.

    Fingers that stand open close on the thinnest edge. Pads and cups must hold an object as they do
    one that they carry: who does comes before who is nearer.

    Args:
        case: the execution.
        span: from when to when the robot stands still [s].
        besides: a robot that does not count.
        there: where the objects are that count where they are at rest.
    """
    found = NearestHand()
    resting = {name: stay.pose for name, stay in there.items() if stay.holder is None}
    for robot, rows in case.robots.items():
        if robot == besides or not rows.stands(*span):
            continue
        hand = case.hand(robot, span[0])
        flange, loose = case.flange(robot, span[0]), dict[str, str]()
        for shape in case.world.objects:
            pose = resting.get(shape.entity)
            if pose is None:
                continue
            case.world.place(shape, shape.at(pose))
            gap = min(case.world.distance(part, shape, FAR) for part in hand.shapes)
            closes = hand.closes_by(shape)
            if gap <= SUPPORT + closes and shape.entity not in loose:
                about = hand, robot, flange, shape.entity, pose
                _, loose[shape.entity] = grip_mismatch(case, *about) or RIGHT
            other = NearestHand(robot, gap, closes, loose.get(shape.entity, ""))
            if other.before < found.before:
                found = other
    return found
