"""The types that plan.json must have, see ``plan_files``.

Shapes that are no boxes, as plain values and named arrays of numbers.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError

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
from planning.cell.workcell import CONTACT_DEPTH
from planning.errors import OutputError, listed
from planning.tasks.task import GONE

Index = Annotated[int, Field(ge=0, lt=2**31)]
Metres = Annotated[float, Field(ge=0, le=1000)]
Length = Annotated[float, Field(gt=0, le=1000)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$", max_length=128)]
"""As in scenarios, with room for the number of a copy: names become parts of file names."""
Colour = Annotated[
    list[Annotated[int, Field(ge=0, le=255)]], Field(min_length=3, max_length=3)
]


class _Entry(BaseModel):
    """A mapping of plan.json: no silent conversion, finite numbers."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class _Robot(_Entry):
    name: Name
    model: str | None
    urdf: str
    sha256: str | None = None
    joints: Annotated[list[str], Field(min_length=1, max_length=100)]
    frames: list[str]


class _Box(_Entry):
    form: Literal["box"]
    size_m: Annotated[list[Length], Field(min_length=3, max_length=3)]


class _Round(_Entry):
    form: Literal["cylinder", "capsule"]
    radius_m: Length
    length_m: Metres


class _Mesh(_Entry):
    form: Literal["mesh"]
    source: str
    volume_m3: Annotated[float, Field(gt=0)]
    missed_m: Metres
    hulls: Annotated[list[Index], Field(min_length=1, max_length=10_000)]


_Element = Annotated[_Box | _Round | _Mesh, Field(discriminator="form")]


class _Thing(_Entry):
    name: Name
    body: str
    shape: Annotated[list[_Element], Field(min_length=1, max_length=10_000)] | None = (
        None
    )


class _Fixture(_Thing):
    colour: Colour | None = None


class _Object(_Thing):
    kind: str
    mass_kg: Annotated[float, Field(ge=0, le=1e6)]
    fixed: bool
    colour: Colour
    later: bool = False


class _Clearance(_Entry):
    robot_robot_m: Metres
    robot_object_m: Metres
    contact_tolerance_m: Metres = 0.0
    contact_depth_m: Annotated[float, Field(ge=0, le=0.1)] = CONTACT_DEPTH


class _Cell(_Entry):
    robots: Annotated[list[_Robot], Field(min_length=1, max_length=1000)]
    fixtures: list[_Fixture]
    objects: list[_Object]
    clearance: _Clearance
    machines: list[Name] = []


class _Handling(_Entry):
    object: str
    waypoint: Index
    holder: str | None


class _Task(_Entry):
    index: Index
    robot: str
    kind: Annotated[str, Field(min_length=1, max_length=64)]
    step: Index
    label: str
    object: str | None
    goal: bool = False
    handlings: list[_Handling]


class _NodeHandling(_Handling):
    chain: Index
    node: Index


class _Allowed(_Entry):
    first: str
    second: str
    tasks: list[Index]
    grazing: bool = False


class _Plan(_Entry):
    cell: _Cell
    tasks: list[_Task]
    chains: list[str]
    handlings: list[_NodeHandling]
    allowed: list[_Allowed]


def check_document(document: dict[str, Any]) -> None:
    """Check the types of plan.json, and that every name in it is known.

    Raises:
        OutputError: something is missing, of another type, out of its range or unknown; the
            message names the place.
    """
    try:
        plan = _Plan.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise OutputError(f"{place}: {first['msg']}") from None
    names = [robot.name for robot in plan.cell.robots]
    robots = _unique("cell.robots", names)
    movers = _unique("cell.machines", [*names, *plan.cell.machines])
    items = [*plan.cell.fixtures, *plan.cell.objects]
    _unique("cell.fixtures and cell.objects", [item.name for item in items])
    objects = {item.name for item in plan.cell.objects}
    chains = _unique("chains", plan.chains)
    holders = robots & chains
    for k, name in enumerate(plan.chains):
        _known(f"chains.{k}", name, movers)
    for k, task in enumerate(plan.tasks):
        if task.index != k:
            raise OutputError(f"tasks.{k}.index: is {task.index}")
        _known(f"tasks.{k}.robot", task.robot, chains)
        if task.object is not None:
            _known(f"tasks.{k}.object", task.object, objects)
        for handling in task.handlings:
            _handled(f"tasks.{k}.handlings", handling, objects, holders)
    for k, handling in enumerate(plan.handlings):
        _handled(f"handlings.{k}", handling, objects, holders)


def _unique(place: str, names: list[str]) -> set[str]:
    known = set(names)
    if len(known) < len(names):
        raise OutputError(f"{place}: a name is given twice")
    return known


def _known(place: str, name: str, known: set[str]) -> None:
    if name not in known:
        valid = listed(sorted(known)) or "none"
        raise OutputError(f"{place}: there is no {name!r} (valid: {valid})")


def _handled(
    place: str, handling: _Handling, objects: set[str], holders: set[str]
) -> None:
    _known(f"{place}.object", handling.object, objects)
    if handling.holder not in (None, GONE):
        _known(f"{place}.holder", str(handling.holder), holders)


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
