"""Models of structures: tower, wall, well and pavilion, as in Hartmann et al. V-A.

Every model is a list of boxes with their goal poses. The origin of the world is on the ground, in the middle of the
site; z points up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.transforms import (
    Array,
    Transform,
    from_rpy,
    read_only_copy,
    rotation,
    translation,
)

Colour = tuple[int, int, int]

_AERATED_CONCRETE = 500.0
_SPRUCE = 450.0
"""Densities [kg/m3]."""

_PLYWOOD = 7.8
"""Mass of 15 mm of plywood [kg/m2]."""


@dataclass(frozen=True)
class ModelPart:
    """A box of a model.

    Attributes:
        name: unique in the model.
        size: edge lengths, shape (3,) [m].
        mass: [kg].
        goal: pose of its centre where it belongs.
        faces: faces that a tool may touch, such as ``"+z"``, by the axis of its frame that
            points out of them; in the supply the first of them is up.
        colour: for pictures.
    """

    name: str
    size: Array
    mass: float
    goal: Transform
    faces: tuple[str, ...] = ("+z",)
    colour: Colour = (200, 170, 120)


def tower(
    levels: int = 15, size: Sequence[float] = (0.6, 0.2, 0.12)
) -> tuple[ModelPart, ...]:
    """Return beams stacked crosswise: each rests on the one before.

    Args:
        levels: number of beams.
        size: of a beam [m].
    """
    mass = _SPRUCE * float(np.prod(size))
    return tuple(
        ModelPart(
            name=f"beam{k + 1}",
            size=read_only_copy(size),
            mass=mass,
            goal=read_only_copy(
                translation(0.0, 0.0, (k + 0.5) * size[2])
                @ rotation("z", k % 2 * np.pi / 2)
            ),
            colour=(214, 178, 120) if k % 2 else (186, 140, 84),
        )
        for k in range(levels)
    )


def wall(
    columns: int = 9,
    courses: int = 4,
    size: Sequence[float] = (0.5, 0.2, 0.2),
    joint: float = 0.01,
) -> tuple[ModelPart, ...]:
    """Return a straight wall of blocks in running bond: every other course is shifted by half a block.

    Args:
        columns: blocks of a course.
        courses: number of courses.
        size: of a block [m].
        joint: gap between the blocks of a course [m].
    """
    pitch = size[0] + joint
    mass = _AERATED_CONCRETE * float(np.prod(size))
    out = []
    for course in range(courses):
        shift = 0.25 * pitch * (1 if course % 2 else -1)
        for column in range(columns):
            x = (column - 0.5 * (columns - 1)) * pitch + shift
            out.append(
                ModelPart(
                    name=f"block{course + 1}_{column + 1}",
                    size=read_only_copy(size),
                    mass=mass,
                    goal=read_only_copy(translation(x, 0.0, (course + 0.5) * size[2])),
                    colour=(222, 214, 200) if course % 2 else (196, 186, 170),
                )
            )
    return tuple(out)


def well(
    sides: int = 13,
    courses: int = 4,
    radius: float = 0.86,
    section: Sequence[float] = (0.18, 0.18),
    joint: float = 0.012,
) -> tuple[ModelPart, ...]:
    """Return a ring wall of blocks, every other course turned by half a block.

    Args:
        sides: blocks of a course.
        courses: number of courses.
        radius: of the circle that the blocks touch from outside [m].
        section: thickness and height of a block [m].
        joint: gap between the inner edges of blocks [m].
    """
    angle = 2.0 * np.pi / sides
    size = (2.0 * radius * np.tan(angle / 2.0) - joint, section[0], section[1])
    mass = _AERATED_CONCRETE * float(np.prod(size))
    out = []
    for course in range(courses):
        for side in range(sides):
            about = rotation("z", (side + 0.5 * (course % 2)) * angle)
            height = (course + 0.5) * section[1]
            # The long edge, x, runs along the ring.
            goal = about @ translation(radius + section[0] / 2.0, 0.0, height)
            out.append(
                ModelPart(
                    name=f"stone{course + 1}_{side + 1}",
                    size=read_only_copy(size),
                    mass=mass,
                    goal=read_only_copy(goal @ rotation("z", np.pi / 2)),
                    colour=(168, 168, 172) if course % 2 else (142, 142, 148),
                )
            )
    return tuple(out)


def pavilion(
    arches: Sequence[int] = (15, 16, 17, 17, 17, 16, 15),
    chord: float = 0.4,
    depth: float = 0.66,
    thickness: float = 0.14,
    joint: float = 0.012,
    crown_deg: float = 50.0,
) -> tuple[ModelPart, ...]:
    """Return a vault of arches of wooden cassettes, no two of one size.

    An arch is half of a polygon around a circle: the inner faces of its cassettes touch the
    circle, each a little longer or shorter than the next. Arches with more cassettes are wider
    and higher, so the vault swells in the middle. Cassettes near the crown are held from inside,
    all others from outside.

    Args:
        arches: number of cassettes of each arch.
        chord: mean length of a cassette along its arch [m].
        depth: least length of a cassette along the vault [m].
        thickness: of a cassette [m].
        joint: gap between inner edges of neighbours, and between arches [m].
        crown_deg: cassettes whose middle stands higher above the horizon than this, seen from
            the axis of the vault, are held from inside [deg].
    """
    depths = [depth + 0.01 * k for k in range(len(arches))]
    out = []
    edge = -0.5 * (sum(depths) + joint * (len(arches) - 1))
    for arch, count in enumerate(arches):
        # Angles of the edges from the ground on one side to the ground on the other.
        shares = 1.0 + 0.06 * np.sin(np.arange(1, count + 1) * (1.0 + 0.1 * arch))
        edges = np.pi * np.concatenate([[0.0], np.cumsum(shares) / shares.sum()])
        radius = chord / (2.0 * np.tan(np.pi / (2.0 * count)))
        y = edge + depths[arch] / 2.0
        edge += depths[arch] + joint
        for k in range(count):
            out.append(
                _cassette(
                    f"cassette{arch + 1}_{k + 1}",
                    (edges[k], edges[k + 1]),
                    radius,
                    (depths[arch], thickness, joint),
                    y,
                    inside=bool(
                        np.sin(0.5 * (edges[k] + edges[k + 1]))
                        > np.sin(np.radians(crown_deg))
                    ),
                )
            )
    return tuple(out)


def _cassette(
    name: str,
    edges: tuple[float, float],
    radius: float,
    section: tuple[float, float, float],
    y: float,
    *,
    inside: bool,
) -> ModelPart:
    """Return a cassette whose inner face touches a circle midway between two angles.

    Its frame: x along the arch, y along the vault, z outwards.
    """
    depth, thickness, joint = section
    half = 0.5 * (edges[1] - edges[0])
    length = 2.0 * radius * np.tan(half) - joint
    middle = 0.5 * (edges[0] + edges[1])
    outwards = from_rpy((0.0, 0.0, 0.0), (0.0, np.pi / 2 - middle, 0.0))
    goal = translation(0.0, y, 0.0) @ outwards
    goal = goal @ translation(0.0, 0.0, radius + thickness / 2.0)
    faces = 2.0 * (length * depth + (length + depth) * thickness)
    shade = 18.0 * np.sin(3.0 * middle + y)
    return ModelPart(
        name=name,
        size=read_only_copy((length, depth, thickness)),
        mass=round(_PLYWOOD * faces, 2),
        goal=read_only_copy(goal),
        faces=("-z",) if inside else ("+z",),
        colour=(int(206 + shade), int(160 + shade), int(100 + shade)),
    )
