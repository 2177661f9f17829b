"""What a robot holds must be at its tool.

Contact rules of the audit: allowed contacts from the plan, depth limits from the audit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import copy

import numpy as np

from planning.cell.workcell import CellObject
from planning.transforms import Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.motion.executed import RobotRows
from twin.audit.motion.replay import Replay
from twin.audit.tools import Hand, hand_at
from twin.audit.violation import Violation
from twin.audit.wanted import Wanted
from twin.audit.worlds.world import (
    FAR,
    AuditWorld,
    WatchedShape,
    flange_poses,
    shapes_by_entity,
)

GRIP = 0.005
"""What is held may be this far away from the closed tool of its holder [m]."""


_PLAY = 1e-4
"""A box may be wider than its fingers open by this: rounding of files [m]."""


def grip_violations(
    world: AuditWorld, replay: Replay, wanted: Wanted
) -> Iterator[Violation]:
    """Yield what is held by who is not at it, or wider than fingers open.

    Every hold is measured once, when it begins: from then on tool and object move as one. Fingers
    that stand open in the geometry of a tool close by half of what is left of their opening beside
    the thinnest edge of the object.

    Args:
        world: to measure in.
        replay: what was executed.
        wanted: how far fingers stand open.
    """
    robots = {robot.name: k for k, robot in enumerate(world.cell.robots)}
    shapes = shapes_by_entity(world.objects)
    tools = {tool.name for tool in wanted.tools}
    for stay in replay.in_order:
        t = max(stay.t, 0.0)
        if stay.holder not in robots or stay.object in tools or stay.until <= t:
            continue
        robot = robots[stay.holder]
        rows = replay.robots[stay.holder].at(np.array([t]))
        held = flange_poses(world, robot, rows)[0] @ stay.pose
        hand = hand_at(world, replay, wanted, robot, t)
        for own in shapes[stay.object]:
            world.place(own, own.at(held))
        gap, tool = min(
            (world.distance(part, own, FAR), part.detail)
            for part in hand.shapes
            for own in shapes[stay.object]
        )
        opening = hand.opening(wanted.opening_m)
        closing = max(finger_travel(own, opening) for own in shapes[stay.object])
        width = _width(world.cell.object(stay.object), hand, stay.pose)
        if width > opening + _PLAY:
            fingers = "" if hand.grip is None else hand.grip.tool
            depth, detail = width - opening, f"is {width * 1e3:.2f} mm wide between"
            detail += f" the fingers of {fingers}, which open to {opening * 1e3:.2f} mm"
        elif gap > GRIP + closing:
            depth, detail = gap, f"is held {gap * 1e3:.2f} mm away from {tool}"
            detail += f", which closes by {closing * 1e3:.2f} mm" if closing else ""
        else:
            continue
        until = min(stay.until, replay.end)
        yield Violation(t, until, stay.object, stay.holder, depth, detail, "grip")


def _width(item: CellObject, hand: Hand, held: Transform) -> float:
    """Return how wide a box is along the axis in which fingers close [m].

    Nothing where that cannot be told: without fingers, or of what is no box, which fingers may
    grip at any part.
    """
    tool, grip = hand.frames.get("tool"), hand.grip
    if grip is None or grip.opening is None or tool is None or not item.shape.is_box:
        return 0.0
    return float(np.abs(held[:3, :3].T @ tool[:3, 1]) @ item.size)


def finger_travel(shape: WatchedShape, opening: float) -> float:
    """Return how far each finger closes on the thinnest edge of a shape at most [m]."""
    return max(0.0, 0.5 * (opening - 2.0 * float(np.min(shape.half))))


CONTACT_DEPTH = 0.003
"""Allowed contacts may be this deep, unless the plan says that a tool only grazes [m]."""

NODE_SLACK = 0.001
"""What is joined may be deeper in each other than its scenario says by this: rounding [m]."""

SLACK = 1e-4
"""Overlaps up to this are numerical: 2.5 times the measured error of Bullet's distances [m]."""


class ContactRule:
    """Greatest accepted overlap of two things at a time.

    A contact counts as allowed only if the plan lists it for the tasks at hand *and* it is of a
    kind that handling needs: a tool and an object, two objects, or an object and a fixture.
    Robots never touch each other, and an arm never touches anything.

    A tool that grazes goes no deeper than the contact tolerance of the cell.

    Args:
        tpg: the allowed contacts of the plan, and the tasks of nodes.
        wanted: what is joined, and how deep it may be in each other; None where nothing is known.

    Attributes:
        tolerance: the contact tolerance [m].
    """

    def __init__(self, tpg: TemporalPlanGraph, wanted: Wanted | None = None) -> None:
        self._nodes = frozenset(() if wanted is None else wanted.joined)
        self._node_depth = 0.0 if wanted is None else wanted.joined_overlap_m
        self._robots: Mapping[str, RobotRows] = {}
        self._tasks = {chain.robot: chain.task for chain in tpg.chains}
        self._known: dict[tuple[str, float], frozenset[int]] = {}
        objects = {box.name for box in tpg.cell.objects}
        fixtures = {box.name for box in tpg.cell.fixtures}
        tools = {f"{robot.name}/tool": robot.name for robot in tpg.cell.robots}
        self._tools: Mapping[str, str] = tools
        self.tolerance = tpg.cell.clearances.contact_tolerance
        self._allowed: dict[frozenset[str], list[tuple[frozenset[int], bool]]] = {}
        for contact in tpg.allowed:
            pair = frozenset((contact.first, contact.second))
            partners = pair - objects
            if (
                len(pair) == 2
                and len(partners) <= 1
                and partners <= tools.keys() | fixtures
            ):
                entry = contact.tasks, contact.grazing
                self._allowed.setdefault(pair, []).append(entry)

    def during(self, robots: Mapping[str, RobotRows]) -> ContactRule:
        """Return the rule for an execution, which tells which task each robot is at."""
        rule = copy(self)
        rule._robots, rule._known = robots, {}
        return rule

    def depth(
        self, first: str, second: str, holders: Mapping[str, str | None], t: float
    ) -> float:
        """Return the greatest overlap that is no violation [m].

        Args:
            first, second: entities.
            holders: object name to the robot that holds it, None at rest.
            t: time [s].
        """
        entries = self._allowed.get(frozenset((first, second)))
        if entries is None:
            return SLACK
        owners = {
            owner
            for name in (first, second)
            if (owner := self._tools.get(name, holders.get(name))) is not None
        }
        now = [
            grazing
            for tasks, grazing in entries
            if all(tasks & self.tasks_at(owner, t) for owner in owners)
        ]
        if not now:
            return SLACK
        if all(now):
            return self.tolerance + SLACK
        if frozenset((first, second)) in self._nodes:
            return max(CONTACT_DEPTH, self._node_depth + NODE_SLACK)
        return CONTACT_DEPTH

    def is_of_graze(self, depth: float) -> bool:
        """Tell whether a greatest overlap is that of a tool that only grazes."""
        return depth == self.tolerance + SLACK

    def tasks_at(self, robot: str, t: float) -> frozenset[int]:
        """Return the tasks a robot is at: two at the moment one ends and when it stands."""
        key = (robot, t)
        if key not in self._known:
            tasks = self._tasks.get(robot, np.empty(0, dtype=np.int64))
            nodes = self._robots[robot].nodes_at(t)
            own = tasks[np.clip(nodes, 0, len(tasks) - 1)] if len(tasks) else tasks
            self._known[key] = frozenset(own.tolist())
        return self._known[key]
