"""What the audit takes a fixture or an object to be: its forms as they are, not planning's pieces.

Only meshes are what planning cut them into: no engine measures how deep two hollow things overlap.
That their pieces contain them is checked where they are cut.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planning.cell.shape import Box, Capsule, Cylinder, Mesh
from planning.cell.shape import Shape as Made
from planning.transforms import Array, Transform, translation
from twin.audit.worlds.world import BASE, Shape

Convex = Box | Cylinder | Capsule | Array
"""A form, or the corners of a hull, shape (c, 3)."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex form of a fixture or an object.

    Attributes:
        form: centred at the origin.
        local: its pose in the frame of the fixture or object, None for the same frame.
        half: half edges of the box around it, shape (3,) [m].
        radius: of the sphere around it [m].
    """

    form: Convex
    local: Transform | None
    half: Array
    radius: float

    def shape(self, entity: str, number: int) -> Shape:
        """Return it as a shape that a world knows by a number."""
        return Shape(
            entity,
            entity,
            number,
            None,
            BASE,
            np.zeros(3),
            self.radius,
            self.half,
            np.eye(3),
            self.local,
        )


def solids(made_of: Made) -> Iterator[Solid]:
    """Yield the convex forms of a fixture or an object."""
    for element in made_of.elements:
        form, pose = element.form, element.pose
        local = None if np.array_equal(pose, np.eye(4)) else pose
        if isinstance(form, Mesh):
            for hull in form.hulls:
                middle = 0.5 * (hull.min(axis=0) + hull.max(axis=0))
                own = np.ascontiguousarray(hull - middle)
                half = np.abs(own).max(axis=0)
                radius = float(np.linalg.norm(own, axis=1).max())
                there = pose @ translation(*middle.tolist())
                yield Solid(own, there, half, radius)
        elif isinstance(form, Box):
            half = 0.5 * np.asarray(form.size, dtype=float)
            yield Solid(form, local, half, float(np.linalg.norm(half)))
        else:
            high = 0.5 * form.length
            if isinstance(form, Capsule):
                high += form.radius
                radius = high
            else:
                radius = float(np.hypot(form.radius, high))
            yield Solid(form, local, np.array([form.radius, form.radius, high]), radius)
