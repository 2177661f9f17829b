"""Tools that robots change are on them as they are mounted, or in their racks."""

from __future__ import annotations

from collections.abc import Iterator

from twin.audit.case import AuditCase
from twin.audit.motion.executed import Stay
from twin.audit.places import PLACED, distance_of
from twin.audit.violation import Violation
from twin.audit.wanted import ChangedTool


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
