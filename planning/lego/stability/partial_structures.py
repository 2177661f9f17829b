"""Stability of the partial structures of one design, with results shared between them.

A sequence search asks thousands of times about structures that differ by a brick. Most bricks
rest by pushing alone (``compression``) and are left out; the others are judged in the smallest
surroundings that settle the matter, growing from a brick and what it stands on:

- enough: let bricks outside take pushes only, where they pass them on by pushing. Forces in
  balance inside, added to the push-only forces of everything outside, are forces in balance of
  the whole, so the score inside bounds that of the whole from above.
- too much: let bricks outside be as immovable as the plate. Forces in balance of the whole are
  also in balance inside, so the score inside bounds that of the whole from below.

When the surroundings have grown to everything that touches, both are the score itself.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planning.lego.bricks.assembly import STUD_PITCH, PlacedBrick
from planning.lego.bricks.contacts import (
    Joint,
    SideContact,
    by_name,
    centre,
    filled_places,
    joints,
    knob_points,
    side_contacts,
    stud_height,
)
from planning.lego.stability.compression import Region, contains, resting_regions
from planning.lego.stability.equilibrium import Equilibrium, StabilityReport
from planning.lego.stability.stability import (
    STANDARD_GRAVITY,
    Hold,
    JointStrength,
    Load,
    add_joint,
    add_loads,
    add_side,
    bodies,
)

Names = frozenset[str]

_AT_REST = StabilityReport(0.0, None)
_UP = np.array([0.0, 0.0, 1.0])

_STRENGTH = JointStrength()
_SMALL = 40
"""Up to so many bricks that touch each other are at once judged together."""


@dataclass(frozen=True)
class _Pressing:
    """A brick being pressed into place, with the supporting tools."""

    brick: str
    loads: tuple[Load, ...]
    holds: tuple[Hold, ...]


class PartialStructures:
    """Stability of every partial structure of a design, by the names of its bricks.

    Args:
        design: all bricks, scaffolding included.
    """

    def __init__(self, design: Iterable[PlacedBrick]) -> None:
        self.bricks = by_name(design)
        self.filled = filled_places(self.bricks)
        """The brick in each place of the grid."""
        self._joints = joints(self.bricks, self.filled)
        self._under: dict[str, list[Joint]] = defaultdict(list)
        self._over: dict[str, list[Joint]] = defaultdict(list)
        self._beside: dict[str, list[SideContact]] = defaultdict(list)
        self._linked: dict[str, set[str]] = defaultdict(set)
        for joint in self._joints:
            self._under[joint.upper].append(joint)
            if joint.lower is not None:
                self._over[joint.lower].append(joint)
                self._linked[joint.lower].add(joint.upper)
                self._linked[joint.upper].add(joint.lower)
        for side in side_contacts(self.bricks, self.filled):
            self._beside[side.first].append(side)
            self._beside[side.second].append(side)
            self._linked[side.first].add(side.second)
            self._linked[side.second].add(side.first)
        self._middle = {
            name: (float(x), float(y))
            for name, item in self.bricks.items()
            for x, y, _ in [centre(item)]
        }
        self._whole_regions = resting_regions(self.bricks, self._joints)
        self._regions: dict[Names, dict[str, Region]] = {}
        self._standing: dict[Names, StabilityReport] = {}
        self._solved: dict[object, StabilityReport] = {}
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
        """Tell whether a partial structure stands by itself.

        The score is a bound, from above when the structure is stable, else from below.
        """
        known = self._standing.get(names)
        if known is None:
            known = self._standing[names] = self._judge(names, None)
        return known

    def pressed(
        self,
        names: Names,
        brick: str,
        loads: Sequence[Load],
        holds: Sequence[Hold] = (),
    ) -> StabilityReport:
        """Tell whether a partial structure bears a brick being pressed into place.

        The brick's own joints push but do not pull yet.

        Args:
            names: the partial structure with the brick.
            brick: the brick that is pressed.
            loads: the pressing forces, vertical and on this brick.
            holds: supporting tools.
        """
        if not holds and self._goes_through(names, brick, loads):
            return self.standing(names - {brick})
        return self._judge(names, _Pressing(brick, tuple(loads), tuple(holds)))

    def _judge(self, names: Names, pressing: _Pressing | None) -> StabilityReport:
        """Judge every set of bricks that does not rest by pushing alone."""
        regions = self._regions_of(names)
        open_sets = [
            self._with_below(names, {name})
            for name in sorted(names)
            if not contains(regions[name], self._middle[name])
        ]
        if pressing is not None:
            handled = {pressing.brick, *(hold.brick for hold in pressing.holds)}
            handled.update(self.above(names, pressing.brick))
            open_sets.append(self._with_below(names, handled))
        worst = _AT_REST
        settled: list[tuple[Names, float]] = []
        while open_sets:
            inside = open_sets.pop()
            while True:
                # Sets that share a brick share joints: they are judged together.
                inside, open_sets = _absorb(inside, open_sets)
                inside, kept = _absorb(inside, [s for s, _ in settled])
                settled = [(s, v) for s, v in settled if s in kept]
                enough = self._solve(names, inside, pressing, outside_pushes=True)
                if enough.stable:
                    settled.append((inside, enough.score))
                    worst = max(worst, enough, key=lambda report: report.score)
                    break
                grown = self._component(names, inside)
                if len(grown) > _SMALL:
                    grown = inside | self._next_to(names, inside)
                needed = self._solve(names, inside, pressing, outside_pushes=False)
                if not needed.stable or grown == inside:
                    return needed
                inside = grown
        return worst

    def _solve(
        self,
        names: Names,
        inside: Names,
        pressing: _Pressing | None,
        *,
        outside_pushes: bool,
    ) -> StabilityReport:
        """Return the score of some bricks with those around them as border.

        With ``outside_pushes`` bricks outside take pushes only, else they are as immovable as
        the plate.
        """
        if pressing is not None and pressing.brick not in inside:
            pressing = None
        regions = self._regions_of(names)
        border = self._next_to(names, inside)
        rest: object = border
        if outside_pushes:
            rest = tuple((name, regions[name]) for name in sorted(border))
        key = (inside, rest, pressing)
        known = self._solved.get(key)
        if known is None:
            self.programs += 1
            program = bodies(
                item for name, item in self.bricks.items() if name in inside
            )
            loose = None if pressing is None else pressing.brick
            for joint in self._joints_of(inside):
                outer = joint.lower in border or joint.upper in border
                if outer and outside_pushes:
                    if joint.upper in inside and joint.lower is not None:
                        self._add_rest(program, joint, regions[joint.lower])
                elif joint.upper in names and (
                    joint.lower is None or joint.lower in names
                ):
                    upper = self.bricks[joint.upper]
                    pressed = loose in (joint.lower, joint.upper) and loose is not None
                    pull = 0.0 if pressed else _STRENGTH.pull(upper)
                    sideways = _STRENGTH.sideways
                    add_joint(program, joint, upper, pull, sideways, fixed=border)
            for side in self._sides_of(inside):
                both = {side.first, side.second}
                if both <= inside or (both <= names and not outside_pushes):
                    add_side(program, side, fixed=border)
            if pressing is not None:
                add_loads(program, pressing.loads, pressing.holds)
            known = self._solved[key] = program.solve(blame=not outside_pushes)
        return known

    def _add_rest(self, program: Equilibrium, joint: Joint, region: Region) -> None:
        """Add the contacts of a joint whose lower brick passes pushes on to the plate."""
        for stud in joint.studs:
            for x, y in knob_points(self.bricks[joint.upper], stud):
                if contains(region, (float(x), float(y))):
                    point = np.array([x, y, stud_height(joint.level)])
                    program.add_contact(None, joint.upper, point, _UP)

    def _joints_of(self, inside: Names) -> Iterator[Joint]:
        for name in self.bricks:
            if name in inside:
                yield from self._under[name]
                yield from (j for j in self._over[name] if j.upper not in inside)

    def _sides_of(self, inside: Names) -> Iterator[SideContact]:
        for name in self.bricks:
            if name in inside:
                for side in self._beside[name]:
                    other = side.first if side.second == name else side.second
                    if other not in inside or side.first == name:
                        yield side

    def _with_below(self, names: Names, some: set[str]) -> Names:
        """Return bricks and what they stand on; what they hang from where that is nothing."""
        found = set(some)
        for name in some:
            around = self.below(names, name) or self.above(names, name)
            found.update(n for n in around if n is not None)
        return frozenset(found)

    def _next_to(self, names: Names, inside: Names) -> Names:
        """Return the bricks outside that touch those inside."""
        around = {other for name in inside for other in self._linked[name]}
        return frozenset(around & names) - inside

    def _goes_through(self, names: Names, brick: str, loads: Sequence[Load]) -> bool:
        """Return True when pressing and weight go down to the plate by pushing alone."""
        if any(load.force[2] > 0.0 for load in loads):
            return False
        weight = self.bricks[brick].brick.mass * STANDARD_GRAVITY
        total = weight - sum(load.force[2] for load in loads)
        x, y = (
            (
                weight * self._middle[brick][k]
                - sum(load.force[2] * load.point[k] / STUD_PITCH for load in loads)
            )
            / total
            for k in (0, 1)
        )
        return contains(self._regions_of(names)[brick], (x, y))

    def _regions_of(self, names: Names) -> dict[str, Region]:
        """Return the resting regions in a partial structure, those of the whole if they hold.

        A brick's region depends only on the bricks it stands on, so it changes only when a
        brick is missing below one that is there.
        """
        known = self._regions.get(names)
        if known is None:
            inner = [
                j
                for j in self._joints
                if j.upper in names and (j.lower is None or j.lower in names)
            ]
            if len(inner) == sum(j.upper in names for j in self._joints):
                known = self._whole_regions
            else:
                known = resting_regions({n: self.bricks[n] for n in names}, inner)
            self._regions[names] = known
        return known

    def _component(self, names: Names, start: Names) -> Names:
        """Return the bricks that touch these, directly or through others."""
        found = start
        while new := self._next_to(names, found):
            found |= new
        return found


def _absorb(inside: Names, others: Sequence[Names]) -> tuple[Names, list[Names]]:
    """Join a set with all others that share an element with it, directly or through others."""
    apart = list(others)
    while True:
        meeting = [s for s in apart if not inside.isdisjoint(s)]
        if not meeting:
            return inside, apart
        # Before the union: sets that meet only those that join now are next, not gone.
        apart = [s for s in apart if inside.isdisjoint(s)]
        inside = inside.union(*meeting)
