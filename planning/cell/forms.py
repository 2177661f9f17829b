"""Forms that shapes are made of: boxes, cylinders, capsules and meshes, each in a frame of its own."""

from __future__ import annotations

import math
from dataclasses import dataclass

from planning.transforms import Array, Indices


@dataclass(frozen=True)
class Box:
    """A box centred at the origin.

    Attributes:
        size: edge lengths [m].
    """

    size: tuple[float, float, float]

    @property
    def volume(self) -> float:
        """Its volume [m^3]."""
        return math.prod(self.size)


@dataclass(frozen=True)
class Cylinder:
    """A cylinder centred at the origin, its axis along z.

    Attributes:
        radius: of its round side [m].
        length: from one flat end to the other [m].
    """

    radius: float
    length: float

    @property
    def volume(self) -> float:
        """Its volume [m^3]."""
        return math.pi * self.radius**2 * self.length


@dataclass(frozen=True)
class Capsule:
    """A cylinder with a half sphere at either end, centred at the origin, its axis along z.

    Attributes:
        radius: of its round side and its ends [m].
        length: of the cylinder, without the half spheres; 0 for a sphere [m].
    """

    radius: float
    length: float

    @property
    def volume(self) -> float:
        """Its volume [m^3]."""
        return math.pi * self.radius**2 * (self.length + 4.0 / 3.0 * self.radius)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles, and the convex pieces that stand for them wherever distances count.

    Attributes:
        vertices: of the triangles, shape (v, 3) [m].
        faces: vertices of each, anticlockwise as seen from outside, shape (f, 3).
        hulls: corners of the convex pieces, each of shape (c, 3) [m].
        volume: that it encloses [m^3].
        centre: of its mass, where it is equally dense throughout, shape (3,) [m].
        missed: how far a point of its surface is outside of all pieces at most [m].
        source: file that it comes from, for messages.
    """

    vertices: Array
    faces: Indices
    hulls: tuple[Array, ...]
    volume: float
    centre: Array
    missed: float = 0.0
    source: str = "mesh"


Form = Box | Cylinder | Capsule | Mesh
"""Any of them."""
