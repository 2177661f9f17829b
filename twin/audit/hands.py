"""What robots hold is at their tools; tools that they change are on them or in their racks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from planning.cell.workcell import CellObject
from planning.transforms import Transform
from twin.audit.case import AuditCase, Hand
from twin.audit.motion.executed import Stay
from twin.audit.places import PLACED, distance_of
from twin.audit.violation import Violation
from twin.audit.wanted import ChangedTool
from twin.audit.worlds.world import FAR

GRIP = 0.005
"""What is held may be this far away from the closed tool of its holder [m]."""

_PLAY = 1e-4
"""A box may be wider than its fingers open by this: rounding of files [m]."""


def grip_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield what is held by who is not at it, or wider than fingers open.

    Every hold is measured once, when it begins: from then on tool and object move as one. Fingers
    that stand open in the geometry of a tool close by half of what is left of their opening beside
    the thinnest edge of the object.
    """
    tools = {tool.name for tool in case.wanted.tools}
    for stay in case.in_order:
        name, robot, t = stay.object, stay.holder, max(stay.t, 0.0)
        if robot is None or robot not in case.robots:
            continue
        if name in tools or stay.until <= t:
            continue
        hand = case.hand(robot, t)
        held = case.put(name, case.flange(robot, t) @ stay.pose)
        gap, tool = min(
            (case.world.distance(part, own, FAR), part.detail)
            for part in hand.shapes
            for own in held
        )
        closing = max(hand.closes_by(own) for own in held)
        width = _width(case.cell.object(name), hand, stay.pose)
        if width > hand.opening + _PLAY and hand.grip is not None:
            depth, detail = (
                width - hand.opening,
                f"is {width * 1e3:.2f} mm wide between",
            )
            detail += f" the fingers of {hand.grip.tool}, which open to"
            detail += f" {hand.opening * 1e3:.2f} mm"
        elif gap > GRIP + closing:
            depth, detail = gap, f"is held {gap * 1e3:.2f} mm away from {tool}"
            detail += f", which closes by {closing * 1e3:.2f} mm" if closing else ""
        else:
            continue
        yield Violation(
            t, min(stay.until, case.end), name, robot, depth, detail, "grip"
        )


def _width(item: CellObject, hand: Hand, held: Transform) -> float:
    """Return how wide a box is along the axis in which fingers close [m].

    Nothing where that cannot be told: without fingers, or of what is no box, which fingers may
    grip at any part.
    """
    tool, grip = hand.frames.get("tool"), hand.grip
    if grip is None or grip.opening is None or tool is None or not item.shape.is_box:
        return 0.0
    return float(np.abs(held[:3, :3].T @ tool[:3, 1]) @ item.size)


def tool_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield tools that are neither in their rack nor, as they are mounted, on their robot.

    A robot has one of them on it at a time.
    """
    for tool in case.wanted.tools:
        for stay in case.stays[tool.name]:
            words, away = _wrong(case, tool, stay)
            if words and stay.until > stay.t:
                times, other = (stay.t, min(stay.until, case.end)), stay.holder
                yield Violation(*times, tool.name, other or "rack", away, words, "tool")
    owners = {tool.name: tool.robot for tool in case.wanted.tools}
    on_it: dict[str, list[str]] = {robot: [] for robot in owners.values()}
    for stay in case.in_order:
        robot = owners.get(stay.object)
        if robot is None:
            continue
        if stay.object in on_it[robot]:
            on_it[robot].remove(stay.object)
        if stay.holder == robot:
            on_it[robot].append(stay.object)
        if len(on_it[robot]) > 1:
            words = f"is on {robot} along with {on_it[robot][0]}"
            yield Violation(stay.t, stay.t, stay.object, robot, 0.0, words, "tool")


def _wrong(case: AuditCase, tool: ChangedTool, stay: Stay) -> tuple[str, float]:
    """Return what is wrong with where a tool is, empty if nothing is, and by how much [m]."""
    item = case.cell.object(tool.name)
    if stay.holder is not None:
        if stay.holder != tool.robot:
            return f"is a tool of {tool.robot}", 0.0
        away = distance_of(item, stay.pose, tool.mount)
        return _far("as it is mounted", away), away
    away = distance_of(item, stay.pose, tool.rack)
    if away > PLACED and stay.t == 0.0 and tool.first:
        hand = case.flange(tool.robot, 0.0)
        away = min(away, distance_of(item, stay.pose, hand @ tool.mount))
    return _far("its rack", away), away


def _far(place: str, away: float) -> str:
    return f"is {away * 1e3:.2f} mm off {place}" if away > PLACED else ""
