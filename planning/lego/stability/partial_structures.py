"""Stability of the partial structures of one design: which stand, and what pressing they bear.

A sequence search asks thousands of times about structures that differ by a brick. Where bricks
rest by pushing alone (``compression``) no program is needed; the others are judged by one linear
program that is changed from one structure to the next (``planning.statics.equilibrium``).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

from planning.lego.bricks.assembly import STUD_PITCH, PlacedBrick
from planning.lego.bricks.contacts import (
    Joint,
    by_name,
    centre,
    filled_places,
    joints,
    knob_points,
    side_contacts,
)
from planning.lego.stability.compression import Region, contains, resting_region
from planning.lego.stability.stability import (
    Hold,
    JointStrength,
    Load,
    face_contacts,
    joint_contacts,
    spread_force,
    tool_push,
)
from planning.statics.equilibrium import (
    ENOUGH,
    STANDARD_GRAVITY,
    Equilibrium,
    LoadCase,
    StabilityReport,
)

Names = frozenset[str]

_STRENGTH = JointStrength()


@dataclass(frozen=True)
class Bearing:
    """Share of the force that presses a brick on which the structure bears.

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
        self.bricks = by_name(design)
        self.filled = filled_places(self.bricks)
        """The brick in each place of the grid."""
        between = joints(self.bricks, self.filled)
        self._under: dict[str, list[Joint]] = defaultdict(list)
        self._over: dict[str, list[Joint]] = defaultdict(list)
        for joint in between:
            self._under[joint.upper].append(joint)
            if joint.lower is not None:
                self._over[joint.lower].append(joint)
        self._middle = {
            name: (float(x), float(y))
            for name, item in self.bricks.items()
            for x, y, _ in [centre(item)]
        }
        sides = side_contacts(self.bricks, self.filled)
        self._contacts = (
            *(
                contact
                for joint in between
                for contact in joint_contacts(
                    joint, self.bricks[joint.upper], _STRENGTH
                )
            ),
            *chain.from_iterable(map(face_contacts, sides)),
        )
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
        """The program in studs, made when it is asked for: many structures rest by pushing alone."""
        bricks = self.bricks
        return Equilibrium(
            {name: centre(item) for name, item in bricks.items()},
            {name: i.brick.mass * STANDARD_GRAVITY for name, i in bricks.items()},
            self._contacts,
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
        """Return the friction of all contacts between a brick and others on or under it [N]."""
        some, total = set(others), 0.0
        for joint in (*self._under[name], *self._over[name]):
            if (joint.lower if joint.upper == name else joint.upper) in some:
                upper = self.bricks[joint.upper]
                contacts = sum(len(knob_points(upper, stud)) for stud in joint.studs)
                total += contacts * _STRENGTH.pull(upper)
        return total

    def stands(self, names: Names) -> bool:
        """Tell whether a partial structure stands by itself."""
        known = self._standing.get(names)
        if known is None:
            regions = self._regions_of(names)
            known = all(contains(regions[n], self._middle[n]) for n in names)
            known = known or self._program.bears(LoadCase(names)) >= 0.0
            self._standing[names] = known
        return known

    def pressed(self, names: Names, load: Load, holds: Sequence[Hold] = ()) -> Bearing:
        """Tell whether a partial structure bears a brick being pressed into place.

        The brick's own joints push but do not pull yet.

        Args:
            names: the partial structure with the brick.
            load: the pressing force, vertical.
            holds: supporting tools.
        """
        needed = abs(load.force[2])
        if not holds and self._goes_through(names, load):
            stands = self.stands(names - {load.brick})
            return Bearing(needed, needed if stands else -1.0)
        return Bearing(needed, self._program.bears(_case(names, load, holds)))

    def could_bear(
        self, names: Names, load: Load, holds: Sequence[Hold] = ()
    ) -> Bearing:
        """Tell whether a structure or any part of it, however heavy, might bear a press.

        The bricks are taken as weightless, so that those that a partial structure lacks do no
        harm: what is not borne here is borne by no partial structure.
        """
        needed = abs(load.force[2])
        if self._goes_through(names, load):
            return Bearing(needed, needed)
        case = replace(_case(names, load, holds), weighing=())
        return Bearing(needed, self._program.bears(case))

    def weakness(
        self, names: Names, load: Load | None = None, holds: Sequence[Hold] = ()
    ) -> StabilityReport:
        """Return how much friction a partial structure needs, and where it gives way first."""
        return self._program.least_pull(_case(names, load, holds))

    def _goes_through(self, names: Names, load: Load) -> bool:
        """Return True when pressing and weight go down to the plate by pushing alone."""
        if load.force[2] > 0.0:
            return False
        push = -load.force[2]
        weight = self.bricks[load.brick].brick.mass * STANDARD_GRAVITY
        region = self._regions_of(names)[load.brick]
        mx, my = self._middle[load.brick]
        for px, py, _ in load.points:
            x = (weight * mx + push * px / STUD_PITCH) / (weight + push)
            y = (weight * my + push * py / STUD_PITCH) / (weight + push)
            if contains(region, (x, y)):
                return True
        return False

    def _regions_of(self, names: Names) -> dict[str, Region]:
        """Return where pushes on the bricks of a partial structure go through to the plate.

        A brick's region depends only on the bricks that it stands on, so few are worked out anew
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
                    region = resting_region(self.bricks[name], under, known)
                    shape = self._shapes[key] = (len(self._shapes), region)
                number[name], known[name] = shape
        return known


def _case(names: Names, load: Load | None, holds: Sequence[Hold]) -> LoadCase:
    """Return bricks under a press, whose own joints push but do not pull yet, as a load case."""
    pushes = tuple(map(tool_push, holds))
    if load is None:
        return LoadCase(names, pushes=pushes)
    spread = spread_force(load)
    return LoadCase(names, loose=load.brick, pushes=pushes, load=spread)
