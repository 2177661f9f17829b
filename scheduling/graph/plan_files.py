"""Temporal plan graphs as files: plan.json says what there is, plan.npz holds the numbers.

plan.json, version 1:
    format, version, arrays_sha256 (of plan.npz)
    cell       robots [{name, model, urdf, joints, frames}], fixtures [{name, body}],
               objects [{name, kind, body, mass_kg, fixed, colour, later}],
               clearance {robot_robot_m, robot_object_m}
    tasks      [{index, robot, kind, step, label, object, goal, handlings [{object, waypoint, holder}]}]
    chains     [robot]
    handlings  [{object, chain, node, waypoint, holder}]
    allowed    [{first, second, tasks}]
``model`` is a name of the robot registry; null says that the robot is read from ``urdf``.

plan.npz (rows in the order of plan.json; poses are (4, 4) matrices; SI units):
    robot_<i>_base (4, 4), robot_<i>_home (n,), robot_<i>_frames (f, 4, 4)
    fixture_size (f, 3), fixture_pose (f, 4, 4), object_size (o, 3), object_start (o, 4, 4)
    task_path (all values), task_shape (tasks, 2), task_handling_pose (h, 4, 4)
    chain_<i>_{start, waypoints, fraction, first, task, skill, duration, planned_start}
    handling_pose (h, 4, 4), edges (e, 4), cause (e,), dependencies (d, 2),
    slots (tasks or 0,)
"""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.cell.cover import box_body
from planning.cell.robot_model import RobotModel
from planning.cell.workcell import (
    CellObject,
    Clearances,
    Fixture,
    PlacedRobot,
    Workcell,
)
from planning.errors import OutputError
from planning.robots.registry import ROBOTS, robot_model
from planning.tasks.task_graph import AllowedContact, Handling, Task
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)

FORMAT = "assembly-twin temporal plan graph"
VERSION = 1

_AGAIN = "it was written by another version of this program; plan again"

_Arrays = dict[str, npt.NDArray[Any]]
_CHAIN_ARRAYS = tuple(f.name for f in fields(NodeChain) if f.name != "robot")


def save_plan(tpg: TemporalPlanGraph, folder: Path) -> None:
    """Write ``plan.json`` and ``plan.npz`` into a folder, which is made if need be.

    Args:
        tpg: the graph.
        folder: where the files go; older ones are replaced.

    Raises:
        OutputError: the files cannot be written, or a fixture or object is no box.
    """
    arrays: _Arrays = {
        "edges": tpg.edges,
        "cause": tpg.cause,
        "dependencies": tpg.dependencies,
        "slots": tpg.slots,
    }
    document = {
        "format": FORMAT,
        "version": VERSION,
        "arrays_sha256": "",
        "cell": _cell_document(tpg.cell, arrays),
        "tasks": _tasks_document(tpg.tasks, arrays),
        "chains": [chain.robot for chain in tpg.chains],
        "handlings": [
            {
                "object": h.object,
                "chain": h.robot,
                "node": h.node,
                "waypoint": h.waypoint,
                "holder": h.holder,
            }
            for h in tpg.handlings
        ],
        "allowed": [
            {"first": a.first, "second": a.second, "tasks": sorted(a.tasks)}
            for a in tpg.allowed
        ],
    }
    arrays["handling_pose"] = _poses([h.pose for h in tpg.handlings])
    for i, chain in enumerate(tpg.chains):
        for name in _CHAIN_ARRAYS:
            arrays[f"chain_{i}_{name}"] = getattr(chain, name)
    buffer = BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    content = buffer.getvalue()
    document["arrays_sha256"] = sha256(content).hexdigest()
    text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _replace_file(folder / "plan.npz", content)
        _replace_file(folder / "plan.json", text.encode())
    except OSError as error:
        raise OutputError(f"cannot write the plan to {folder}: {error}") from error


