"""Contacts between the bricks of a structure: knobs in cavities, sides on sides.

A knob is held by the upper brick's walls and tubes: at three places in a brick two studs wide or
more, at four in a brick one stud wide, which has bars across it instead of tubes. As in
StableLego (Liu et al. 2024) the bricks push each other at the same places. All lengths here are
in studs, in the plate's frame with its corner as the origin.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import (
    BRICK_LEVELS,
    LAYER_HEIGHT,
    STUD_PITCH,
    PlacedBrick,
)
from planning.lego.bricks.grid import (
    Place,
    covered_studs,
    footprint,
    occupied_places,
    occupied_span,
)
from planning.transforms import Array

CONTACT_RADIUS = 0.25
"""Distance of the contacts from the axis of a knob, as in StableLego [studs]."""

LAYER = LAYER_HEIGHT / STUD_PITCH
"""Height of a layer [studs]."""


@dataclass(frozen=True)
class Joint:
    """Two bricks, one on the other, or one on the plate.

    Attributes:
        lower: name of the lower brick, None for the plate.
        upper: name of the upper brick.
        level: of the upper brick's bottom, where they meet.
        studs: the knobs (x, y) in the upper brick's cavity, sorted.
    """

    lower: str | None
    upper: str
    level: int
    studs: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class SideContact:
    """Two bricks side by side.

    Attributes:
        first: the brick of lesser x (or y).
        second: the brick of greater x (or y).
        axis: 0 when they touch across x, 1 across y.
        at: coordinate of the common face along ``axis``.
        span: least and greatest coordinate of the common face along the other axis.
        levels: least and greatest level of the common face.
    """

    first: str
    second: str
    axis: int
    at: int
    span: tuple[int, int]
    levels: tuple[int, int]


def by_name(structure: Iterable[PlacedBrick]) -> dict[str, PlacedBrick]:
    """Return the bricks of a structure by name.

    Raises:
        ScenarioError: two bricks have one name or fill the same place, or one lies below the
            first layer.
    """
    out: dict[str, PlacedBrick] = {}
    filled: dict[Place, str] = {}
    for item in structure:
        if item.name in out:
            raise ScenarioError(f"two bricks of the structure are called {item.name!r}")
        if item.cell.level < 0:
            raise ScenarioError(
                f"brick {item.name!r} is in layer {item.cell.z}; the first layer is 1"
            )
        out[item.name] = item
        for place in occupied_places(item.cell, item.brick):
            other = filled.setdefault(place, item.name)
            if other != item.name:
                raise ScenarioError(f"bricks {other!r} and {item.name!r} overlap")
    return out


def stud_height(level: float) -> float:
    """Return the height of a level above the plate [studs]."""
    return level / BRICK_LEVELS * LAYER


def is_narrow(item: PlacedBrick) -> bool:
    """Return True when a brick is one stud wide: four contacts a knob instead of three."""
    return min(item.brick.studs) == 1


def filled_places(bricks: Mapping[str, PlacedBrick]) -> dict[Place, str]:
    """Return which brick fills each place of the grid."""
    return {
        place: name
        for name, item in bricks.items()
        for place in occupied_places(item.cell, item.brick)
    }


def joints(
    bricks: Mapping[str, PlacedBrick], filled: Mapping[Place, str]
) -> tuple[Joint, ...]:
    """Return the joints of a structure, the plate's included, in the order of the bricks."""
    out = []
    for name, item in bricks.items():
        below: dict[str | None, list[tuple[int, int]]] = defaultdict(list)
        level = item.cell.level
        for x, y in sorted(covered_studs(item.cell, item.brick)):
            if level == 0:
                below[None].append((x, y))
            elif (lower := filled.get((x, y, level - 1))) is not None:
                below[lower].append((x, y))
        out += [Joint(k, name, level, tuple(v)) for k, v in below.items()]
    return tuple(out)


def side_contacts(
    bricks: Mapping[str, PlacedBrick], filled: Mapping[Place, str]
) -> tuple[SideContact, ...]:
    """Return the pairs of bricks that stand side by side, in the order of the bricks."""
    out = []
    for name, item in bricks.items():
        x0, x1, y0, y1, bottom, top = occupied_span(item.cell, item.brick)
        levels = range(bottom, top)
        faces: dict[tuple[str, int], list[int]] = defaultdict(list)
        for j, k in product(range(y0, y1), levels):
            if (other := filled.get((x1, j, k))) is not None:
                faces[other, 0].append(j)
        for i, k in product(range(x0, x1), levels):
            if (other := filled.get((i, y1, k))) is not None:
                faces[other, 1].append(i)
        for (other, axis), studs in faces.items():
            beside = occupied_span(bricks[other].cell, bricks[other].brick)
            shared = max(bottom, beside.bottom), min(top, beside.top)
            span = studs[0], studs[-1] + 1
            at = (x1, y1)[axis]
            out.append(SideContact(name, other, axis, at, span, shared))
    return tuple(out)


def centre(item: PlacedBrick) -> Array:
    """Return a brick's centre of mass, that of its box, shape (3,) [studs]."""
    nx, ny = footprint(item.cell, item.brick)
    cell = item.cell
    middle = stud_height(cell.level + item.brick.height / 2)
    return np.array([cell.x + nx / 2, cell.y + ny / 2, middle])


def knob_points(upper: PlacedBrick, stud: tuple[int, int]) -> Array:
    """Return where a brick's cavity holds a knob, shape (3 or 4, 2) [studs].

    Args:
        upper: the brick whose cavity it is.
        stud: the knob (x, y).
    """
    i, j = stud[0] - upper.cell.x, stud[1] - upper.cell.y
    offsets = _cavity(*footprint(upper.cell, upper.brick), i, j)
    points: Array = offsets + np.array([stud[0] + 0.5, stud[1] + 0.5])
    return points


@lru_cache(maxsize=1024)
def _cavity(nx: int, ny: int, i: int, j: int) -> Array:
    """Return the contacts of a knob in place (i, j) of an nx x ny cavity, about its axis."""
    points: list[tuple[float, float]] = []
    diagonal = CONTACT_RADIUS / np.sqrt(2.0)
    for sign in (-1, 1):
        # A brick of one stud's width has bars across it between the knobs, no tubes.
        if (i == 0 if sign < 0 else i == nx - 1) or ny == 1:
            points.append((sign * CONTACT_RADIUS, 0.0))
        if (j == 0 if sign < 0 else j == ny - 1) or nx == 1:
            points.append((0.0, sign * CONTACT_RADIUS))
        for other in (-1, 1):
            if 0 < i + (sign > 0) < nx and 0 < j + (other > 0) < ny:
                points.append((sign * diagonal, other * diagonal))
    out = np.array(points, dtype=np.float64)
    out.setflags(write=False)
    return out
