"""Stability of the partial structures of one design: which are stable, and which presses they bear.

A sequence search queries thousands of structures that differ by one brick. Many need no linear program: a downward
force on a brick is carried if its point lies in the convex hull of contacts below that are themselves carried, down
to the plate. Such forces need no friction, and compression is unlimited. If all bricks rest in this way, the score of
the structure (see ``contacts``) is 0. A press on such a brick, or one more such brick, does not raise the score of
any structure. All other structures are checked by one linear program, which is updated from one structure to the next
(``planning.statics.equilibrium``).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

from scipy.spatial import ConvexHull, QhullError

from planning.lego.bricks.assembly import STUD_PITCH, PlacedBrick
from planning.lego.stability.contacts import (
    JointStrength,
    KnobJoint,
    ToolHold,
    brick_centre,
    bricks_by_name,
    filled_places,
    find_joints,
    joint_contacts,
    knob_points,
    load_in_studs,
    side_contacts,
    tool_push,
)
from planning.statics.equilibrium import (
    ENOUGH,
    STANDARD_GRAVITY,
    Equilibrium,
    Load,
    LoadCase,
    StabilityReport,
)

Point = tuple[float, float]
Region = tuple[Point, ...]
"""Corners of a convex polygon, counter-clockwise; fewer than three where it has no area."""

_EPS = 1e-9
"""Points as near as this are the same [studs], areas as small are none."""

Names = frozenset[str]

_STRENGTH = JointStrength()


def _resting_region(
    item: PlacedBrick, joints: Iterable[KnobJoint], regions: Mapping[str, Region]
) -> Region:
    """Return the region of a brick in which a push is carried straight down to the plate.

    Given are the joints with what it stands on, and the regions of that.

    Returns:
        A convex region in the plate's plane [studs], empty for a brick that rests on nothing.
    """
    points = [
        (float(x), float(y))
        for joint in joints
        for stud in joint.studs
        for x, y in knob_points(item, stud)
        if joint.lower is None or _contains_point(regions[joint.lower], (x, y))
    ]
    return convex_hull(points)


def _contains_point(region: Region, point: Point) -> bool:
    """Return True when a point lies in a convex region or on its edge."""
    if not region:
        return False
    for k in (0, 1):
        along = [corner[k] for corner in region]
        if not min(along) - _EPS <= point[k] <= max(along) + _EPS:
            return False
    edges = zip(region, (*region[1:], region[0]), strict=True)
    return all(_cross(a, b, point) >= -_EPS for a, b in edges)


def convex_hull(points: Collection[Point]) -> Region:
    """Return the convex hull of points in the plane, counter-clockwise."""
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return tuple(ordered)
    try:
        corners = ConvexHull(ordered).vertices
    except QhullError:  # all on one line
        return ordered[0], ordered[-1]
    return tuple(ordered[int(k)] for k in corners)


def _cross(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@dataclass(frozen=True)
class PressBearing:
    """Required press force, and the force that the structure bears.

    Attributes:
        needed: the force [N].
        bears: the largest force that it bears, up to ``needed`` [N]; -1 where it does not even
            stand.
    """

    needed: float
    bears: float

    @property
    def stable(self) -> bool:
        """True when it bears the force."""
        return self.bears >= self.needed - ENOUGH


class PartialStructures:
    """Stability of every partial structure of a design, by the names of its bricks.

    Args:
        design: all bricks, scaffolding included.
    """

    def __init__(self, design: Iterable[PlacedBrick]) -> None:
        self.bricks = bricks_by_name(design)
        self.filled = filled_places(self.bricks)
        """The brick in each place of the grid."""
        self._joints = find_joints(self.bricks, self.filled)
        self._under: dict[str, list[KnobJoint]] = defaultdict(list)
        self._over: dict[str, list[KnobJoint]] = defaultdict(list)
        for joint in self._joints:
            self._under[joint.upper].append(joint)
            if joint.lower is not None:
                self._over[joint.lower].append(joint)
        self._middle = {
            name: (float(x), float(y))
            for name, item in self.bricks.items()
            for x, y, _ in [brick_centre(item)]
        }
        self._from_low = sorted(self.bricks, key=lambda n: self.bricks[n].cell.level)
        self._shapes: dict[object, tuple[int, Region]] = {}
        self._regions: dict[Names, dict[str, Region]] = {}
        self._standing: dict[Names, bool] = {}

    @property
    def programs(self) -> int:
        """Number of linear programs solved so far."""
        return self._program.solved if "_program" in self.__dict__ else 0

    @cached_property
    def _program(self) -> Equilibrium:
        """The program in studs, created on first use: many structures rest on compression alone."""
        bricks = self.bricks
        knobs = (joint_contacts(j, bricks[j.upper], _STRENGTH) for j in self._joints)
        return Equilibrium(
            {name: brick_centre(item) for name, item in bricks.items()},
            {name: i.brick.mass * STANDARD_GRAVITY for name, i in bricks.items()},
            [*chain.from_iterable(knobs), *side_contacts(bricks, self.filled)],
        )

    def above(self, names: Names, name: str) -> tuple[str, ...]:
        """Return the bricks of a partial structure that sit on a brick."""
        return tuple(j.upper for j in self._over[name] if j.upper in names)

    def below(self, names: Names, name: str) -> tuple[str | None, ...]:
        """Return the bricks of a partial structure under a brick, None for the plate."""
        return tuple(
            j.lower for j in self._under[name] if j.lower is None or j.lower in names
        )

    def engaged(self, name: str, others: Iterable[str | None]) -> float:
        """Return the total friction of the contacts between a brick and others on or under it [N]."""
        some, total = set(others), 0.0
        for joint in (*self._under[name], *self._over[name]):
            if (joint.lower if joint.upper == name else joint.upper) in some:
                upper = self.bricks[joint.upper]
                contacts = sum(len(knob_points(upper, stud)) for stud in joint.studs)
                total += contacts * _STRENGTH.pull(upper)
        return total

    def stands(self, names: Names) -> bool:
        """Tell whether a partial structure is stable without help."""
        known = self._standing.get(names)
        if known is None:
            regions = self._regions_of(names)
            known = all(_contains_point(regions[n], self._middle[n]) for n in names)
            known = known or self._program.bears(LoadCase(names)) >= 0.0
            self._standing[names] = known
        return known

    def pressed(
        self, names: Names, load: Load, holds: Sequence[ToolHold] = ()
    ) -> PressBearing:
        """Tell whether a partial structure bears a brick being pressed into place, vertically.

        The brick is among the names; its own joints push but do not pull yet.
        """
        needed = abs(load.force[2])
        if not holds and self._is_carried_by_compression(names, load):
            stands = self.stands(names - {load.body})
            return PressBearing(needed, needed if stands else -1.0)
        return PressBearing(needed, self._program.bears(_case(names, load, holds)))

    def could_bear(
        self, names: Names, load: Load, holds: Sequence[ToolHold] = ()
    ) -> PressBearing:
        """Tell whether a structure or any part of it, however heavy, might bear a press.

        The bricks are taken as weightless, so that those that a partial structure lacks do no
        harm: what is not borne here is borne by no partial structure.
        """
        needed = abs(load.force[2])
        if self._is_carried_by_compression(names, load):
            return PressBearing(needed, needed)
        case = replace(_case(names, load, holds), weighing=())
        return PressBearing(needed, self._program.bears(case))

    def weakness(
        self, names: Names, load: Load | None = None, holds: Sequence[ToolHold] = ()
    ) -> StabilityReport:
        """Return the friction demand of a partial structure, and where it fails first."""
        return self._program.least_pull(_case(names, load, holds))

    def _is_carried_by_compression(self, names: Names, load: Load) -> bool:
        """Return True when press and weight are carried down to the plate by compression alone."""
        if load.force[2] > 0.0:
            return False
        push = -load.force[2]
        weight = self.bricks[load.body].brick.mass * STANDARD_GRAVITY
        region = self._regions_of(names)[load.body]
        mx, my = self._middle[load.body]
        for px, py, _ in load.points:
            x = (weight * mx + push * px / STUD_PITCH) / (weight + push)
            y = (weight * my + push * py / STUD_PITCH) / (weight + push)
            if _contains_point(region, (x, y)):
                return True
        return False

    def _regions_of(self, names: Names) -> dict[str, Region]:
        """Return the regions of bricks in a partial structure in which pushes are carried to the plate.

        A brick's region depends only on the bricks that it stands on, so few are computed again
        from one partial structure to the next.
        """
        known = self._regions.get(names)
        if known is None:
            known = self._regions[names] = {}
            number: dict[str | None, int] = {None: -1}
            for name in self._from_low:
                if name not in names:
                    continue
                under = [j for j in self._under[name] if j.lower in number]
                key = (name, tuple((j.lower, number[j.lower]) for j in under))
                shape = self._shapes.get(key)
                if shape is None:
                    region = _resting_region(self.bricks[name], under, known)
                    shape = self._shapes[key] = (len(self._shapes), region)
                number[name], known[name] = shape
        return known


def _case(names: Names, load: Load | None, holds: Sequence[ToolHold]) -> LoadCase:
    """Return the load case of bricks under a press, whose own joints push but do not pull yet."""
    pushes = tuple(map(tool_push, holds))
    if load is None:
        return LoadCase(names, pushes=pushes)
    spread = load_in_studs(load)
    return LoadCase(names, loose=load.body, pushes=pushes, load=spread)
