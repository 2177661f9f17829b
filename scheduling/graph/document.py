"""A temporal plan graph as a document of plain values, and named arrays of numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.cell.robot_model import MotionLimits, RobotModel
from planning.cell.shape import box_shape
from planning.cell.workcell import (
    CONTACT_DEPTH,
    CellObject,
    Clearances,
    Fixture,
    PlacedRobot,
    Workcell,
    machine,
)
from planning.errors import RobotModelError
from planning.robots.descriptions.xml_files import description_sha256
from planning.robots.registry import ROBOTS, robot_model
from planning.tasks.task import AllowedContact, Handling, Task
from planning.transforms import Array
from scheduling.graph.drive import Drive, RoundedCorners
from scheduling.graph.schema import shape_document, stored_shape
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)

Document = dict[str, Any]
Arrays = dict[str, npt.NDArray[Any]]


def _keys(kind: type, *arrays: str, **renamed: str) -> dict[str, str]:
    """Return the fields of a data class by their keys in the document, without its arrays."""
    names = [f.name for f in fields(kind) if f.name not in arrays]
    return {renamed.get(name, name): name for name in names}


_FIXTURE = _keys(Fixture, "shape", "pose", "frames", "colour")
_OBJECT = _keys(CellObject, "shape", "start", mass="mass_kg")
_CLEARANCE = _keys(
    Clearances,
    robot_robot="robot_robot_m",
    robot_object="robot_object_m",
    contact_tolerance="contact_tolerance_m",
    contact_depth="contact_depth_m",
)
_USUAL_CLEARANCE = {"contact_tolerance_m": 0.0, "contact_depth_m": CONTACT_DEPTH}
"""What plans mean that do not say so: those of earlier versions grazed nothing."""
_TASK = _keys(Task, "path", "handlings")
_HANDLING = _keys(Handling, "pose")
_NODE_HANDLING = _keys(NodeHandling, "pose", robot="chain")
_CHAIN_ARRAYS = _keys(NodeChain, "robot", "least", "drive", "corners")
_GRAPH_ARRAYS = ("edges", "cause", "dependencies", "slots")


def graph_document(tpg: TemporalPlanGraph) -> tuple[Document, Arrays]:
    """Return a graph as a document and arrays of numbers, as the head of plan_files says."""
    arrays: Arrays = {name: getattr(tpg, name) for name in _GRAPH_ARRAYS}
    if len(tpg.products):
        arrays["products"] = tpg.products
    document = {
        "cell": _cell_document(tpg.cell, arrays),
        "tasks": _task_documents(tpg.tasks, arrays),
        "chains": [chain.robot for chain in tpg.chains],
        "handlings": [_entry(h, _NODE_HANDLING) for h in tpg.handlings],
        "allowed": [
            {"first": a.first, "second": a.second, "tasks": sorted(a.tasks)}
            | ({"grazing": True} if a.grazing else {})
            for a in tpg.allowed
        ],
    }
    arrays["handling_pose"] = _poses(h.pose for h in tpg.handlings)
    for i, chain in enumerate(tpg.chains):
        arrays |= {f"chain_{i}_{name}": getattr(chain, name) for name in _CHAIN_ARRAYS}
        if chain.drive is not None:
            arrays |= {f"chain_{i}_{k}": v for k, v in vars(chain.drive).items()}
        if chain.corners is not None:
            corners = vars(chain.corners).items()
            arrays |= {f"chain_{i}_rounded_{k}": v for k, v in corners}
    return document, arrays


def graph_of(
    document: Document, arrays: Arrays, models: Mapping[str, RobotModel], folder: Path
) -> TemporalPlanGraph:
    """Return the graph that a document and arrays describe.

    Args:
        document: what there is.
        arrays: the numbers.
        models: robot types by name, used before the registry and URDF files.
        folder: where URDF files are looked for.

    Raises:
        KeyError: something is missing.
        TypeError, ValueError, IndexError: something does not fit.
        OutputError: a robot has other joints than those of the plan.
        RobotModelError: a robot description is not there any more.
    """
    chains = tuple(
        NodeChain(
            robot,
            **{name: arrays[f"chain_{i}_{name}"] for name in _CHAIN_ARRAYS},
            drive=_drive(f"chain_{i}_", arrays),
            corners=_corners(f"chain_{i}_rounded_", arrays),
        )
        for i, robot in enumerate(document["chains"])
    )
    handlings = tuple(
        NodeHandling(**_values(entry, _NODE_HANDLING), pose=pose)
        for entry, pose in zip(
            document["handlings"], arrays["handling_pose"], strict=True
        )
    )
    allowed = tuple(
        AllowedContact(
            a["first"], a["second"], frozenset(a["tasks"]), a.get("grazing", False)
        )
        for a in document["allowed"]
    )
    return TemporalPlanGraph(
        _cell(document["cell"], arrays, models, folder),
        _tasks(document["tasks"], arrays),
        chains,
        handlings=handlings,
        allowed=allowed,
        products=arrays.get("products", np.empty(0, dtype=np.int64)),
        **{name: arrays[name] for name in _GRAPH_ARRAYS},
    )


def _drive(prefix: str, arrays: Arrays) -> Drive | None:
    """Return how the nodes of a chain are passed, None where plan.npz says nothing of it."""
    if f"{prefix}cruise" not in arrays:
        return None
    return Drive(*(arrays[f"{prefix}{field.name}"] for field in fields(Drive)))


def _corners(prefix: str, arrays: Arrays) -> RoundedCorners | None:
    """Return the corners of a chain that are rounded, None where there are none."""
    if f"{prefix}begin" not in arrays:
        return None
    names = [field.name for field in fields(RoundedCorners)]
    return RoundedCorners(*(arrays[f"{prefix}{name}"] for name in names))


def _entry(item: object, keys: Mapping[str, str]) -> Document:
    return {key: getattr(item, name) for key, name in keys.items()}


def _values(entry: Document, keys: Mapping[str, str]) -> dict[str, Any]:
    return {name: entry[key] for key, name in keys.items()}


def _shaped(
    item: Fixture | CellObject, keys: Mapping[str, str], arrays: Arrays
) -> Document:
    """Return what is written of a thing; a box is described by its size alone."""
    entry = _entry(item, keys) | {"body": item.shape.pieces[0].name}
    if not item.shape.is_box:
        entry["body"] = item.name
        entry["shape"] = shape_document(item.name, item.shape, arrays)
    return entry


def _fixture(item: Fixture, arrays: Arrays) -> Document:
    """Return what is written of a fixture: its colour only where it was given one."""
    colour = {} if item.colour is None else {"colour": list(item.colour)}
    return _shaped(item, _FIXTURE, arrays) | colour


def _shaped_values(
    entry: Document, keys: Mapping[str, str], size: Array, arrays: Arrays
) -> Document:
    if entry.get("shape") is None:
        shape = box_shape(entry["body"], size)
    else:
        shape = stored_shape(entry["name"], entry["shape"], arrays)
    return _values(entry, keys) | {"shape": shape}


def _cell_document(cell: Workcell, arrays: Arrays) -> Document:
    robots = []
    for i, robot in enumerate(cell.robots):
        model = robot.model
        arrays[f"robot_{i}_base"] = robot.base
        arrays[f"robot_{i}_home"] = robot.home
        arrays[f"robot_{i}_frames"] = _poses(model.frames.values())
        if robot.limits is not None:
            joints, caps = _limit_arrays(robot.limits)
            arrays |= {f"robot_{i}_limits": joints, f"robot_{i}_caps": caps}
        robots.append(
            {
                "name": robot.name,
                "model": model.name if model.name in ROBOTS else None,
                # Packaged robots are found by name; a plan is the same wherever it was made.
                "urdf": model.urdf.name if model.name in ROBOTS else str(model.urdf),
                "sha256": description_sha256(model),
                "joints": list(model.joint_names),
                "frames": list(model.frames),
            }
        )
    arrays["fixture_size"] = _stack((f.size for f in cell.fixtures), (3,))
    arrays["fixture_pose"] = _poses(f.pose for f in cell.fixtures)
    arrays["object_size"] = _stack((o.size for o in cell.objects), (3,))
    arrays["object_start"] = _poses(o.start for o in cell.objects)
    clearance = _entry(cell.clearances, _CLEARANCE)
    if cell.clearances.contact_depth == CONTACT_DEPTH:
        del clearance["contact_depth_m"]
    # Plans without machines are written as they were before there were any.
    machines = [item.name for item in cell.machines]
    return {
        "robots": robots,
        "fixtures": [_fixture(item, arrays) for item in cell.fixtures],
        "objects": [_shaped(item, _OBJECT, arrays) for item in cell.objects],
        "clearance": clearance,
    } | ({"machines": machines} if machines else {})


def _task_documents(tasks: Sequence[Task], arrays: Arrays) -> list[Document]:
    arrays["task_path"] = np.concatenate(
        [*(t.path.ravel() for t in tasks), np.empty(0)]
    )
    arrays["task_shape"] = np.array(
        [t.path.shape for t in tasks], dtype=np.int64
    ).reshape(-1, 2)
    arrays["task_handling_pose"] = _poses(h.pose for t in tasks for h in t.handlings)
    return [
        _entry(t, _TASK) | {"handlings": [_entry(h, _HANDLING) for h in t.handlings]}
        for t in tasks
    ]


def _cell(
    document: Document, arrays: Arrays, models: Mapping[str, RobotModel], folder: Path
) -> Workcell:
    robots = []
    for i, entry in enumerate(document["robots"]):
        name = entry["model"] or Path(entry["urdf"]).stem
        model = models.get(name) or robot_model(entry["model"] or entry["urdf"], folder)
        found = description_sha256(model)
        if entry.get("sha256") not in (None, found):
            raise RobotModelError(
                f"robot {entry['name']!r}: {model.urdf} or a mesh of it is not as it was when"
                f" the plan in {folder} was made"
            )
        if list(model.joint_names) != entry["joints"]:
            raise RobotModelError(
                f"robot {entry['name']!r}: {model.urdf} has the joints"
                f" {', '.join(model.joint_names)}; the plan in {folder} was made for"
                f" {', '.join(entry['joints'])}"
            )
        frames = dict(zip(entry["frames"], arrays[f"robot_{i}_frames"], strict=True))
        model = replace(model, frames=frames)
        base, home = arrays[f"robot_{i}_base"], arrays[f"robot_{i}_home"]
        limits = None
        if f"robot_{i}_limits" in arrays:
            joints = arrays[f"robot_{i}_limits"], arrays[f"robot_{i}_caps"]
            limits = _limits_of(*joints)
        robots.append(PlacedRobot(entry["name"], model, base, home, limits=limits))
    sizes, poses = arrays["fixture_size"], arrays["fixture_pose"]
    fixtures = []
    for entry, size, pose in zip(document["fixtures"], sizes, poses, strict=True):
        values = _shaped_values(entry, _FIXTURE, size, arrays)
        colour = tuple(entry["colour"]) if entry.get("colour") else None
        fixtures.append(Fixture(**values, pose=pose, colour=colour))
    sizes, starts = arrays["object_size"], arrays["object_start"]
    objects = []
    for entry, size, start in zip(document["objects"], sizes, starts, strict=True):
        values = _shaped_values({"later": False, **entry}, _OBJECT, size, arrays)
        values["colour"] = tuple(values["colour"])
        objects.append(CellObject(**values, start=start))
    given = {**_USUAL_CLEARANCE, **document["clearance"]}
    clearances = Clearances(**_values(given, _CLEARANCE))
    machines = tuple(map(machine, document.get("machines", ())))
    return Workcell(
        tuple(robots), tuple(fixtures), tuple(objects), clearances, machines
    )


def _tasks(document: list[Document], arrays: Arrays) -> tuple[Task, ...]:
    shape = arrays["task_shape"]
    bounds = np.cumsum([0, *np.prod(shape, axis=1)])
    poses = iter(arrays["task_handling_pose"])
    out = []
    for k, entry in enumerate(document):
        path = arrays["task_path"][bounds[k] : bounds[k + 1]].reshape(shape[k])
        handlings = tuple(
            Handling(**_values(h, _HANDLING), pose=next(poses))
            for h in entry["handlings"]
        )
        values = _values({"goal": False, **entry}, _TASK)
        out.append(Task(**values, path=path, handlings=handlings))
    return tuple(out)


def _limit_arrays(limits: MotionLimits) -> tuple[Array, Array]:
    """Return limits of joints and of the whole robot as arrays in which 0 stands for none."""
    joints = np.array([limits.velocity, limits.acceleration, limits.jerk])
    caps = limits.sum_of_speeds, limits.tool_speed, limits.loaded_tool_speed
    return np.where(np.isfinite(joints), joints, 0.0), np.where(
        np.isfinite(caps), caps, 0.0
    )


def _limits_of(joints: Array, caps: Array) -> MotionLimits:
    velocity, acceleration, jerk = np.where(joints > 0.0, joints, np.inf)
    return MotionLimits(
        velocity, acceleration, jerk, *np.where(caps > 0.0, caps, np.inf).tolist()
    )


def _stack(values: Iterable[Array], shape: tuple[int, ...]) -> Array:
    return np.array(list(values), dtype=np.float64).reshape(-1, *shape)


def _poses(values: Iterable[Array]) -> Array:
    return _stack(values, (4, 4))
