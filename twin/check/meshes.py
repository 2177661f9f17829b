"""Checks of meshes: whether their convex pieces contain them."""

from __future__ import annotations

from planning.cell.forms import Mesh
from twin.check.finding import Finding, Findings, Subject, millimetres

_MISSED = 1e-4
"""So much of a surface may be outside of all pieces before it is worth a word [m]."""


def check_meshes(subject: Subject) -> Findings:
    """Yield meshes of which some of the surface is outside of the pieces that stand for them."""
    things = [(f.name, f.shape) for f in subject.cell.fixtures]
    things += [(o.name, o.shape) for o in subject.cell.objects]
    for name, shape in things:
        for element in shape.elements:
            if isinstance(element.form, Mesh) and element.form.missed > _MISSED:
                yield Finding(
                    subject.thing_at(name, "shape"),
                    f"the surface of {name} is up to {millimetres(element.form.missed)} outside"
                    " of the convex pieces that planning sees: close its holes, or give a smaller"
                    " within_m",
                )
