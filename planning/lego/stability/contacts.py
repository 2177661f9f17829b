"""Contacts between the bricks of a structure and the forces that they bear (StableLego, Liu et al. 2024).

Walls and tubes of the upper brick hold a knob of the lower brick. A brick that is at least two studs wide touches the
knob at three points. A brick one stud wide has bars instead of tubes, and touches it at four points. The pressing
force at a point is unlimited; the pulling force is limited by friction, and the sideways force is limited, too.
Neighbours in a layer push each other. The score s of a structure is the greatest ratio of friction to its capacity T.
It follows from a linear program over the contact forces f, where A f = -w is the equilibrium of forces and torques
under the weights w, and S is the limit of sideways forces:

    minimise s  subject to  A f = -w,  f_knob >= -s T,  |f_sideways| <= S,  f_neighbour >= 0

A structure with score 0 is stable without friction. With a score up to 1 it is stable; with a greater one it
collapses. Lengths are in studs, in the frame of the plate, whose origin is its corner. Only lengths of tools are in
metres.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import product

import numpy as np

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import (
    BRICK_LEVELS,
    LAYER_HEIGHT,
    STUD_PITCH,
    GridPlace,
    PlacedBrick,
)
from planning.statics.equilibrium import ContactForce, Load, Vector
from planning.transforms import Array

_CONTACT_RADIUS = 0.25
"""Distance of the contacts from the axis of a knob, as in StableLego [studs]."""

_LAYER = LAYER_HEIGHT / STUD_PITCH
"""Height of a layer [studs]."""

UP = (0.0, 0.0, 1.0)
LEVEL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


@dataclass(frozen=True)
class KnobJoint:
    """Two bricks, one on the other, or one on the plate.

    Attributes:
        lower: name of the lower brick, None for the plate.
        upper: name of the upper brick.
        studs: the knobs (x, y) in the upper brick's cavity, sorted.
    """

    lower: str | None
    upper: str
    studs: tuple[tuple[int, int], ...]


def bricks_by_name(structure: Iterable[PlacedBrick]) -> dict[str, PlacedBrick]:
    """Return the bricks of a structure by name.

    Raises:
        ScenarioError: two bricks have one name, or one lies below the first layer.
    """
    out: dict[str, PlacedBrick] = {}
    for item in structure:
        if item.name in out:
            raise ScenarioError(f"two bricks of the structure are called {item.name!r}")
        if item.cell.level < 0:
            raise ScenarioError(
                f"brick {item.name!r} is in layer {item.cell.z}; the first layer is 1"
            )
        out[item.name] = item
    return out


def filled_places(bricks: Mapping[str, PlacedBrick]) -> dict[GridPlace, str]:
    """Return which brick fills each place of the grid.

    Raises:
        ScenarioError: two bricks fill the same place.
    """
    filled: dict[GridPlace, str] = {}
    for name, item in bricks.items():
        for place in item.places:
            other = filled.setdefault(place, name)
            if other != name:
                raise ScenarioError(f"bricks {other!r} and {name!r} overlap")
    return filled


def _stud_height(level: float) -> float:
    """Return the height of a level above the plate [studs]."""
    return level / BRICK_LEVELS * _LAYER


def find_joints(
    bricks: Mapping[str, PlacedBrick], filled: Mapping[GridPlace, str]
) -> tuple[KnobJoint, ...]:
    """Return the joints of a structure, the plate's included, in the order of the bricks."""
    out = []
    for name, item in bricks.items():
        below: dict[str | None, list[tuple[int, int]]] = defaultdict(list)
        level = item.cell.level
        for x, y in sorted(item.studs):
            if level == 0:
                below[None].append((x, y))
            elif (lower := filled.get((x, y, level - 1))) is not None and (
                (x, y) in bricks[lower].knobs
            ):
                below[lower].append((x, y))
        out += [KnobJoint(k, name, tuple(v)) for k, v in below.items()]
    return tuple(out)


def side_contacts(
    bricks: Mapping[str, PlacedBrick], filled: Mapping[GridPlace, str]
) -> Iterator[ContactForce]:
    """Yield the contacts of bricks side by side, the corners of their common faces, in studs.

    They are in the order of the bricks; the second of two is the one of greater x, or y.
    """
    for name, item in bricks.items():
        x0, x1, y0, y1, *heights = item.span
        xs, ys, levels = range(x0, x1), range(y0, y1), range(*heights)
        beyond = [((x1, j, k), 0) for j, k in product(ys, levels)]
        beyond += [((i, y1, k), 1) for i, k in product(xs, levels)]
        for other, axis in dict.fromkeys((filled.get(p), axis) for p, axis in beyond):
            if other is None:
                continue
            face = item.span.shared(bricks[other].span)
            across = (
                dict.fromkeys((face.x0, face.x1)),
                dict.fromkeys((face.y0, face.y1)),
            )
            for x, y, level in product(*across, (face.bottom, face.top)):
                at = (float(x), float(y), _stud_height(level))
                yield ContactForce(name, other, at, LEVEL[axis])


