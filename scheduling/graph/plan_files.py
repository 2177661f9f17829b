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
from collections.abc import Mapping
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.errors import OutputError
from scheduling.graph.plan_document import graph_document, graph_of
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph

FORMAT = "assembly-twin temporal plan graph"
VERSION = 1

_AGAIN = "it was written by another version of this program; plan again"


def save_plan(tpg: TemporalPlanGraph, folder: Path) -> None:
    """Write ``plan.json`` and ``plan.npz`` into a folder, which is made if need be.

    Args:
        tpg: the graph.
        folder: where the files go; older ones are replaced.

    Raises:
        OutputError: the files cannot be written, or a fixture or object is no box.
    """
    described, arrays = graph_document(tpg)
    buffer = BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    content = buffer.getvalue()
    document = {
        "format": FORMAT,
        "version": VERSION,
        "arrays_sha256": sha256(content).hexdigest(),
        **described,
    }
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
            arrays = {name: archive[name] for name in archive.files}
        for name, values in arrays.items():
            # Robots stay as cells build them: numba compiles read-only arrays anew.
            if not name.startswith("robot_"):
                values.setflags(write=False)
        return graph_of(document, arrays, models or {}, folder)
    except KeyError as error:
        # The arrays are those that belong to it, so what is missing was not written.
        raise OutputError(
            f"the plan in {folder} has no {error.args[0]!r}: {_AGAIN}"
        ) from error
    except (TypeError, ValueError, IndexError, zipfile.BadZipFile) as error:
        raise OutputError(
            f"the plan in {folder} is damaged: {type(error).__name__}: {error}"
        ) from error


def _replace_file(path: Path, content: bytes) -> None:
    """Write a file that is there whole or not at all."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(content)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
