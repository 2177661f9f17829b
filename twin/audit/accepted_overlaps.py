"""Contact rules of the audit: allowed contacts from the plan, depth limits from the audit."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy

import numpy as np

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.motion.executed import Recording
from twin.audit.wanted import Wanted

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
        self._nodes = frozenset[frozenset[str]]() if wanted is None else wanted.joined
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
