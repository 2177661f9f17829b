"""Robots in the Rerun recording: what they look like, their names, how they move."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import rerun as rr
from rerun.urdf import UrdfTree

from planning.cell.workcell import PlacedRobot
from planning.robots.registry import ROBOTS
from twin.drawing.painted_description import painted_description
from twin.durations import NANOSECONDS, Nanoseconds
from twin.recorders.rerun.layout import WORLD_FRAME, entity_path, robot_part
from twin.recorders.rerun.linear_colours import make_linear
from twin.recorders.rerun.time_and_pose import fixed_pose, time_column
from twin.run.team_colours import rgb
from twin.run.trajectory import Trajectory

_FRAME_S = 0.05
"""Least time between two frames [s]."""

_FRAME_STEP = 0.02
"""Motion of a joint that is worth a frame [rad or m]."""

_NAME_COLOUR = (255, 255, 255)  # names stand on dark plates


def flange_frame(robot: str) -> str:
    """Return the name of the frame that held objects hang on."""
    return f"{robot}/@flange"


def name_entity(robot: str) -> str:
    """Return the path of the entity that shows a robot's name."""
    return f"{entity_path(robot_part(robot))}/name"


def _link_frame(robot: str, link: str) -> str:
    return f"{robot}/{link.removeprefix(f'{robot}/')}"


def draw_robot(rec: rr.RecordingStream, robot: PlacedRobot, colour: str) -> UrdfTree:
    """Draw a robot in its colour, #rrggbb; return the joints to move it with.

    There is a place for its name at its foot, and none yet.
    """
    part = robot_part(robot.name)
    entity = entity_path(part)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / robot.model.urdf.name
        painted = painted_description(robot, rgb(colour))
        make_linear(painted.getroot())
        painted.write(path)
        tree = UrdfTree.from_file_path(
            path,
            entity_path_prefix=part,
            frame_prefix=f"{robot.name}/",
            static_transform_entity_path=f"{entity}/fixed",
        )
        _log_shapes(rec, tree, part)
    joints = {joint.name: joint for joint in tree.joints()}
    names = robot.model.joint_names
    root = _link_frame(robot.name, tree.root_link().name)
    tip = _link_frame(robot.name, joints[names[-1]].child_link)
    base, hand = robot.base, robot.model.flange
    rec.log(f"{entity}/base", fixed_pose(base, WORLD_FRAME, root), static=True)
    rec.log(
        f"{entity}/flange",
        fixed_pose(hand, tip, flange_frame(robot.name)),
        static=True,
    )
    entry = ROBOTS.get(robot.model.name)
    for name, value in (entry.frozen if entry else {}).items():
        # All joints are drawn at zero for good; what has a row in time stands there instead.
        rec.send_columns(
            entity_path(part, "joints", name),
            indexes=[time_column([0])],
            columns=joints[name].compute_transform_columns([value], clamp=False),
        )
    foot = joints[names[3 if robot.model.is_mobile else 0]].parent_link
    rec.log(
        name_entity(robot.name),
        rr.CoordinateFrame(_link_frame(robot.name, foot)),
        rr.Points3D.from_fields(
            positions=[[0.0, 0.0, 0.0]],
            radii=[0.001],
            colors=[_NAME_COLOUR],
            show_labels=True,
        ),
        static=True,
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
    column = {name: j for j, name in enumerate(robot.model.joint_names)}
    for joint in tree.joints():
        if joint.name not in column:
            continue
        values = q[:, column[joint.name]]
        changes = np.append(True, np.diff(values) != 0.0)
        rec.send_columns(
            entity_path(part, "joints", joint.name),
            indexes=[time_column(t_ns[changes])],
            columns=joint.compute_transform_columns(
                values[changes].tolist(), clamp=False
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
