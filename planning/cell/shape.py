"""Shapes of parts and fixtures: boxes, cylinders, capsules and meshes, approximated by convex pieces.

Cylinders and capsules are approximated by polyhedra. Every face is tangent to the round surface, so only edges and
corners lie outside of it. A polyhedron has 16 to 48 sides, as many as limit the excess to about 0.1 mm: it is 0.10 mm
at a radius of 5 mm, 0.09 mm at 15 mm, and 0.21 percent of any radius above 47 mm. At the half spheres of a capsule
the excess is up to 4 percent of the radius.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import TypeAlias, Union

import numpy as np
import numpy.typing as npt

from planning.caches import BoundedCache
from planning.cell.body import Capsules, ConvexBody
from planning.cell.cover import box_body, capsule_cover, capsule_covers
from planning.transforms import Array, Indices, Transform, read_only_copy

_STANDS_OUT = 1e-4
"""Sides are added until a polyhedron stands out of its form by no more than this [m]."""

_FEWEST_SIDES, _MOST_SIDES, _STEP = 16, 48, 4
"""Numbers of sides: from, to, and in steps of."""

_LATITUDES = np.linspace(0.0, 0.5 * math.pi, 5)
_UPRIGHT: Transform = read_only_copy(np.eye(4))

Form: TypeAlias = Union["Box", "Cylinder", "Capsule", "Mesh"]
"""The form of a rigid element."""

Placed = tuple[str, ConvexBody, Transform]
"""A convex piece of a resting object: the object's name, the piece, and its pose."""

