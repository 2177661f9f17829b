"""Temporal plan graphs as files: plan.json says what there is, plan.npz holds the numbers.

plan.json, version 1, or 2 where a shape is no box, or 3 where a corner is rounded:
    format, version, arrays_sha256 (of plan.npz)
    cell       robots [{name, model, urdf, sha256, joints, frames}], fixtures [{name, body,
               colour where it was given one}],
               objects [{name, kind, body, mass_kg, fixed, colour, later}]; what is no box has
               shape [{form, and what it measures}] beside that,
               clearance {robot_robot_m, robot_object_m, contact_tolerance_m, contact_depth_m
               where it is not 0.003},
               machines [name] where there are any
    tasks      [{index, robot, kind, step, label, object, goal, handlings [{object, waypoint, holder}]}]
    chains     [robot]
    handlings  [{object, chain, node, waypoint, holder}]
    allowed    [{first, second, tasks, grazing where it is true}]
``model`` is a name of the robot registry; null says that the robot is read from ``urdf``, which
then lies with its meshes beside the plan. ``sha256`` is that of the description and the meshes
that the robot collides with: a plan is refused when they have changed.

plan.npz (rows in the order of plan.json; poses are (4, 4) matrices; SI units):
    robot_<i>_base (4, 4), robot_<i>_home (n,), robot_<i>_frames (f, 4, 4)
    shape_<name>_pose (e, 4, 4); of element k, a mesh, shape_<name>_<k>_{vertices (v, 3),
    faces (f, 3), corners (of all hulls, 3), centre (3,)}
    fixture_size (f, 3), fixture_pose (f, 4, 4), object_size (o, 3), object_start (o, 4, 4)
    task_path (all values), task_shape (tasks, 2), task_handling_pose (h, 4, 4)
    chain_<i>_{start, waypoints, fraction, first, task, skill, duration, planned_start}, and
    {cruise, ramp, lag, rests, cap} with robot_<i>_limits (3, n) and robot_<i>_caps (3,) where
    robots keep to limits of acceleration; a limit of 0 is none; of rounded corners, where there
    are any, chain_<i>_rounded_{begin (k,), stop (k,), corner (k, n)}
    handling_pose (h, 4, 4), edges (e, 4), cause (e,), dependencies (d, 2),
    slots (tasks or 0,), products (tasks,) where there are several
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.errors import OutputError
from planning.files import NPZ_ERRORS, arrays_text, read_file, read_npz, replacing
from planning.robots.descriptions.xml_files import copy_description
from scheduling.graph.arrays import LARGEST_BYTES, check_arrays, check_limits
from scheduling.graph.document import Document, graph_document, graph_of
from scheduling.graph.schema import check_document
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph

FORMAT = "assembly-twin temporal plan graph"
VERSION = 1
VERSION_OF_SHAPES = 2
"""Of plans in which something is no box: earlier programs would take it for one."""
VERSION_OF_CORNERS = 3
"""Of plans with rounded corners: earlier programs would take their chords for the way."""
_VERSIONS = VERSION, VERSION_OF_SHAPES, VERSION_OF_CORNERS

_AGAIN = "it was written by another version of this program; plan again"


def save_plan(tpg: TemporalPlanGraph, folder: Path) -> None:
    """Write ``plan.json`` and ``plan.npz`` into a folder, which is made if need be.

    Args:
        tpg: the graph.
        folder: where the files go; older ones are replaced.

    Raises:
        OutputError: the files cannot be written.
    """
    described, arrays = graph_document(tpg)
    for robot, placed in zip(described["cell"]["robots"], tpg.cell.robots, strict=True):
        if robot["model"] is None and robot["sha256"] is not None:
            own = folder / "robots" / robot["sha256"][:12]
            copied = copy_description(placed.model, own)
            robot["urdf"] = copied.relative_to(folder).as_posix()
    buffer = BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    content = buffer.getvalue()
    document = {
        "format": FORMAT,
        "version": _version_of(tpg, described),
        "arrays_sha256": sha256(content).hexdigest(),
        **described,
    }
    text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write the plan to {folder}: {error}") from error
    for name, written in (("plan.npz", content), ("plan.json", text.encode())):
        with replacing(folder / name) as temporary:
            temporary.write_bytes(written)


def _version_of(tpg: TemporalPlanGraph, described: Document) -> int:
    """Return the version of a plan: the least that says all of it."""
    if any(chain.corners is not None for chain in tpg.chains):
        return VERSION_OF_CORNERS
    return VERSION_OF_SHAPES if _has_shapes(described) else VERSION


def _has_shapes(described: Document) -> bool:
    """Tell whether something in a plan is no box."""
    cell = described["cell"]
    return any("shape" in item for item in (*cell["fixtures"], *cell["objects"]))


def plan_sha256(tpg: TemporalPlanGraph) -> str:
    """Return a hash of all that a plan says, wherever its robots' descriptions lie."""
    document, arrays = graph_document(tpg)
    for robot in document["cell"]["robots"]:
        del robot["urdf"]
    digest = sha256(json.dumps(document, sort_keys=True).encode())
    for piece in arrays_text(arrays):
        digest.update(piece)
    return digest.hexdigest()


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
        text = read_file(folder / "plan.json", LARGEST_BYTES).decode("utf-8")
        content = read_file(folder / "plan.npz", LARGEST_BYTES)
    except (OSError, UnicodeDecodeError) as error:
        raise OutputError(f"cannot read the plan in {folder}: {error}") from error
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise OutputError(f"{folder / 'plan.json'} is damaged: {error}") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise OutputError(f"{folder / 'plan.json'} holds no temporal plan graph")
    if document.get("version") not in _VERSIONS:
        raise OutputError(
            f"{folder / 'plan.json'} has format version {document.get('version')}: {_AGAIN}",
            choices=tuple(map(str, _VERSIONS)),
        )
    if sha256(content).hexdigest() != document.get("arrays_sha256"):
        raise OutputError(
            f"{folder / 'plan.npz'} is damaged or belongs to another plan.json"
        )
    try:
        check_document(document)
        arrays = read_npz(content, kinds="fiub", most=LARGEST_BYTES)
        check_arrays(document, arrays)
        for name, values in arrays.items():
            # Robots stay as cells build them: numba compiles read-only arrays anew.
            if not name.startswith("robot_"):
                values.setflags(write=False)
        tpg = graph_of(document, arrays, models or {}, folder)
        check_limits(tpg)
    except KeyError as error:
        # The arrays are those that belong to it, so what is missing was not written.
        raise OutputError(
            f"the plan in {folder} has no {error.args[0]!r}: {_AGAIN}"
        ) from error
    except OutputError as error:
        raise OutputError(f"the plan in {folder} is damaged: {error}") from None
    except NPZ_ERRORS as error:
        raise OutputError(f"{folder / 'plan.npz'} holds no arrays: {error}") from error
    return tpg
