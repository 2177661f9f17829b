"""Shapes that are no boxes, as plain values and named arrays of numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from planning.cell.shape import (
    Box,
    Capsule,
    Cylinder,
    Element,
    Form,
    Mesh,
    Shape,
    shape_of,
)

Arrays = dict[str, npt.NDArray[Any]]


def shape_document(name: str, shape: Shape, arrays: Arrays) -> list[dict[str, Any]]:
    """Return the elements of a shape; its numbers are added to the arrays.

    Args:
        name: of what has the shape.
        shape: the shape.
        arrays: added to.
    """
    arrays[f"shape_{name}_pose"] = np.array([item.pose for item in shape.elements])
    return [
        _entry(f"shape_{name}_{k}", item.form, arrays)
        for k, item in enumerate(shape.elements)
    ]


def stored_shape(name: str, entries: list[dict[str, Any]], arrays: Arrays) -> Shape:
    """Return the shape that ``shape_document`` described.

    Raises:
        KeyError: an array is missing.
        ValueError, IndexError, QhullError: one does not fit.
    """
    poses = arrays[f"shape_{name}_pose"]
    forms = [
        _form(f"shape_{name}_{k}", entry, arrays) for k, entry in enumerate(entries)
    ]
    pairs = zip(forms, poses, strict=True)
    return shape_of(name, [Element(form, pose) for form, pose in pairs])


def _entry(key: str, form: Form, arrays: Arrays) -> dict[str, Any]:
    if isinstance(form, Box):
        return {"form": "box", "size_m": list(form.size)}
    if isinstance(form, Cylinder | Capsule):
        kind = "cylinder" if isinstance(form, Cylinder) else "capsule"
        return {"form": kind, "radius_m": form.radius, "length_m": form.length}
    arrays[f"{key}_vertices"], arrays[f"{key}_faces"] = form.vertices, form.faces
    arrays[f"{key}_corners"] = np.vstack(form.hulls)
    arrays[f"{key}_centre"] = form.centre
    return {
        "form": "mesh",
        "source": form.source,
        "volume_m3": form.volume,
        "missed_m": form.missed,
        "hulls": [len(hull) for hull in form.hulls],
    }


def _form(key: str, entry: dict[str, Any], arrays: Arrays) -> Form:
    if entry["form"] == "box":
        x, y, z = entry["size_m"]
        return Box((x, y, z))
    if entry["form"] == "cylinder":
        return Cylinder(entry["radius_m"], entry["length_m"])
    if entry["form"] == "capsule":
        return Capsule(entry["radius_m"], entry["length_m"])
    corners = arrays[f"{key}_corners"]
    ends = np.cumsum(entry["hulls"])
    if ends[-1] != len(corners):
        raise ValueError(f"{key}_corners has {len(corners)} rows, not {ends[-1]}")
    return Mesh(
        arrays[f"{key}_vertices"],
        arrays[f"{key}_faces"],
        tuple(np.split(corners, ends[:-1])),
        entry["volume_m3"],
        arrays[f"{key}_centre"],
        entry["missed_m"],
        entry["source"],
    )