_SHAPES: BoundedCache[Shape] = BoundedCache(2000)


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
    """Triangles, and the convex pieces used in their place for distances.

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


def _polyhedron_sides(radius: float) -> int:
    """Return the number of sides of the polyhedron around a round bar: a multiple of four."""
    for count in range(_FEWEST_SIDES, _MOST_SIDES, _STEP):
        if radius * (1.0 / math.cos(math.pi / count) - 1.0) <= _STANDS_OUT:
            return count
    return _MOST_SIDES


@lru_cache(maxsize=256)
def round_body(form: Cylinder | Capsule) -> ConvexBody:
    """Return the polyhedron around a cylinder or a capsule, in the frame of the form."""
    rings = _of_cylinder(form) if isinstance(form, Cylinder) else _of_capsule(form)
    count = _polyhedron_sides(form.radius)
    # Corners are half-way between the points where the faces touch the round side.
    turn = 2.0 * math.pi * (np.arange(count) + 0.5) / count
    vertices = np.vstack(
        [
            np.column_stack(
                [out * np.cos(turn), out * np.sin(turn), np.full(count, high)]
            )
            for out, high in rings
        ]
    )
    return ConvexBody("round", read_only_copy(vertices), capsule_cover(vertices))


def _of_cylinder(form: Cylinder) -> list[tuple[float, float]]:
    """Return the rings of corners: how far from the axis, and how high."""
    out = form.radius / math.cos(math.pi / _polyhedron_sides(form.radius))
    return [(out, -0.5 * form.length), (out, 0.5 * form.length)]


def _of_capsule(form: Capsule) -> list[tuple[float, float]]:
    """Return the rings of corners, each where the faces of two latitudes meet."""
    edge = math.cos(math.pi / _polyhedron_sides(form.radius))
    rings = []
    for low, high in pairwise(_LATITUDES.tolist()):
        faces = [[math.cos(a) * edge, math.sin(a)] for a in (low, high)]
        out, up = np.linalg.solve(faces, [form.radius, form.radius]).tolist()
        rings += [(out, 0.5 * form.length + up), (out, -0.5 * form.length - up)]
    return rings


@dataclass(frozen=True, eq=False)
class Element:
    """A form at its pose in a shape.

    Attributes:
        form: its exact form, for pictures and independent measurements.
        pose: of the form in the frame of the shape.
    """

    form: Form
    pose: Transform


@dataclass(frozen=True, eq=False)
class Shape:
    """The shape of a part or a fixture.

    Attributes:
        elements: what it is made of, exactly.
        pieces: convex bodies that contain the elements together, in the frame of the shape; of a
            box and of a convex mesh it is one.
        own_centre: centre of mass of a body that is not equally dense throughout, shape (3,) [m].
    """

    elements: tuple[Element, ...]
    pieces: tuple[ConvexBody, ...]
    own_centre: Array | None = None

    @property
    def is_box(self) -> bool:
        """Whether it is one box, centred at the origin and parallel to the axes."""
        first, *others = self.elements
        return (
            not others
            and isinstance(first.form, Box)
            and np.array_equal(first.pose, _UPRIGHT)
        )

    @cached_property
    def low(self) -> Array:
        """Least corner of the box around it, parallel to its axes, shape (3,) [m]."""
        return read_only_copy(np.min([piece.low for piece in self.pieces], axis=0))

    @cached_property
    def high(self) -> Array:
        """Greatest corner of that box, shape (3,) [m]."""
        return read_only_copy(np.max([piece.high for piece in self.pieces], axis=0))

    @cached_property
    def size(self) -> Array:
        """Edge lengths of that box, shape (3,) [m]."""
        return read_only_copy(self.high - self.low)

    @cached_property
    def middle(self) -> Array:
        """Centre of that box, shape (3,) [m]."""
        return read_only_copy(0.5 * (self.high + self.low))

    @cached_property
    def volume(self) -> float:
        """Sum of the volumes of the elements: where two overlap, it counts twice [m^3]."""
        return float(sum(element.form.volume for element in self.elements))

    @cached_property
    def centre_of_mass(self) -> Array:
        """Centre of the mass of all elements, each equally dense, or as given, shape (3,) [m]."""
        if self.own_centre is not None:
            return self.own_centre
        weights = np.array([element.form.volume for element in self.elements])
        centres = np.array([_centre(element) for element in self.elements])
        return read_only_copy(weights @ centres / weights.sum())

    def placed(self, name: str, pose: Transform) -> list[Placed]:
        """Return the convex pieces of an object with this shape at a pose, each with its name."""
        return [(name, piece, pose) for piece in self.pieces]

    def bounds(self, pose: Transform) -> tuple[Array, Array]:
        """Return the least and greatest corners of the upright box around it at a pose [m].

        The upright box holds the box around the shape, turned: it may be larger than needed.
        """
        reach = np.abs(pose[:3, :3]) @ (0.5 * self.size)
        middle = pose[:3, :3] @ self.middle + pose[:3, 3]
        return middle - reach, middle + reach


def box_shape(name: str, size: npt.ArrayLike) -> Shape:
    """Return a box centred at the origin.

    Args:
        name: of what has the shape, for messages.
        size: edge lengths, shape (3,), all positive [m].

    Raises:
        ValueError: an edge is not a positive finite number.
    """
    x, y, z = (float(edge) for edge in np.asarray(size, dtype=np.float64))
    return _box_shape(name, (x, y, z))


@lru_cache(maxsize=4096)
def _box_shape(name: str, size: tuple[float, float, float]) -> Shape:
    return Shape((Element(Box(size), _UPRIGHT),), (box_body(name, size),))


def shape_of(name: str, elements: Sequence[Element]) -> Shape:
    """Return the shape made of several placed forms.

    What was asked before is the same shape: what is known of it, such as its grips, is known of all cells
    that have it.

    Args:
        name: of what has the shape, for messages.
        elements: at least one.
    """
    key = name, tuple((item.form, item.pose.tobytes()) for item in elements)
    return _SHAPES.get(key, lambda: _shape_of(name, elements))


def _shape_of(name: str, elements: Sequence[Element]) -> Shape:
    bodies = [body for element in elements for body in _bodies(name, element)]
    if len(bodies) > 1:
        bodies = [
            ConvexBody(f"{name}:{k}", body.vertices, body.capsules)
            for k, body in enumerate(bodies)
        ]
    return Shape(tuple(elements), tuple(bodies))


def _bodies(name: str, element: Element) -> list[ConvexBody]:
    """Return the convex bodies of an element, in the frame of the shape."""
    form = element.form
    if isinstance(form, Mesh):
        covers = zip(form.hulls, capsule_covers(form.hulls), strict=True)
        own = [ConvexBody(name, hull, capsules) for hull, capsules in covers]
    elif isinstance(form, Box):
        own = [box_body(name, form.size)]
    else:
        round_one = round_body(form)
        own = [ConvexBody(name, round_one.vertices, round_one.capsules)]
    if np.array_equal(element.pose, _UPRIGHT):
        return own
    return [_placed(body, element.pose) for body in own]


def _placed(body: ConvexBody, pose: Transform) -> ConvexBody:
    def transformed(points: Array) -> Array:
        return read_only_copy(points @ pose[:3, :3].T + pose[:3, 3])

    covers = body.capsules
    capsules = Capsules(
        transformed(covers.start), transformed(covers.end), covers.radius
    )
    return ConvexBody(body.name, transformed(body.vertices), capsules)


def _centre(element: Element) -> Array:
    centre = element.pose[:3, 3]
    if isinstance(element.form, Mesh):
        centre = centre + element.pose[:3, :3] @ element.form.centre
    return centre
