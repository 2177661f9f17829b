"""What a robot holds must be at its tool.

Contact rules of the audit: allowed contacts from the plan, depth limits from the audit.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import replace

import numpy as np

from planning.transforms import Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.motion.executed import ObjectRow, Recording
from twin.audit.motion.sampling import RunStretch
from twin.audit.tools import Hand, hand_of
from twin.audit.violation import Violation
from twin.audit.wanted import Wanted
from twin.audit.worlds.world import FAR, AuditWorld, WatchedShape

GRIP = 0.005
"""What is held may be this far away from the closed tool of its holder [m]."""


_PLAY = 1e-4
"""A box may be wider than its fingers open by this: rounding of files [m]."""


class GripWatch:
    """Measures once for every hold, when it begins: from then on tool and object move as one.

    Fingers that stand open in the geometry of a tool close by half of what is left of their
    opening beside the thinnest edge of the object.

    Args:
        world: to measure in.
        wanted: how far fingers stand open.
    """

    def __init__(self, world: AuditWorld, wanted: Wanted) -> None:
        self._world, self._wanted = world, wanted
        self._known: dict[str, ObjectRow] = {}
        self._open: dict[str, Violation] = {}
        self._found: list[Violation] = []

    def look(self, stretch: RunStretch) -> None:
        """Check what has come into a hand at the start of a stretch."""
        t = float(stretch.t[0])
        tools = {tool.name for tool in self._wanted.tools}
        for name, row in stretch.placements.items():
            if self._known.get(name) is row:
                continue
            self._known[name] = row
            if name in self._open:
                self._found.append(replace(self._open.pop(name), t_end=t))
            if row.holder is not None and name not in tools:
                self._measure(stretch, name, row.holder)
        self._last = float(stretch.t[-1])

    def violations(self) -> list[Violation]:
        """Return the holds that do not fit, from when to when."""
        self._found += [replace(v, t_end=self._last) for v in self._open.values()]
        self._open = {}
        return self._found

    def _measure(self, stretch: RunStretch, name: str, holder: str) -> None:
        tracks = [k for k in stretch.moving if k.shape.entity == name]
        arm = tracks[0].holder
        assert arm is not None
        q, rows = stretch.robots[arm].q[0], stretch.placements
        hand = hand_of(self._world, arm, q, rows, self._wanted)
        for track in tracks:
            self._world.place(track.shape, track.pose(0))
        gap, tool = min(
            (self._world.distance(shape, track.shape, FAR), shape.detail)
            for shape in hand.shapes
            for track in tracks
        )
        grip, opening = hand.grip, hand.opening(self._wanted.opening_m)
        closing = max(finger_travel(track.shape, opening) for track in tracks)
        t = float(stretch.t[0])
        if grip is not None and grip.opening is not None:
            width = self._width(name, hand, stretch.placements[name].pose)
            if width is not None and width > opening + _PLAY:
                detail = (
                    f"is {width * 1e3:.2f} mm wide between the fingers of {grip.tool}, which open to"
                    f" {opening * 1e3:.2f} mm"
                )
                self._open[name] = Violation(
                    t, t, name, holder, width - opening, detail, "grip"
                )
                return
        if gap > GRIP + closing:
            detail = f"is held {gap * 1e3:.2f} mm away from {tool}"
            detail += f", which closes by {closing * 1e3:.2f} mm" if closing else ""
            self._open[name] = Violation(t, t, name, holder, gap, detail, "grip")

    def _width(self, name: str, hand: Hand, held: Transform) -> float | None:
        """Return how wide a box is along the axis in which fingers close [m].

        None where that cannot be told: of what is no box, fingers may grip any part.
        """
        item, tool = self._world.cell.object(name), hand.frames.get("tool")
        if tool is None or not item.shape.is_box:
            return None
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
        self._recording = Recording({}, (), 0.0)
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

    def during(self, recording: Recording) -> ContactRule:
        """Return the rule for an execution, which tells which task each robot is at."""
        rule = copy(self)
        rule._recording, rule._known = recording, {}
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
            nodes = self._recording.robots[robot].nodes_at(t)
            own = tasks[np.clip(nodes, 0, len(tasks) - 1)] if len(tasks) else tasks
            self._known[key] = frozenset(own.tolist())
        return self._known[key]
