"""Conversion of a workcell to the content of plan.json and plan.npz, and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
)

from planning.bounds import (
    DEEPEST_M,
    FASTEST_DESCRIBED,
    HEAVIEST_COMPOSED_KG,
    LARGEST_ERROR,
    LARGEST_M,
    LONGEST_COPY_NAME,
    MOST_ELEMENTS,
    MOST_JOINTS,
    MOST_ROBOTS,
    THINNEST_M,
)
from planning.cell.machine import machine_robot
from planning.cell.motion_limits import MotionLimits
from planning.cell.robot_model import RobotModel
from planning.cell.shape import (
    Box,
    Capsule,
    Cylinder,
    Element,
    Form,
    Mesh,
    Shape,
    box_shape,
    shape_of,
)
from planning.cell.workcell import (
    NO_ERROR,
    Begun,
    CellObject,
    Clearances,
    Fixture,
    PlacedRobot,
    PoseError,
    Workcell,
)
from planning.errors import RobotModelError
from planning.robots.descriptions.description_files import description_sha256
from planning.robots.registry import ROBOTS, robot_model
from planning.transforms import Array
from scheduling.graph.columns import Arrays, Column, require_values

Index = Annotated[int, Field(ge=0, lt=2**31)]
Metres = Annotated[float, Field(ge=0, le=LARGEST_M)]
Length = Annotated[float, Field(gt=0, le=LARGEST_M)]
Name = Annotated[
    str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$", max_length=LONGEST_COPY_NAME)
]
"""As in scenarios, with room for the number of a copy: names become parts of file names."""
_Part = Annotated[int, Field(ge=0, le=255)]
Colour = tuple[_Part, _Part, _Part]

POSE, POSES = Column((4, 4)), Column(("rows", 4, 4))
_SIZES = Column(("rows", 3), least=THINNEST_M)
_HOME = Column(("joints",))
_RATES = Column((3, "joints"), least=0.0, largest=FASTEST_DESCRIBED)
_CAPS = Column((3,), least=0.0, largest=FASTEST_DESCRIBED)
_ERROR = Column((2,), least=0.0, largest=LARGEST_ERROR)
_DEVIATION = "skill_deviation_"
"""What the arrays of deviations are called: this, and the skill."""

_MESH = {
    "vertices": Column(("vertices", 3)),
    "faces": Column(("faces", 3), np.int64),
    "corners": Column(("corners", 3)),
    "centre": Column((3,)),
}
"""Arrays of a mesh, beside the numbers in plan.json."""

E = TypeVar("E", bound="Entry")
T = TypeVar("T")


class Entry(BaseModel):
    """A mapping of plan.json for a data class: no silent conversion, finite numbers."""

    model_config = ConfigDict(
        strict=True, allow_inf_nan=False, from_attributes=True, populate_by_name=True
    )


def to_entry(kind: type[E], item: object, **others: object) -> E:
    """Return the entry of an object: its attributes, and fields computed in addition."""
    names = [name for name in kind.model_fields if hasattr(item, name)]
    return kind.model_validate({n: getattr(item, n) for n in names} | others)


def from_entry(kind: type[T], entry: Entry, **others: object) -> T:
    """Return the object of an entry."""
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    return kind(**{n: value for n, value in entry if n in names} | others)


def stack(values: Sequence[Array], *shape: int) -> Array:
    """Return arrays of a shape as one, also if there are none."""
    return np.array(values, dtype=np.float64).reshape(-1, *shape)


class _Robot(Entry):
    name: Name
    model: str | None
    urdf: str
    sha256: str | None
    joints: Annotated[tuple[str, ...], Field(min_length=1, max_length=MOST_JOINTS)]
    frames: tuple[str, ...]
    mounted_on: tuple[Name, ...] = ()

    @model_serializer(mode="wrap")
    def _without_defaults(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: v for k, v in write(self).items() if k != "mounted_on" or v}


class _Box(Entry):
    form: Literal["box"] = "box"
    size: Annotated[tuple[Length, Length, Length], Field(alias="size_m")]


class _Cylinder(Entry):
    form: Literal["cylinder"] = "cylinder"
    radius: Annotated[Length, Field(alias="radius_m")]
    length: Annotated[Metres, Field(alias="length_m")]


class _Capsule(_Cylinder):
    form: Literal["capsule"] = "capsule"  # type: ignore[assignment]


class _Mesh(Entry):
    form: Literal["mesh"] = "mesh"
    source: str
    volume: Annotated[float, Field(gt=0, alias="volume_m3")]
    missed: Annotated[Metres, Field(alias="missed_m")]
    hulls: Annotated[tuple[Index, ...], Field(min_length=1, max_length=MOST_ELEMENTS)]


_Element = Annotated[_Box | _Cylinder | _Capsule | _Mesh, Field(discriminator="form")]


class _Thing(Entry):
    name: Name
    body: str
    shape: (
        Annotated[tuple[_Element, ...], Field(min_length=1, max_length=MOST_ELEMENTS)]
        | None
    )


class _Fixture(_Thing):
    colour: Colour | None


class _Object(_Thing):
    kind: str
    mass: Annotated[float, Field(ge=0, le=HEAVIEST_COMPOSED_KG, alias="mass_kg")]
    fixed: bool
    colour: Colour
    later: bool


class _Clearance(Entry):
    robot_robot: Annotated[Metres, Field(alias="robot_robot_m")]
    robot_object: Annotated[Metres, Field(alias="robot_object_m")]
    contact_tolerance: Annotated[Metres, Field(alias="contact_tolerance_m")]
    contact_depth: Annotated[float, Field(ge=0, le=DEEPEST_M, alias="contact_depth_m")]


class _Begun(Entry):
    after: str
    done: tuple[tuple[str, Annotated[int, Field(ge=0)]], ...]
    out: tuple[Name, ...]
    steps: tuple[Annotated[int, Field(ge=1)], ...] = ()


class CellEntry(Entry):
    """Content of plan.json on a cell."""

    robots: Annotated[tuple[_Robot, ...], Field(min_length=1, max_length=MOST_ROBOTS)]
    fixtures: tuple[_Fixture, ...]
    objects: tuple[_Object, ...]
    clearance: _Clearance
    machines: tuple[Name, ...]
    begun: _Begun | None = None

    @model_serializer(mode="wrap")
    def _without_defaults(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: v for k, v in write(self).items() if k != "begun" or v}


def write_cell(cell: Workcell, arrays: Arrays) -> CellEntry:
    """Return the entry of a cell; its arrays are added to the others."""
    things = (("fixture", "pose", cell.fixtures), ("object", "start", cell.objects))
    for what, pose, items in things:
        arrays[f"{what}_size"] = stack([item.size for item in items], 3)
        arrays[f"{what}_{pose}"] = stack([getattr(item, pose) for item in items], 4, 4)
        _SIZES.check(f"{what}_size", arrays[f"{what}_size"], {})
        POSES.check(f"{what}_{pose}", arrays[f"{what}_{pose}"], {})
    for skill, off in cell.deviations.items():
        arrays[_DEVIATION + skill] = np.array([off.m, off.rad])
    return CellEntry(
        robots=tuple(_write_robot(i, r, arrays) for i, r in enumerate(cell.robots)),
        fixtures=tuple(_write_thing(_Fixture, f, arrays) for f in cell.fixtures),
        objects=tuple(_write_thing(_Object, o, arrays) for o in cell.objects),
        clearance=to_entry(_Clearance, cell.clearances),
        machines=tuple(item.name for item in cell.machines),
        begun=None if cell.begun is None else to_entry(_Begun, cell.begun),
    )


def _write_robot(i: int, robot: PlacedRobot, arrays: Arrays) -> _Robot:
    model, limits = robot.model, robot.limits
    arrays[f"robot_{i}_base"], arrays[f"robot_{i}_home"] = robot.base, robot.home
    arrays[f"robot_{i}_frames"] = stack(list(model.frames.values()), 4, 4)
    for name, column in (("base", POSE), ("home", _HOME), ("frames", POSES)):
        column.check(f"robot_{i}_{name}", arrays[f"robot_{i}_{name}"], {})
    if limits is not None:
        joints = np.array([limits.velocity, limits.acceleration, limits.jerk])
        caps = limits.sum_of_speeds, limits.tool_speed, limits.loaded_tool_speed
        # 0 means no limit.
        for name, values in (("limits", joints), ("caps", np.array(caps))):
            arrays[f"robot_{i}_{name}"] = np.where(np.isfinite(values), values, 0.0)
        _RATES.check(f"robot_{i}_limits", arrays[f"robot_{i}_limits"], {})
    if robot.base_error:
        error = robot.base_error.m, robot.base_error.rad
        arrays[f"robot_{i}_base_error"] = np.array(error)
    known = model.name in ROBOTS
    return _Robot(
        name=robot.name,
        model=model.name if known else None,
        # Packaged robots are found by name; a plan is the same wherever it was made.
        urdf=model.urdf.name if known else str(model.urdf),
        sha256=description_sha256(model),
        joints=model.joint_names,
        frames=tuple(model.frames),
        mounted_on=tuple(item.name for item in robot.mounted_on),
    )


def _write_thing(kind: type[E], item: Fixture | CellObject, arrays: Arrays) -> E:
    """Return the entry of a thing; a box is described by its size alone."""
    if item.shape.is_box:
        return to_entry(kind, item, body=item.shape.pieces[0].name, shape=None)
    elements = item.shape.elements
    arrays[f"shape_{item.name}_pose"] = stack([e.pose for e in elements], 4, 4)
    described = tuple(
        _write_form(f"shape_{item.name}_{k}_", element.form, arrays)
        for k, element in enumerate(elements)
    )
    return to_entry(kind, item, body=item.name, shape=described)


def _write_form(prefix: str, form: Form, arrays: Arrays) -> Entry:
    if isinstance(form, Mesh):
        own = form.vertices, form.faces, np.vstack(form.hulls), form.centre
        arrays |= {prefix + k: v for k, v in zip(_MESH, own, strict=True)}
        return to_entry(_Mesh, form, hulls=tuple(map(len, form.hulls)))
    entries: dict[type, type[Entry]]
    entries = {Box: _Box, Cylinder: _Cylinder, Capsule: _Capsule}
    return to_entry(entries[type(form)], form)


def read_cell(
    document: CellEntry, arrays: Arrays, models: Mapping[str, RobotModel], folder: Path
) -> Workcell:
    """Return the cell of an entry, see ``document.read_graph``."""
    fixtures = tuple(
        from_entry(Fixture, entry, **own)
        for entry, own in _read_things("fixture", "pose", document.fixtures, arrays)
    )
    robots = tuple(
        replace(
            _read_robot(i, entry, arrays, models, folder),
            mounted_on=tuple(f for f in fixtures if f.name in entry.mounted_on),
        )
        for i, entry in enumerate(document.robots)
    )
    objects = _read_things("object", "start", document.objects, arrays)
    return Workcell(
        robots,
        fixtures,
        tuple(from_entry(CellObject, entry, **own) for entry, own in objects),
        from_entry(Clearances, document.clearance),
        tuple(map(machine_robot, document.machines)),
        {
            name.removeprefix(_DEVIATION): PoseError(
                *_ERROR.read(name, arrays, {}).tolist()
            )
            for name in sorted(arrays)
            if name.startswith(_DEVIATION)
        },
        None if document.begun is None else from_entry(Begun, document.begun),
    )


def _read_robot(
    i: int,
    entry: _Robot,
    arrays: Arrays,
    models: Mapping[str, RobotModel],
    folder: Path,
) -> PlacedRobot:
    name = entry.model or Path(entry.urdf).stem
    model = models.get(name) or robot_model(entry.model or entry.urdf, folder)
    if description_sha256(model) != entry.sha256:
        raise RobotModelError(
            f"robot {entry.name!r}: {model.urdf} or a mesh of it is not as it was when"
            f" the plan in {folder} was made"
        )
    if model.joint_names != entry.joints:
        raise RobotModelError(
            f"robot {entry.name!r}: {model.urdf} has the joints"
            f" {', '.join(model.joint_names)}; the plan in {folder} was made for"
            f" {', '.join(entry.joints)}"
        )
    prefix, sizes = f"robot_{i}_", {"joints": model.dof, "rows": len(entry.frames)}
    poses = POSES.read(f"{prefix}frames", arrays, sizes)
    limits = None
    if f"{prefix}limits" in arrays:
        rates = _RATES.read(f"{prefix}limits", arrays, sizes)
        wrong = "speed and acceleration must be above 0; jerk may be 0, for no limit"
        require_values(rates[:2] > 0.0, f"{prefix}limits", rates, wrong)
        caps = _CAPS.read(f"{prefix}caps", arrays, sizes)
        rates, caps = (np.where(own > 0.0, own, np.inf) for own in (rates, caps))
        limits = MotionLimits(*rates, *caps.tolist())
    error = NO_ERROR
    if f"{prefix}base_error" in arrays:
        off = _ERROR.read(f"{prefix}base_error", arrays, sizes)
        error = PoseError(*off.tolist())
    return PlacedRobot(
        entry.name,
        replace(model, frames=dict(zip(entry.frames, poses, strict=True))),
        POSE.read(f"{prefix}base", arrays, sizes),
        _HOME.read(f"{prefix}home", arrays, sizes),
        limits=limits,
        base_error=error,
    )


def _read_things(
    what: str, pose: str, entries: Sequence[_Thing], arrays: Arrays
) -> Iterator[tuple[_Thing, dict[str, Any]]]:
    """Yield things with their poses and shapes."""
    rows = {"rows": len(entries)}
    sizes = _SIZES.read(f"{what}_size", arrays, rows)
    poses = POSES.read(f"{what}_{pose}", arrays, rows)
    for entry, size, at in zip(entries, sizes, poses, strict=True):
        shape = box_shape(entry.body, size)
        if entry.shape is not None:
            shape = _read_shape(f"shape_{entry.name}_", entry, arrays)
        yield entry, {"shape": shape, pose: at}


def _read_shape(prefix: str, entry: _Thing, arrays: Arrays) -> Shape:
    """Return the shape of a thing that is no box."""
    assert entry.shape is not None
    poses = POSES.read(f"{prefix}pose", arrays, {"rows": len(entry.shape)})
    forms = [
        _read_form(f"{prefix}{k}_", element, arrays)
        for k, element in enumerate(entry.shape)
    ]
    return shape_of(entry.name, list(map(Element, forms, poses)))


def _read_form(prefix: str, entry: _Element, arrays: Arrays) -> Form:
    if not isinstance(entry, _Mesh):
        kind = {"box": Box, "cylinder": Cylinder, "capsule": Capsule}[entry.form]
        return from_entry(kind, entry)
    sizes = {"corners": sum(entry.hulls)}
    own = {k: c.read(prefix + k, arrays, sizes) for k, c in _MESH.items()}
    faces = own["faces"]
    known = (faces >= 0) & (faces < len(own["vertices"]))
    require_values(known, f"{prefix}faces", faces, "is no vertex")
    hulls = np.split(own.pop("corners"), np.cumsum(entry.hulls)[:-1])
    return from_entry(Mesh, entry, hulls=tuple(hulls), **own)
