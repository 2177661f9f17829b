"""Contacts of an execution, against the allowed contacts of its tasks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np

from planning.tasks.task import AllowedContact
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audits.case import AuditCase, Violation, tasks_along
from twin.audits.motion.pairs import (
    SLACK,
    Gap,
    MeasurementThresholds,
    measured_gaps,
    watched_pairs,
)
from twin.audits.motion.second_look import sampled_overlaps
from twin.audits.motion.stretches import RunStretch
from twin.audits.worlds.world import WatchedShape

if TYPE_CHECKING:  # PyBullet is loaded on demand
    from twin.audits.worlds.bullet_world import BulletWorld

CONTACT_DEPTH = 0.003
"""Largest depth of allowed contacts, unless the plan has a smaller one [m]."""

NODE_SLACK = 0.001
"""Rounding tolerance of the depth of joined parts [m]."""


Allowed = Mapping[frozenset[str], Sequence[AllowedContact]]
"""Contacts that may be, by pair."""


def allowed_contacts(tpg: TemporalPlanGraph) -> Allowed:
    """Return the allowed contacts of a plan that its handlings need.

    It needs contacts of a tool and an object, two objects, or an object and a fixture. Robots
    never touch each other, and an arm never touches anything.
    """
    objects = {item.name for item in tpg.cell.objects}
    others = {item.name for item in tpg.cell.fixtures}
    others |= {f"{robot.name}/tool" for robot in tpg.cell.robots}
    allowed: dict[frozenset[str], list[AllowedContact]] = {}
    for contact in tpg.allowed:
        pair = frozenset((contact.first, contact.second))
        partners = pair - objects
        if len(pair) == 2 and len(partners) <= 1 and partners <= others:
            allowed.setdefault(pair, []).append(contact)
    return allowed


class Contacts:
    """Contacts of an execution, collected interval by interval.

    A contact is allowed while the plan lists it for the current tasks. A grazing tool may go as deep as
    the contact tolerance of the cell.

    Args:
        case: the execution.
        allowed: contacts of its plan.
        exempt: pairs of one robot's shapes that are not checked.
        within: robots further apart than this are not measured [m].
        taken_up: whether contacts that are allowed may be of any depth.
        second: the same cell in PyBullet, which looks for overlaps at samples.

    Attributes:
        least: least distance of two robots with carried objects, where they should not touch [m].
        bound: nearer than this they were at no moment [m].
        configurations: number of different configurations of the whole cell.
        tolerance: the contact tolerance [m].
        deepest_graze: how deep a tool grazed a brick [m].
    """

    def __init__(
        self,
        case: AuditCase,
        allowed: Allowed,
        exempt: frozenset[tuple[int, int]],
        within: float,
        *,
        taken_up: bool = False,
        second: BulletWorld | None = None,
    ) -> None:
        self._case, self._allowed, self._exempt = case, allowed, exempt
        self._taken_up, self._second = taken_up, second
        self._tools = {f"{robot}/tool": robot for robot in case.robots}
        self._allowed_depth = cache(self._depth)
        self.least = self.bound = within
        self.tolerance = case.cell.clearances.contact_tolerance
        self.configurations, self.deepest_graze = 0, 0.0
        self._arms, self._samples = len(case.world.robot_shapes), 0
        # Deepest overlap of each pair by number of the sample: time [s], depth [m], links.
        self._overlaps: dict[tuple[str, str], dict[int, tuple[float, float, str]]] = {}

    def look(self, stretch: RunStretch) -> None:
        """Check one interval."""
        moved = {
            tuple(int(r.distinct[k]) for r in stretch.robots)
            for k in range(len(stretch.t))
        }
        self.configurations += len(moved) - (self._samples > 0)
        holders = {name: p.holder for name, p in stretch.placements.items()}

        @cache
        def tasks(entity: str) -> Sequence[frozenset[int] | None]:
            owner = self._tools.get(entity, holders.get(entity))
            if owner is None:
                return [None] * len(stretch.t)
            return tasks_along(self._case.tpg, self._case.robots, owner, stretch.t)

        def depth(a: WatchedShape, b: WatchedShape, sample: int) -> float:
            first, second = a.entity, b.entity
            now = tasks(first)[sample], tasks(second)[sample]
            return self._allowed_depth(frozenset((first, second)), now)

        asked = MeasurementThresholds(lambda: self.least, depth)
        watched = list(watched_pairs(stretch, self._arms, self._exempt, asked))
        for gap in measured_gaps(self._case.world, stretch, watched, asked):
            if gap.pair.between_robots:
                self.least = min(self.least, gap.distance)
                self.bound = min(self.bound, gap.bound)
            if gap.distance <= 0.0:
                self._note(stretch, gap, depth, least_m=0.0)
        if self._second is not None:
            for gap in sampled_overlaps(self._second, stretch, watched):
                self._note(stretch, gap, depth, least_m=SLACK)
        self._samples += len(stretch.t)

    def _note(
        self,
        stretch: RunStretch,
        gap: Gap,
        depth: Callable[[WatchedShape, WatchedShape, int], float],
        least_m: float,
    ) -> None:
        """Record an overlap that is not allowed.

        Args:
            stretch: in which it is.
            gap: the shapes, when, and how deep.
            depth: returns the overlap that is allowed for two shapes at a sample [m].
            least_m: overlaps of two robots up to this are none [m].
        """
        a, b = gap.pair.shapes
        robots = a.robot is not None and b.robot is not None and a.robot != b.robot
        for sample in range(gap.sample, min(gap.until, len(stretch.t))):
            t, number = float(stretch.t[sample]), self._samples + sample
            limit = depth(a, b, sample)
            if not robots and limit == self.tolerance + SLACK:
                self.deepest_graze = max(self.deepest_graze, -gap.distance)
            if -gap.distance > limit or (robots and -gap.distance >= least_m):
                seen = self._overlaps.setdefault((a.entity, b.entity), {})
                if number not in seen or seen[number][1] < -gap.distance:
                    links = f"{a.detail} - {b.detail}"
                    seen[number] = (t, -gap.distance, links)

    def violations(self) -> Iterator[Violation]:
        """Yield disallowed overlaps with time intervals."""
        for pair, seen in self._overlaps.items():
            numbers = np.array(sorted(seen))
            for run in np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1):
                rows = [seen[number] for number in run.tolist()]
                _, depth, detail = max(rows, key=itemgetter(1))
                yield Violation(rows[0][0], rows[-1][0], *pair, depth, detail)

    def _depth(
        self, pair: frozenset[str], tasks: tuple[frozenset[int] | None, ...]
    ) -> float:
        """Return the largest allowed overlap of two entities [m].

        Args:
            pair: their names.
            tasks: those at hand of the robot of each, None at rest.
        """
        now = [
            contact
            for contact in self._allowed.get(pair, ())
            if all(own is None or contact.tasks & own for own in tasks)
        ]
        if not now:
            return SLACK
        if self._taken_up:
            return math.inf
        if all(contact.grazing for contact in now):
            return self.tolerance + SLACK
        said = self._case.wanted.overlaps_m.get(pair, 0.0)
        most = max(CONTACT_DEPTH, said + NODE_SLACK)
        planned = [contact.depth for contact in now if not contact.grazing]
        return min([most, *(d + SLACK for d in [_deepest(planned)] if d is not None)])


def _deepest(planned: Sequence[float | None]) -> float | None:
    """Return the greatest depth, None without one [m]."""
    own = [depth for depth in planned if depth is not None]
    return max(own) if len(own) == len(planned) else None
