"""Audit rule: bodies may touch only where a task of the plan allows contact."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain, combinations, product
from operator import itemgetter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from planning.tasks.task import AllowedContact
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.witness.measuring import PRECISION, Measuring
from scheduling.witness.moving_robot import MovingRobot
from scheduling.witness.parts import measure
from twin.audits.case import AuditCase, Violation, tasks_along
from twin.audits.motion.pairs import (
    SLACK,
    ClosePair,
    pairs_at_rest,
    pairs_of_robot,
    pairs_of_robots,
)
from twin.audits.motion.second_look import sampled_overlaps
from twin.audits.motion.stretches import RunStretch

if TYPE_CHECKING:  # PyBullet is loaded on demand
    from twin.audits.worlds.bullet_world import BulletWorld

CONTACT_DEPTH = 0.003
"""Largest depth of allowed contacts, unless the plan has a smaller one [m]."""

NODE_SLACK = 0.001
"""Rounding tolerance of the depth of joined parts [m]."""


_NEAR, _FARTHER = 0.02, 3.0
"""First search distance for two robots [m], and the factor by which it then grows."""

_LATER = 8
"""Greatest number of postponed stretches in which robots are far apart."""

Allowed = Mapping[frozenset[str], Mapping[int, Sequence[AllowedContact]]]
"""Allowed contacts by pair of entities and by task."""

AllowedDepths = Callable[[ClosePair], Array]
"""Returns how deep a pair of shapes may overlap at each sample of a stretch, shape (m,) [m]."""


class _Checked(NamedTuple):
    """An interval of a run to check, the number of its first sample, and the allowed depths in it."""

    stretch: RunStretch
    first: int
    depths: AllowedDepths


def allowed_contacts(tpg: TemporalPlanGraph) -> Allowed:
    """Return the allowed contacts of a plan that its handlings need.

    These are between a tool and an object, two objects, or an object and a fixture. Robots
    never touch each other, and an arm never touches anything.
    """
    objects = {item.name for item in tpg.cell.objects}
    others = {item.name for item in tpg.cell.fixtures}
    others |= {f"{robot.name}/tool" for robot in tpg.cell.robots}
    allowed: dict[frozenset[str], dict[int, list[AllowedContact]]] = {}
    for contact in tpg.allowed:
        pair = frozenset((contact.first, contact.second))
        partners = pair - objects
        if len(pair) == 2 and len(partners) <= 1 and partners <= others:
            of_task = allowed.setdefault(pair, {})
            for task in contact.tasks:
                of_task.setdefault(task, []).append(contact)
    return allowed


class Contacts:
    """Contacts of an execution, collected interval by interval.

    A contact is allowed while the plan lists it for the current tasks. A grazing tool may go as deep as
    the contact tolerance of the cell.

    Args:
        case: the execution.
        allowed: contacts of its plan.
        exempt: pairs of shapes that are not checked, see ``overlapping_at_home``.
        within: robots further apart than this are not measured [m].
        any_depth: whether allowed contacts may be of any depth.
        second: the same cell in PyBullet, which looks for overlaps at samples.
        clean: robots whose contacts with themselves and with what rests are known, see ``surroundings``.

    Attributes:
        least: least distance of two robots with carried objects, where they should not touch [m].
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
        any_depth: bool = False,
        second: BulletWorld | None = None,
        clean: Collection[Hashable] = (),
    ) -> None:
        self._case, self._allowed, self._exempt = case, allowed, exempt
        self._any_depth, self._second, self._clean = any_depth, second, clean
        self._tools = {f"{robot}/tool": robot for robot in case.robots}
        self._allowed_depth = cache(self._depth)
        self.least, self._measuring = within, Measuring()
        self.tolerance = case.cell.clearances.contact_tolerance
        self.configurations, self.deepest_graze = 0, 0.0
        self._samples, self._later = 0, list[_Checked]()
        # Deepest overlap of each pair by number of the sample: time [s], depth [m], links.
        self._overlaps: dict[tuple[str, str], dict[int, tuple[float, float, str]]] = {}

    @property
    def bound(self) -> float:
        """Lower bound of the distance between any two robots with their loads [m]."""
        return self.least - PRECISION

    def look(self, stretch: RunStretch) -> None:
        """Check one interval."""
        moves = np.zeros(len(stretch.t) - 1, dtype=np.bool_)
        for path in stretch.paths:
            moves |= np.any(np.diff(path, axis=0) != 0.0, axis=1)
        self.configurations += int(np.count_nonzero(moves)) + (self._samples == 0)
        checked = _Checked(stretch, self._samples, self._depths(stretch))
        self._samples += len(stretch.t)
        near = [self._own_pairs(stretch)]
        if self.least > _NEAR:
            self._approach(stretch)
        if self.least > _NEAR and len(self._later) < _LATER:
            self._later.append(checked)
        else:
            near.append(self._robot_pairs(stretch))
        self._check(checked, chain.from_iterable(near))

    def finish(self) -> None:
        """Check the postponed stretches, now that the least distance of robots is known."""
        for checked in self._later:
            self._check(checked, self._robot_pairs(checked.stretch))
        self._later.clear()

    def _check(self, checked: _Checked, pairs: Iterator[ClosePair]) -> None:
        """Measure pairs of a stretch."""
        seen = []
        for pair in pairs:
            self._measure(checked, pair)
            if self._second is not None:
                seen.append(pair)
        if self._second is None:
            return
        for pair, sample, gap in sampled_overlaps(self._second, checked.stretch, seen):
            limit = checked.depths(pair)[sample]
            if -gap > limit or (self._are_robots(pair) and -gap >= SLACK):
                self._note(checked, pair, sample, gap)

    def _approach(self, stretch: RunStretch) -> None:
        """Lower the least distance by measuring every two robots once, where they may be nearest."""
        for robots in combinations(range(len(stretch.robots)), 2):
            if math.isinf(self.least):
                self._start(*(stretch.robots[k] for k in robots))
            for pair in self._of_robots(stretch, robots):
                if self._are_robots(pair):
                    gap = pair.middle_gap(int(np.argmin(pair.gaps)))
                    self.least = min(self.least, gap)
                    break

    def _of_robots(
        self, stretch: RunStretch, robots: tuple[int, int]
    ) -> Iterator[ClosePair]:
        """Yield the pairs of shapes of two robots that may be nearer than the least distance so far.

        The search distance grows until it reaches that distance; pairs farther apart are never searched.
        """
        limit = min(_NEAR, self.least)
        while True:
            yield from pairs_of_robots(stretch, robots, max(limit, 0.0))
            if self.least <= limit:
                break
            limit = min(_FARTHER * limit, self.least)

    def _robot_pairs(self, stretch: RunStretch) -> Iterator[ClosePair]:
        """Yield the pairs of shapes of all robots that may be nearer than the least distance so far."""
        for robots in combinations(range(len(stretch.robots)), 2):
            yield from self._of_robots(stretch, robots)

    def _own_pairs(self, stretch: RunStretch) -> Iterator[ClosePair]:
        """Yield the pairs that may overlap: within each robot, and of it and things at rest."""
        for robot in range(len(stretch.robots)):
            if self._clean and self.surroundings(stretch, robot) in self._clean:
                continue
            yield from pairs_of_robot(stretch, robot, self._exempt)
            yield from pairs_at_rest(stretch, robot, self._exempt)

    def surroundings(self, stretch: RunStretch, robot: int) -> Hashable:
        """Return what decides on the contacts of a standing robot but those with other robots.

        A sampler keeps the parts of held objects and those at rest, so that they are the same ones in all its stretches.
        """
        rows = self._case.robots[self._case.cell.robots[robot].name]
        nodes, moving = (
            rows.node[np.searchsorted(rows.t, stretch.t)],
            stretch.robots[robot],
        )
        parts = *map(id, moving.parts), *map(id, stretch.still.motions)
        return robot, moving.knots.tobytes(), nodes.tobytes(), parts

    def _depths(self, stretch: RunStretch) -> AllowedDepths:
        """Return the function that returns how deep a pair may overlap at each sample."""
        holders = {name: p.holder for name, p in stretch.placements.items()}

        @cache
        def tasks(entity: str) -> Sequence[frozenset[int] | None]:
            owner = self._tools.get(entity, holders.get(entity))
            if owner is None:
                return [None] * len(stretch.t)
            return tasks_along(self._case.tpg, self._case.robots, owner, stretch.t)

        @cache
        def depths(first: str, second: str) -> Array:
            pair, count = frozenset((first, second)), len(stretch.t)
            if pair not in self._allowed:
                return np.full(count, SLACK)
            now = zip(tasks(first), tasks(second), strict=True)
            return np.array([self._allowed_depth(pair, both) for both in now])

        return lambda pair: depths(pair.a.entity, pair.b.entity)

    def _measure(self, checked: _Checked, pair: ClosePair) -> None:
        """Measure a pair where it is close."""
        last = np.minimum(pair.last, len(checked.stretch.t) - 1)
        pair = replace(pair, last=last)
        own = checked.depths(pair)
        limits = np.minimum(own[pair.first], own[last])
        for k in np.flatnonzero(
            last - pair.first > 1
        ).tolist():  # standstill of several samples
            limits[k] = own[pair.first[k] : last[k] + 1].min()
        if pair.two_robots:
            apart = limits <= SLACK
            if apart.any():
                self._measure_robots(checked, pair.some(apart))
            pair, limits = pair.some(~apart), limits[~apart]
        for limit in np.unique(limits).tolist():
            if math.isfinite(limit):
                some = pair.some(limits == limit)
                if pair.entities in self._allowed and limit == self.tolerance + SLACK:
                    self._graze(some)
                self._overlaps_of(checked, some, limit)

    def _measure_robots(self, checked: _Checked, pair: ClosePair) -> None:
        """Measure the least distance of two robots where they are not meant to touch."""
        near = pair.some(pair.gaps < self.least)
        if len(near):
            self.least = min(self.least, near.middle_gap(int(np.argmin(near.gaps))))
            near = near.some(near.gaps < self.least)
            self.least = self._measuring.closest(
                pair.x, pair.y, near.pieces, self.least, lockstep=True
            )
        if self.least <= 0.0:
            most = 0.0 if self._are_robots(pair) else SLACK
            found = self._overlaps_of(checked, pair, most)
            self.least = min(self.least, found)

    def _overlaps_of(self, checked: _Checked, pair: ClosePair, most: float) -> float:
        """Record where a pair overlaps by more than it may, and return its least distance there.

        Args:
            checked: the stretch.
            pair: the shapes, and where they are close.
            most: overlap that is allowed at all times [m].
        """
        robots, nearest, own = self._are_robots(pair), math.inf, checked.depths(pair)
        found = self._measuring.too_close(
            pair.x, pair.y, pair.pieces, -most, np.arange(len(pair)), lockstep=True
        )
        for k, inside, _ in found:
            samples = range(int(pair.first[k]), int(pair.last[k]) + 1)
            begin, end = pair.gaps_at_ends(k)
            gaps = [*[begin] * (len(samples) - 1), end]
            deep = [
                (sample, gap)
                for sample, gap in zip(samples, gaps, strict=True)
                if robots or -gap > own[sample]
            ]
            if robots or (not deep and min(begin, end) >= -most):
                deep.append((samples[0], inside))
            for sample, gap in deep:
                if -gap > own[sample] or (robots and gap <= 0.0):
                    self._note(checked, pair, sample, gap)
            nearest = min(nearest, begin, end)
        return nearest

    def _graze(self, pair: ClosePair) -> None:
        """Measure how deep a tool grazes a brick."""
        below = -self.deepest_graze
        nearest = self._measuring.closest(
            pair.x, pair.y, pair.pieces, below, lockstep=True
        )
        self.deepest_graze = max(self.deepest_graze, -nearest)

    def _start(self, one: MovingRobot, other: MovingRobot) -> None:
        """Measure the distance of two robots where a stretch begins."""
        for (p, x), (q, y) in product(
            zip(one.robot.parts, one.motions, strict=False),
            zip(other.robot.parts, other.motions, strict=False),
        ):
            gap = measure(p, x.frames[0], q, y.frames[0])
            self.least = min(self.least, gap)

    @staticmethod
    def _are_robots(pair: ClosePair) -> bool:
        """Return whether two shapes are of two robots themselves, which may never touch."""
        return pair.two_robots and None not in (pair.a.robot, pair.b.robot)

    def _note(
        self, checked: _Checked, pair: ClosePair, sample: int, gap: float
    ) -> None:
        """Record an overlap that is not allowed."""
        number = checked.first + sample
        seen = self._overlaps.setdefault((pair.a.entity, pair.b.entity), {})
        if number not in seen or seen[number][1] < -gap:
            links = f"{pair.a.detail} - {pair.b.detail}"
            seen[number] = (float(checked.stretch.t[sample]), -gap, links)

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
            tasks: current tasks of the robot of each, None at rest.
        """
        of_task, busy = self._allowed[pair], [own for own in tasks if own is not None]
        now = [
            contact
            for task in (busy[0] if busy else of_task)
            for contact in of_task.get(task, ())
            if all(contact.tasks & own for own in busy)
        ]
        if not now:
            return SLACK
        if self._any_depth:
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
