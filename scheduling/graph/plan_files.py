"""Temporal plan graphs as files: plan.json says what there is, plan.npz holds the numbers.

plan.json is a ``PlanDocument`` with format, version and the sum of plan.npz. ``model`` of a robot is
a name of the registry; null says that the robot is read from ``urdf``, which then lies with its
meshes beside the plan. ``sha256`` is that of the description and the meshes that the robot
collides with: a plan is refused when they have changed.

plan.npz has the columns of ``TemporalPlanGraph``, and of its chains as ``chain_<i>_`` and
``chain_<i>_rounded_``; rows are in the order of plan.json, poses (4, 4) matrices; SI units:
    robot_<i>_base (4, 4), robot_<i>_home (n,), robot_<i>_frames (f, 4, 4); where it keeps to limits
    robot_<i>_limits (3, n) and robot_<i>_caps (3,), in which 0 is none
    shape_<name>_pose (e, 4, 4); of element k, a mesh, shape_<name>_<k>_{vertices (v, 3),
    faces (f, 3), corners (of all hulls, 3), centre (3,)}
    fixture_size (f, 3), fixture_pose (f, 4, 4), object_size (o, 3), object_start (o, 4, 4)
    task_path (all values), task_shape (tasks, 2), task_handling_pose (h, 4, 4),
    handling_pose (h, 4, 4), products (tasks,) where there are several
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from planning.cell.robot_model import RobotModel
from planning.errors import OutputError
from planning.files import NPZ_ERRORS, arrays_text, read_file, read_npz, replacing
from planning.robots.descriptions.xml_files import copy_description
from scheduling.graph.document import PlanDocument, read_graph, write_graph
from scheduling.graph.plan_checks import check_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph

FORMAT = "assembly-twin temporal plan graph"
VERSION = 1

LARGEST_BYTES = 2**30
"""Most that the arrays of a plan may take in memory: 500 times the largest shipped one."""

_AGAIN = "it was written by another version of this program; plan again"


def save_plan(tpg: TemporalPlanGraph, folder: Path) -> None:
    """Write ``plan.json`` and ``plan.npz`` into a folder, which is made if need be.

    Args:
        tpg: the graph.
        folder: where the files go; older ones are replaced.

    Raises:
        OutputError: the files cannot be written.
    """
    described, arrays = write_graph(tpg)
    for robot, placed in zip(described.cell.robots, tpg.cell.robots, strict=True):
        if robot.model is None and robot.sha256 is not None:
            own = folder / "robots" / robot.sha256[:12]
            copied = copy_description(placed.model, own)
            robot.urdf = copied.relative_to(folder).as_posix()
    buffer = BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    content = buffer.getvalue()
    document = {
        "format": FORMAT,
        "version": VERSION,
        "arrays_sha256": sha256(content).hexdigest(),
        **described.model_dump(mode="json", by_alias=True),
    }
    text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write the plan to {folder}: {error}") from error
    for name, written in (("plan.npz", content), ("plan.json", text.encode())):
        with replacing(folder / name) as temporary:
            temporary.write_bytes(written)


def plan_sha256(tpg: TemporalPlanGraph) -> str:
    """Return a hash of all that a plan says, wherever its robots' descriptions lie."""
    document, arrays = write_graph(tpg)
    for robot in document.cell.robots:
        robot.urdf = ""
    digest = sha256(document.model_dump_json().encode())
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
        described = PlanDocument.model_validate_json(text)
        described.check_names()
        arrays = read_npz(content, kinds="fiub", most=LARGEST_BYTES)
        for name, values in arrays.items():
            # Robots stay as cells build them: numba compiles read-only arrays anew.
            if not name.startswith("robot_"):
                values.setflags(write=False)
        tpg = read_graph(described, arrays, models or {}, folder)
        check_plan(tpg)
    except KeyError as error:
        # The arrays are those that belong to it, so what is missing was not written.
        raise OutputError(
            f"the plan in {folder} has no {error.args[0]!r}: {_AGAIN}"
        ) from error
    except OutputError as error:
        raise OutputError(f"the plan in {folder} is damaged: {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        wrong = f"{place}: {first['msg']}"
        raise OutputError(f"the plan in {folder} is damaged: {wrong}") from None
    except NPZ_ERRORS as error:
        raise OutputError(f"{folder / 'plan.npz'} holds no arrays: {error}") from error
    return tpg