def brick_centre(item: PlacedBrick) -> Array:
    """Return a brick's centre of mass, taken as that of its box, shape (3,) [studs]."""
    nx, ny = item.span.size
    cell = item.cell
    middle = _stud_height(cell.level + item.brick.height / 2)
    return np.array([cell.x + nx / 2, cell.y + ny / 2, middle])


def knob_points(upper: PlacedBrick, stud: tuple[int, int]) -> Array:
    """Return where a brick's cavity holds the knob on a stud (x, y), shape (3 or 4, 2) [studs]."""
    i, j = stud[0] - upper.cell.x, stud[1] - upper.cell.y
    offsets = _cavity(*upper.span.size, i, j)
    points: Array = offsets + np.array([stud[0] + 0.5, stud[1] + 0.5])
    return points


@lru_cache(maxsize=1024)
def _cavity(nx: int, ny: int, i: int, j: int) -> Array:
    """Return the contacts of a knob in place (i, j) of an nx x ny cavity, about its axis."""
    points: list[tuple[float, float]] = []
    diagonal = _CONTACT_RADIUS / np.sqrt(2.0)
    for sign in (-1, 1):
        # A brick of one stud's width has bars across it between the knobs, no tubes.
        if (i == 0 if sign < 0 else i == nx - 1) or ny == 1:
            points.append((sign * _CONTACT_RADIUS, 0.0))
        if (j == 0 if sign < 0 else j == ny - 1) or nx == 1:
            points.append((0.0, sign * _CONTACT_RADIUS))
        for other in (-1, 1):
            if 0 < i + (sign > 0) < nx and 0 < j + (other > 0) < ny:
                points.append((sign * diagonal, other * diagonal))
    out = np.array(points, dtype=np.float64)
    out.setflags(write=False)
    return out


@dataclass(frozen=True)
class JointStrength:
    """Strength of a joint between LEGO bricks; plates are assumed to hold as bricks do.

    Attributes:
        narrow_pull: friction T of one of the four contacts of a knob in a brick of one stud's
            width [N]. The figure published with StableLego, 100 gram-force.
        wide_pull: friction T of one of the three contacts in a wider brick [N]. Set so that
            stairs of 19 2x4 bricks stand and stairs of 20 collapse, as published there; any
            figure from 0.80 to 0.89 does. (StableLego has 0.98 N here too, but shifts all three
            contacts to one side, which makes mirrored structures unequal.)
        sideways: force S that a knob bears along each of x and y [N]; an assumption, far above
            what gravity asks for.
    """

    narrow_pull: float = 0.98
    wide_pull: float = 0.85
    sideways: float = 20.0

    def pull(self, upper: PlacedBrick) -> float:
        """Return the friction T of a contact in a brick's cavity [N]."""
        narrow = min(upper.brick.studs) == 1
        return self.narrow_pull if narrow else self.wide_pull


@dataclass(frozen=True)
class ToolHold:
    """Contact of a standing tool with a brick: it pushes back, it does not pull.

    Attributes:
        brick: name of the brick.
        direction: of the push on the brick, +1 up or -1 down.
        point: where it acts, in the plate's frame with the plate's corner as origin [m].
    """

    brick: str
    direction: int
    point: tuple[float, float, float]


def joint_contacts(
    joint: KnobJoint, upper: PlacedBrick, strength: JointStrength
) -> Iterator[ContactForce]:
    """Yield the contacts of a joint with its upper brick in studs, knob by knob."""
    ends, height = (joint.lower, joint.upper), _stud_height(upper.cell.level)
    pull, sideways = strength.pull(upper), strength.sideways
    for stud in joint.studs:
        for x, y in knob_points(upper, stud).tolist():
            yield ContactForce(*ends, (x, y, height), UP, pull)
        axis = (stud[0] + 0.5, stud[1] + 0.5, height)
        for direction in LEVEL:
            yield ContactForce(*ends, axis, direction, within=sideways)


def load_in_studs(load: Load) -> Load:
    """Return a tool load for the equilibrium program, in studs."""
    return replace(load, points=tuple(map(_in_studs, load.points)))


@cache
def tool_push(hold: ToolHold) -> ContactForce:
    """Return the push of a standing tool for the equilibrium program, in studs."""
    up = (0.0, 0.0, float(hold.direction))
    return ContactForce(None, hold.brick, _in_studs(hold.point), up)


def _in_studs(point: Vector) -> Vector:
    x, y, z = point
    return x / STUD_PITCH, y / STUD_PITCH, z / STUD_PITCH
