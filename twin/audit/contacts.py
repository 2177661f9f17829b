"""What may touch while which tasks are done, how deep, and what did."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import copy
from functools import cache
from operator import itemgetter

import numpy as np

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.motion.executed import RobotRows
from twin.audit.motion.pairs import SLACK, Asked, gaps
from twin.audit.motion.sampling import RunStretch
from twin.audit.violation import Violation
from twin.audit.wanted import Wanted
from twin.audit.worlds.world import AuditWorld, WatchedShape

CONTACT_DEPTH = 0.003
"""Allowed contacts may be this deep, unless the plan says that a tool only grazes [m]."""

NODE_SLACK = 0.001
"""What is joined may be deeper in each other than its scenario says by this: rounding [m]."""


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


class ContactWatch:
    """Collects what is seen stretch by stretch.

    Args:
        world: to measure in.
        rule: says how deep what may be in what.
        exempt: pairs of one robot's shapes that are not checked.
        within: robots further apart than this are not measured [m].

    Attributes:
        least: distance of two robots, with what they carry, where they are not meant to touch [m].
        bound: nearer than this they were at no moment [m].
        configurations: number of different configurations of the whole cell.
        deepest_graze: how deep a tool grazed a brick [m].
    """

    def __init__(
        self,
        world: AuditWorld,
        rule: ContactRule,
        exempt: frozenset[tuple[int, int]],
        within: float,
    ) -> None:
        self._world, self._rule, self._exempt = world, rule, exempt
        self.least = self.bound = within
        self.configurations, self.deepest_graze = 0, 0.0
        self._samples = 0
        # Deepest overlap of each pair by number of the sample: time [s], depth [m], links.
        self._overlaps: dict[tuple[str, str], dict[int, tuple[float, float, str]]] = {}

    def look(self, stretch: RunStretch) -> None:
        """Check one stretch."""
        moved = {
            tuple(int(r.distinct[k]) for r in stretch.robots)
            for k in range(len(stretch.t))
        }
        self.configurations += len(moved) - (self._samples > 0)
        holders = {name: p.holder for name, p in stretch.placements.items()}

        @cache
        def depth_at(first: str, second: str, sample: int) -> float:
            return self._rule.depth(first, second, holders, float(stretch.t[sample]))

        def depth(a: WatchedShape, b: WatchedShape, sample: int) -> float:
            return depth_at(a.entity, b.entity, sample)

        asked = Asked(lambda: self.least, depth)
        for gap in gaps(self._world, stretch, self._exempt, asked):
            a, b = gap.pair.shapes
            robots = a.robot is not None and b.robot is not None and a.robot != b.robot
            if gap.pair.between_robots:
                self.least = min(self.least, gap.distance)
                self.bound = min(self.bound, gap.bound)
            if gap.distance > 0.0:
                continue
            for sample in range(gap.sample, min(gap.until, len(stretch.t))):
                t, number = float(stretch.t[sample]), self._samples + sample
                limit = depth(a, b, sample)
                if not robots and self._rule.is_of_graze(limit):
                    self.deepest_graze = max(self.deepest_graze, -gap.distance)
                if robots or -gap.distance > limit:
                    seen = self._overlaps.setdefault((a.entity, b.entity), {})
                    if number not in seen or seen[number][1] < -gap.distance:
                        links = f"{a.detail} - {b.detail}"
                        seen[number] = (t, -gap.distance, links)
        self._samples += len(stretch.t)

    def violations(self) -> Iterator[Violation]:
        """Yield overlaps that nothing allows, from when to when."""
        for pair, seen in self._overlaps.items():
            numbers = np.array(sorted(seen))
            for run in np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1):
                rows = [seen[number] for number in run.tolist()]
                _, depth, detail = max(rows, key=itemgetter(1))
                yield Violation(rows[0][0], rows[-1][0], *pair, depth, detail)