def load_plan(
    folder: Path, models: Mapping[str, RobotModel] | None = None
) -> TemporalPlanGraph:
    """Return the graph that ``save_plan`` wrote into a folder.

    Args:
        folder: where ``plan.json`` and ``plan.npz`` are.
        models: robot types by name, used before the registry and URDF files.

    Raises:
        OutputError: a file is missing, damaged, of another version, or not of one plan.
        RobotModelError: a robot description is not there any more.
    """
    try:
        text = (folder / "plan.json").read_text(encoding="utf-8")
        content = (folder / "plan.npz").read_bytes()
    except (OSError, UnicodeDecodeError) as error:
        raise OutputError(f"cannot read the plan in {folder}: {error}") from error
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise OutputError(f"{folder / 'plan.json'} is damaged: {error}") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise OutputError(f"{folder / 'plan.json'} holds no temporal plan graph")
    if document.get("version") != VERSION:
        raise OutputError(
            f"{folder / 'plan.json'} has format version {document.get('version')}: {_AGAIN}",
            choices=(str(VERSION),),
        )
    if sha256(content).hexdigest() != document.get("arrays_sha256"):
        raise OutputError(
            f"{folder / 'plan.npz'} is damaged or belongs to another plan.json"
        )
    try:
        with np.load(BytesIO(content), allow_pickle=False) as archive:
            arrays: _Arrays = {name: archive[name] for name in archive.files}
        for name, values in arrays.items():
            # Robots stay as cells build them: numba compiles read-only arrays anew.
            if not name.startswith("robot_"):
                values.setflags(write=False)
        return _graph(document, arrays, models or {}, folder)
    except KeyError as error:
        # The arrays are those that belong to it, so what is missing was not written.
        raise OutputError(
            f"the plan in {folder} has no {error.args[0]!r}: {_AGAIN}"
        ) from error
    except (TypeError, ValueError, IndexError, zipfile.BadZipFile) as error:
        raise OutputError(
            f"the plan in {folder} is damaged: {type(error).__name__}: {error}"
        ) from error


def _cell_document(cell: Workcell, arrays: _Arrays) -> dict[str, Any]:
    robots = []
    for i, robot in enumerate(cell.robots):
        model = robot.model
        arrays[f"robot_{i}_base"] = robot.base
        arrays[f"robot_{i}_home"] = robot.home
        arrays[f"robot_{i}_frames"] = _poses(list(model.frames.values()))
        robots.append(
            {
                "name": robot.name,
                "model": model.name if model.name in ROBOTS else None,
                "urdf": str(model.urdf),
                "joints": list(model.joint_names),
                "frames": list(model.frames),
            }
        )
    things: list[Fixture | CellObject] = [*cell.fixtures, *cell.objects]
    for thing in things:
        box = box_body(thing.body.name, thing.size)
        if not np.array_equal(box.vertices, thing.body.vertices):
            raise OutputError(
                f"{thing.name!r} is no box: its shape cannot be written to a plan"
            )
    arrays["fixture_size"] = _stack([f.size for f in cell.fixtures], (3,))
    arrays["fixture_pose"] = _poses([f.pose for f in cell.fixtures])
    arrays["object_size"] = _stack([o.size for o in cell.objects], (3,))
    arrays["object_start"] = _poses([o.start for o in cell.objects])
    return {
        "robots": robots,
        "fixtures": [{"name": f.name, "body": f.body.name} for f in cell.fixtures],
        "objects": [
            {
                "name": o.name,
                "kind": o.kind,
                "body": o.body.name,
                "mass_kg": o.mass,
                "fixed": o.fixed,
                "colour": list(o.colour),
                "later": o.later,
            }
            for o in cell.objects
        ],
        "clearance": {
            "robot_robot_m": cell.clearances.robot_robot,
            "robot_object_m": cell.clearances.robot_object,
        },
    }


def _tasks_document(tasks: Sequence[Task], arrays: _Arrays) -> list[dict[str, Any]]:
    arrays["task_path"] = np.concatenate(
        [*(t.path.ravel() for t in tasks), np.empty(0)]
    )
    arrays["task_shape"] = np.array([t.path.shape for t in tasks]).reshape(-1, 2)
    arrays["task_handling_pose"] = _poses([h.pose for t in tasks for h in t.handlings])
    return [
        {
            "index": t.index,
            "robot": t.robot,
            "kind": t.kind,
            "step": t.step,
            "label": t.label,
            "object": t.object,
            "goal": t.goal,
            "handlings": [
                {"object": h.object, "waypoint": h.waypoint, "holder": h.holder}
                for h in t.handlings
            ],
        }
        for t in tasks
    ]


