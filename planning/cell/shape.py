"""Shapes of parts and fixtures: what they are made of, and the convex pieces that stand for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from planning.cell.body import Capsules, ConvexBody
from planning.cell.cover import box_body, capsule_covers
from planning.cell.forms import Box, Form, Mesh
from planning.cell.polyhedra import round_body
from planning.transforms import Array, Transform, readonly

_UPRIGHT: Transform = readonly(np.eye(4))


Placed = tuple[str, ConvexBody, Transform]
"""A convex piece of something at rest: the name of what it belongs to, and its pose."""


@dataclass(frozen=True, eq=False)
class Element:
    """A form in its place in a shape.

    Attributes:
        form: what it is, exactly; for pictures, and for those who measure on their own.
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
        return readonly(np.min([piece.low for piece in self.pieces], axis=0))

    @cached_property
    def high(self) -> Array:
        """Greatest corner of that box, shape (3,) [m]."""
        return readonly(np.max([piece.high for piece in self.pieces], axis=0))

    @cached_property
    def size(self) -> Array:
        """Edge lengths of that box, shape (3,) [m]."""
        return readonly(self.high - self.low)

    @cached_property
    def middle(self) -> Array:
        """Centre of that box, shape (3,) [m]."""
        return readonly(0.5 * (self.high + self.low))

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
        return readonly(weights @ centres / weights.sum())

    def placed(self, name: str, pose: Transform) -> list[Placed]:
        """Return the pieces of what has this shape, each with its name, at a pose."""
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
    body = box_body(name, size)
    x, y, z = (float(edge) for edge in np.asarray(size, dtype=np.float64))
    return Shape((Element(Box((x, y, z)), _UPRIGHT),), (body,))


def shape_of(name: str, elements: Sequence[Element]) -> Shape:
    """Return the shape that is made of some forms in their places.

    Args:
        name: of what has the shape, for messages.
        elements: at least one.
    """
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
    def there(points: Array) -> Array:
        return readonly(points @ pose[:3, :3].T + pose[:3, 3])

    covers = body.capsules
    capsules = Capsules(there(covers.start), there(covers.end), covers.radius)
    return ConvexBody(body.name, there(body.vertices), capsules)


def _centre(element: Element) -> Array:
    centre = element.pose[:3, 3]
    if isinstance(element.form, Mesh):
        centre = centre + element.pose[:3, :3] @ element.form.centre
    return centre
