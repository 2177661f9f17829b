"""How far the polyhedra that stand for round forms stand out of them."""

import numpy as np

from planning.cell.shape import Capsule, Cylinder, round_body


def stands_out(form: Cylinder | Capsule) -> float:
    """Return how far the polyhedron around a form stands out of it at most [m]."""
    vertices = round_body(form).vertices
    high = vertices[:, 2]
    if isinstance(form, Capsule):
        high = high - np.clip(high, -0.5 * form.length, 0.5 * form.length)
        return (
            float(np.sqrt((vertices[:, :2] ** 2).sum(1) + high**2).max()) - form.radius
        )
    return float(np.linalg.norm(vertices[:, :2], axis=1).max()) - form.radius
