"""Checks of meshes: holes, surfaces outside of the convex pieces, and simplification."""

from __future__ import annotations

import numpy as np

from planning.cell.shape import Mesh
from planning.meshes.holes import closed_surface
from planning.transforms import Array, Indices
from twin.checks.finding import CheckContext, Finding, Findings, format_millimetres

_MISSED = 1e-4
"""Distance of a surface from its convex pieces up to which nothing is reported [m]."""

_OPEN = 0.005
"""Share of a surface that may be missing without a report: cracks between triangles."""


def check_meshes(subject: CheckContext) -> Findings:
    """Yield meshes with holes, those not covered by their convex pieces, and simplified ones."""
    things = [(f.name, f.shape) for f in subject.cell.fixtures]
    things += [(o.name, o.shape) for o in subject.cell.objects]
    meshes = [
        (name, element.form)
        for name, shape in things
        for element in shape.elements
        if isinstance(element.form, Mesh)
    ]
    for name, mesh in meshes:
        at, missing = (
            subject.thing_at(name, "shape"),
            missing_surface_share(mesh.vertices, mesh.faces),
        )
        if mesh.missed > _MISSED:
            yield Finding(
                at,
                f"the surface of {name} is up to {format_millimetres(mesh.missed)} outside"
                " of the convex pieces that planning sees: close its holes, or give a smaller"
                " within_m",
                code="covered",
                parts=(name,),
                figures=(mesh.missed,),
            )
        if mesh.simplified > 0.0:
            yield Finding(
                at,
                f"the mesh of {name} has {len(mesh.faces)} triangles: its convex pieces were cut from a simplified"
                f" copy, up to {format_millimetres(mesh.simplified)} off, and extended to contain the whole mesh;"
                " for closer pieces, simplify it (MeshLab, Blender)",
                code="simplified",
                parts=(name,),
                figures=(mesh.simplified,),
            )
        if missing > _OPEN:
            yield Finding(
                at,
                f"the surface of {name} is open: {100 * missing:.2g} % of it is missing in the mesh {mesh.source}, and"
                f" usual is at most {100 * _OPEN:g} %; planning closes the holes, which may not be what was meant:"
                " close them in the file",
                code="closed",
                parts=(name,),
                figures=(missing,),
            )


def missing_surface_share(vertices: Array, faces: Indices) -> float:
    """Return the share of a surface that its holes leave out.

    Cracks without an area count nothing.

    Args:
        vertices: each point once, shape (v, 3) [m].
        faces: the three vertices of each triangle, shape (f, 3).

    Returns:
        From 0 for a closed surface to 1.
    """
    points, every = closed_surface(vertices, faces)
    a, b, c = (points[every[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return float(area[len(faces) :].sum() / area.sum())
