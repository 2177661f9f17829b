"""Stability of the partial structures of one design, judged again and again but cheaply.

A sequence search asks thousands of times about structures that differ by a brick. Three facts
spare most linear programs:

- bricks that rest by pushing alone (``compression``) need no friction, wherever they are;
- loads add up: a solution for some bricks and all that they stand on, plus push-only solutions
  for the rest, is a solution for all, so the score of the smaller structure bounds the larger's;
- structures that touch only through the plate do not feel each other.

Only what these leave open is solved as a whole. Scores are therefore upper bounds when they say
stable, exact when they say unstable.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence

from planning.lego.compression import Region, contains, convex_hull, resting_regions
from planning.lego.contacts import (
    Joint,
    PlacedBrick,
    by_name,
    centre,
    filled_places,
    joints,
    knob_points,
    side_contacts,
)
from planning.lego.stability import (
    STANDARD_GRAVITY,
    Hold,
    JointStrength,
    Load,
    StabilityReport,
    stability,
)
from planning.lego.structure import STUD_PITCH

Names = frozenset[str]

_AT_REST = StabilityReport(True, 0.0, None)


class PartialStructures:
    """Every partial structure of a design, by the names of its bricks.

    Args:
        design: all bricks, scaffolding included.
        strength: what joints bear.
        limit: largest score that counts as stable.
    """

    def __init__(
        self,
        design: Iterable[PlacedBrick],
        *,
        strength: JointStrength = JointStrength(),  # noqa: B008 - frozen
        limit: float = 1.0,
    ) -> None:
        self.bricks = by_name(design)
        self._strength = strength
        self._limit = limit
        filled = filled_places(self.bricks)
        self._joints = joints(self.bricks, filled)
        self._sides = {
            frozenset((side.first, side.second))
            for side in side_contacts(self.bricks, filled)
        }
        self._under: dict[str, list[Joint]] = defaultdict(list)
        self._over: dict[str, list[Joint]] = defaultdict(list)
        for joint in self._joints:
            self._under[joint.upper].append(joint)
            if joint.lower is not None:
                self._over[joint.lower].append(joint)
        self._linked: dict[str, set[str]] = defaultdict(set)
        for pair in self._sides:
            first, second = pair
            self._linked[first].add(second)
            self._linked[second].add(first)
        for joint in self._joints:
            if joint.lower is not None:
                self._linked[joint.lower].add(joint.upper)
                self._linked[joint.upper].add(joint.lower)
        self._whole_regions = resting_regions(self.bricks, self._joints)
        self._regions: dict[Names, dict[str, Region]] = {}
        self._known: dict[Names, StabilityReport] = {}
        self.programs = 0
        """Number of linear programs solved so far."""

    def above(self, names: Names, name: str) -> tuple[str, ...]:
        """Return the bricks of a partial structure that sit on a brick."""
        return tuple(j.upper for j in self._over[name] if j.upper in names)

    def below(self, names: Names, name: str) -> tuple[str | None, ...]:
        """Return the bricks of a partial structure under a brick, None for the plate."""
        return tuple(
            j.lower for j in self._under[name] if j.lower is None or j.lower in names
        )

    def standing(self, names: Names) -> StabilityReport:
        """Return whether a partial structure stands by itself."""
        regions = self._regions_of(names)
        doubtful = {n for n in names if not contains(regions[n], self._middle(n))}
        worst = _AT_REST
        while doubtful:
            start = min(doubtful)
            component = self._component(names, start)
            report = self._component_stands(component, component & doubtful)
            if report.score > worst.score:
                worst = report
            if not report.stable:
                return report
            doubtful -= component
        return worst

    def pressed(
        self,
        names: Names,
        brick: str,
        loads: Sequence[Load],
        holds: Sequence[Hold] = (),
    ) -> StabilityReport:
        """Return whether a partial structure bears a brick being pressed into place.

        The brick's own joints do not hold yet. Parts of the structure that it does not touch
        are taken to stand.

        Args:
            names: the partial structure with the brick.
            brick: the brick that is pressed.
            loads: the pressing forces on it.
            holds: supporting tools.
        """
        down = sum(-load.force[2] for load in loads)
        if down > 0 and not holds and self._goes_through(names, brick, loads, down):
            return self.standing(names - {brick})
        if down > 0 and self._tips(names, brick, loads, down):
            return StabilityReport(False, math.inf, brick)
        component = self._component(names, brick)
        regions = self._regions_of(names)
        seeds = {n for n in component if not contains(regions[n], self._middle(n))}
        seeds |= {brick, *(hold.brick for hold in holds)}
        small = self._closure(names, seeds)
        component |= small
        report = self._solve(small, brick, loads, holds)
        if report.stable or small == component:
            return report
        return self._solve(component, brick, loads, holds)

    def _solve(
        self, names: Names, brick: str, loads: Sequence[Load], holds: Sequence[Hold]
    ) -> StabilityReport:
        self.programs += 1
        return stability(
            self._select(names),
            loads=loads,
            holds=holds,
            loose=frozenset((brick,)),
            strength=self._strength,
            limit=self._limit,
        )

    def _component_stands(self, component: Names, doubtful: Names) -> StabilityReport:
        small = self._closure(component, doubtful)
        report = self._stands(small)
        if report.stable or small == component:
            return report
        return self._stands(component)

    def _stands(self, names: Names) -> StabilityReport:
        known = self._known.get(names)
        if known is None:
            self.programs += 1
            known = stability(
                self._select(names), strength=self._strength, limit=self._limit
            )
            self._known[names] = known
        return known

    def _goes_through(
        self, names: Names, brick: str, loads: Sequence[Load], down: float
    ) -> bool:
        """Return True when load and weight go down to the plate by pushing alone."""
        point = self._resultant(brick, loads, down)
        return contains(self._regions_of(names)[brick], point)

    def _tips(
        self, names: Names, brick: str, loads: Sequence[Load], down: float
    ) -> bool:
        """Return True when a loose brick must tip over the edge of what is below it."""
        if any(
            other in names
            for pair in self._sides
            if brick in pair
            for other in pair - {brick}
        ):
            return False
        item = self.bricks[brick]
        contacts = [
            (float(x), float(y))
            for joint in self._under[brick]
            if joint.lower is None or joint.lower in names
            for stud in joint.studs
            for x, y in knob_points(item, stud)
        ]
        return not contains(convex_hull(contacts), self._resultant(brick, loads, down))

    def _resultant(
        self, brick: str, loads: Sequence[Load], down: float
    ) -> tuple[float, float]:
        """Return where the sum of vertical loads and weight acts [studs]."""
        weight = self.bricks[brick].brick.mass * STANDARD_GRAVITY
        middle = self._middle(brick)
        x, y = (
            (
                sum(-load.force[2] * load.point[k] / STUD_PITCH for load in loads)
                + weight * middle[k]
            )
            / (down + weight)
            for k in (0, 1)
        )
        return x, y

    def _regions_of(self, names: Names) -> dict[str, Region]:
        """Return the resting regions in a partial structure, those of the whole if they hold.

        A brick's region depends only on the bricks it stands on, so it changes only when a
        brick is missing below one that is there.
        """
        if not any(
            joint.upper in names
            and joint.lower is not None
            and joint.lower not in names
            for joint in self._joints
        ):
            return self._whole_regions
        known = self._regions.get(names)
        if known is None:
            inner = [
                j
                for j in self._joints
                if j.upper in names and (j.lower is None or j.lower in names)
            ]
            known = resting_regions({n: self.bricks[n] for n in names}, inner)
            self._regions[names] = known
        return known

    def _component(self, names: Names, start: str) -> Names:
        """Return the bricks that touch a brick through others."""
        found = {start}
        front = [start]
        while front:
            for other in self._linked[front.pop()]:
                if other in names and other not in found:
                    found.add(other)
                    front.append(other)
        return frozenset(found)

    def _closure(self, names: Names, seeds: Iterable[str]) -> Names:
        """Return bricks and all that they stand on; a hanging one brings what it hangs from."""
        found = set(seeds)
        front = sorted(found)
        while front:
            name = front.pop()
            below = self.below(names, name)
            more = below or self.above(names, name)
            for other in more:
                if other is not None and other not in found:
                    found.add(other)
                    front.append(other)
        return frozenset(found)

    def _select(self, names: Names) -> list[PlacedBrick]:
        return [item for name, item in self.bricks.items() if name in names]

    def _middle(self, name: str) -> tuple[float, float]:
        x, y, _ = centre(self.bricks[name])
        return float(x), float(y)
