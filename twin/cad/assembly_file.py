"""Reading of a STEP file as the bodies of an assembly, sorted by shape."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planning.bounds import LARGEST_M
from planning.cad.glb_bodies import read_bodies
from planning.cad.part_types import PartType, sort_by_shape
from planning.cad.step_file import read_step, triangulate_step
from planning.cad.step_text import place_of_circle
from planning.errors import RequestError

_DEVIATIONS = (1e-5, 5e-5, 2e-4)
"""Distances of triangles from round surfaces that are tried, until no body has too many triangles [m]."""

_MOST_TRIANGLES = 100_000
"""Most triangles of a body: more are refused of meshes that are not convex."""


def read_assembly(file: Path) -> tuple[list[PartType], list[str]]:
    """Return the types of the bodies of a STEP file, and notes.

    Raises:
        RequestError: it cannot be used.
    """
    notes: list[str] = []
    for deviation in _DEVIATIONS:
        content = triangulate_step(file, deviation)
        try:
            bodies, notes = read_bodies(content)
        except RequestError as error:
            raise RequestError(f"{file}: {error.message}") from None
        most = max((len(body.faces) for body in bodies), default=0)
        if most <= _MOST_TRIANGLES:
            break
    else:
        raise RequestError(
            f"{file}: a body has {most} triangles, more than {_MOST_TRIANGLES}: simplify it"
        )
    if deviation > _DEVIATIONS[0]:
        notes.append(f"round surfaces are met to within {deviation * 1e3:g} mm")
    if not bodies:
        found = "; ".join(notes) or "it has no shapes"
        place = place_of_circle(file, read_step(file))
        raise RequestError(f"{place}: no solid bodies: {found}")
    if len(bodies) < 2:
        raise RequestError(
            f"{file}: it has one body, and an assembly has two or more: export the"
            " assembly, not a part"
        )
    types = sort_by_shape(bodies)
    points = np.vstack([p.vertices for own in types for p in own.placed])
    if np.abs(points).max() > LARGEST_M:
        raise RequestError(
            f"{file}: it reaches beyond {LARGEST_M} m: look at its units"
        )
    return types, notes
