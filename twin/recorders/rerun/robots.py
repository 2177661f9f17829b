"""Robots in the Rerun recording: shapes from their URDF, joints that move."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import numpy.typing as npt
import rerun as rr
from rerun.urdf import UrdfTree

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import PlacedRobot
from planning.robots.registry import ROBOTS
from planning.robots.urdf_file import find_mesh
from planning.transforms import Array, quat_wxyz
from twin.durations import NANOSECONDS, Nanoseconds
from twin.run.trajectory import Trajectory

WORLD_FRAME = "world"
TIMELINE = "sim_time"

_FRAME_S = 0.05
_FRAME_STEP = 0.02


def time_column(t_ns: npt.ArrayLike) -> rr.TimeColumn:
    """Return simulated times [ns] as the recording's only timeline."""
    exact = np.asarray(t_ns, dtype=np.int64).astype("timedelta64[ns]")
    return rr.TimeColumn(TIMELINE, duration=exact)


def frame_name(robot: str, link: str) -> str:
    """Return the name of a link's frame in the recording."""
    return f"{robot}/{link}"


def flange_frame(robot: str) -> str:
    """Return the name of the frame that held objects hang on."""
    return frame_name(robot, "@flange")


def entity_path(*parts: str) -> str:
    """Return the path of an entity whose parts may hold any character."""
    return "/" + "/".join(rr.escape_entity_path_part(part) for part in parts)


def robot_part(robot: str) -> str:
    """Return the path part under which a robot is drawn: one part, as the loader needs."""
    return f"robot-{robot}"


def log_robot(rec: rr.RecordingStream, robot: PlacedRobot, motion: Trajectory) -> None:
    """Draw a robot and move it along its trajectory."""
    move_robot(rec, draw_robot(rec, robot), robot, motion)


def draw_robot(rec: rr.RecordingStream, robot: PlacedRobot) -> UrdfTree:
    """Draw a robot, and return its links and joints to move it with."""
    part = robot_part(robot.name)
    entity = entity_path(part)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / robot.model.urdf.name
        _write_with_absolute_meshes(robot.model, path)
        tree = UrdfTree.from_file_path(
            path,
            entity_path_prefix=part,
            frame_prefix=f"{robot.name}/",
            static_transform_entity_path=f"{entity}/fixed",
        )
        _log_shapes(rec, tree, part)
    root = tree.root_link().name
    _log_pose(rec, f"{entity}/base", robot.base, WORLD_FRAME, f"{robot.name}/{root}")
    joints = {joint.name: joint for joint in tree.joints()}
    tip = joints[robot.model.joint_names[-1]].child_link
    parent = frame_name(robot.name, tip.removeprefix(f"{robot.name}/"))
    _log_pose(
        rec, f"{entity}/flange", robot.model.flange, parent, flange_frame(robot.name)
    )
    return tree


def _log_shapes(rec: rr.RecordingStream, tree: UrdfTree, part: str) -> None:
    """Draw what a URDF shows, in full colour; collision shapes only where it shows nothing."""
    chunks = list(tree.stream())
    visual = entity_path(part, tree.name, "visual_geometries")
    collision = entity_path(part, tree.name, "collision_geometries")
    if any(chunk.entity_path.startswith(visual) for chunk in chunks):
        chunks = [c for c in chunks if not c.entity_path.startswith(collision)]
    rr.send_chunks(chunks, recording=rec)
    # Primitives come as wire frames unless told otherwise.
    for chunk in chunks:
        columns = " ".join(chunk.to_record_batch().schema.names)
        for shape in (rr.Boxes3D, rr.Cylinders3D, rr.Ellipsoids3D):
            if f"{shape.__name__}:" in columns:
                solid = shape.from_fields(fill_mode=rr.components.FillMode.Solid)
                rec.log(chunk.entity_path, solid, static=True)


def move_robot(
    rec: rr.RecordingStream, tree: UrdfTree, robot: PlacedRobot, motion: Trajectory
) -> None:
    """Move a robot that has been drawn along a trajectory, or a piece of one."""
    t_ns = frame_times(motion)
    q = motion.at(t_ns)
    part = robot_part(robot.name)
    columns = {name: q[:, j] for j, name in enumerate(robot.model.joint_names)}
    entry = ROBOTS.get(robot.model.name)
    held = dict(entry.frozen) if entry else {}
    for joint in tree.joints():
        if joint.name in columns:
            values = columns[joint.name]
            moves = np.append(True, np.diff(values) != 0.0)
            rec.send_columns(
                entity_path(part, "joints", joint.name),
                indexes=[time_column(t_ns[moves])],
                columns=joint.compute_transform_columns(
                    values[moves].tolist(), clamp=False
                ),
            )
        elif joint.name in held:
            rec.send_columns(
                entity_path(part, "joints", joint.name),
                indexes=[time_column([0])],
                columns=joint.compute_transform_columns(
                    [held[joint.name]], clamp=False
                ),
            )


def frame_times(motion: Trajectory) -> Nanoseconds:
    """Return times at which to show a robot so that its motion looks smooth, shape (f,) [ns].

    Rerun holds a pose until the next: a motion between rows is cut into pieces of at most 50 ms
    or 0.02 rad or m of every joint, whichever are longer. A robot that stands needs no pieces.
    """
    span_s = np.diff(motion.t_ns) / NANOSECONDS
    step = np.max(np.abs(np.diff(motion.q, axis=0)), axis=1, initial=0.0)
    pieces = np.minimum(np.ceil(span_s / _FRAME_S), np.ceil(step / _FRAME_STEP))
    count = np.maximum(pieces, 1.0).astype(np.int64)
    start = np.repeat(motion.t_ns[:-1], count)
    number = np.arange(len(start)) - np.repeat(np.cumsum(count) - count, count)
    length = np.repeat(np.diff(motion.t_ns), count)
    cut = start + number * length // np.repeat(count, count)
    return np.unique(np.append(cut, motion.t_ns[-1]))


def _log_pose(
    rec: rr.RecordingStream, entity: str, pose: Array, parent: str, child: str
) -> None:
    rec.log(
        entity,
        rr.Transform3D(
            translation=pose[:3, 3],
            quaternion=rr.Quaternion(xyzw=quat_xyzw(pose)),
            parent_frame=parent,
            child_frame=child,
        ),
        static=True,
    )


def quat_xyzw(pose: Array) -> Array:
    """Return a rotation as Rerun wants it: (x, y, z, w)."""
    return np.roll(quat_wxyz(pose), -1)


def _write_with_absolute_meshes(model: RobotModel, path: Path) -> None:
    """Copy a URDF with every mesh path made absolute: package roots differ between sources."""
    tree = ElementTree.parse(model.urdf)
    for mesh in tree.getroot().iter("mesh"):
        found = find_mesh(mesh.get("filename", ""), model.package_dirs)
        if found is not None:
            mesh.set("filename", str(found.resolve()))
    tree.write(path)