def _graph(
    document: dict[str, Any],
    arrays: _Arrays,
    models: Mapping[str, RobotModel],
    folder: Path,
) -> TemporalPlanGraph:
    chains = tuple(
        NodeChain(
            robot, **{name: arrays[f"chain_{i}_{name}"] for name in _CHAIN_ARRAYS}
        )
        for i, robot in enumerate(document["chains"])
    )
    handlings = tuple(
        NodeHandling(
            h["object"], h["chain"], h["node"], h["waypoint"], h["holder"], pose
        )
        for h, pose in zip(document["handlings"], arrays["handling_pose"], strict=True)
    )
    allowed = tuple(
        AllowedContact(a["first"], a["second"], frozenset(a["tasks"]))
        for a in document["allowed"]
    )
    return TemporalPlanGraph(
        _cell(document["cell"], arrays, models, folder),
        _tasks(document["tasks"], arrays),
        chains,
        arrays["edges"],
        arrays["cause"],
        handlings,
        allowed,
        arrays["dependencies"],
        arrays["slots"],
    )


def _cell(
    document: dict[str, Any],
    arrays: _Arrays,
    models: Mapping[str, RobotModel],
    folder: Path,
) -> Workcell:
    robots = []
    for i, entry in enumerate(document["robots"]):
        name = entry["model"] or Path(entry["urdf"]).stem
        model = models.get(name) or robot_model(entry["model"] or entry["urdf"], folder)
        if list(model.joint_names) != entry["joints"]:
            raise OutputError(
                f"robot {entry['name']!r}: {model.urdf} has the joints"
                f" {', '.join(model.joint_names)}; the plan in {folder} was made for"
                f" {', '.join(entry['joints'])}"
            )
        frames = dict(zip(entry["frames"], arrays[f"robot_{i}_frames"], strict=True))
        robots.append(
            PlacedRobot(
                entry["name"],
                replace(model, frames=frames),
                arrays[f"robot_{i}_base"],
                arrays[f"robot_{i}_home"],
            )
        )
    fixtures = tuple(
        Fixture(f["name"], size, pose, box_body(f["body"], size))
        for f, size, pose in zip(
            document["fixtures"],
            arrays["fixture_size"],
            arrays["fixture_pose"],
            strict=True,
        )
    )
    objects = tuple(
        CellObject(
            o["name"],
            o["kind"],
            size,
            start,
            box_body(o["body"], size),
            o["mass_kg"],
            o["fixed"],
            (o["colour"][0], o["colour"][1], o["colour"][2]),
            o.get("later", False),
        )
        for o, size, start in zip(
            document["objects"],
            arrays["object_size"],
            arrays["object_start"],
            strict=True,
        )
    )
    clearance = document["clearance"]
    return Workcell(
        tuple(robots),
        fixtures,
        objects,
        Clearances(clearance["robot_robot_m"], clearance["robot_object_m"]),
    )


def _tasks(document: list[dict[str, Any]], arrays: _Arrays) -> tuple[Task, ...]:
    shape = arrays["task_shape"]
    bounds = np.cumsum([0, *np.prod(shape, axis=1)])
    pose_of = iter(arrays["task_handling_pose"])
    out = []
    for k, entry in enumerate(document):
        handlings = tuple(
            Handling(h["object"], h["waypoint"], h["holder"], next(pose_of))
            for h in entry["handlings"]
        )
        out.append(
            Task(
                entry["index"],
                entry["robot"],
                entry["kind"],
                entry["step"],
                entry["label"],
                arrays["task_path"][bounds[k] : bounds[k + 1]].reshape(shape[k]),
                handlings,
                entry["object"],
                entry.get("goal", False),
            )
        )
    return tuple(out)


def _stack(values: Sequence[Array], shape: tuple[int, ...]) -> Array:
    return np.array(values, dtype=np.float64).reshape(-1, *shape)


def _poses(values: Sequence[Array]) -> Array:
    return _stack(values, (4, 4))


def _replace_file(path: Path, content: bytes) -> None:
    """Write a file that is there whole or not at all."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(content)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
