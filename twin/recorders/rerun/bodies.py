"""Robots, fixtures and objects in the Rerun recording: what they look like, how they move."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import rerun as rr
from rerun.urdf import UrdfTree

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.robots.registry import ROBOTS
from planning.robots.urdf_file import find_mesh
from planning.transforms import Array, quat_wxyz
from twin.durations import NANOSECONDS, Nanoseconds
from twin.recorders.rerun import layout as layout
from twin.recorders.rerun.layout import WORLD_FRAME, entity_path, robot_part
from twin.run.trajectory import Placement, Trajectory
from twin.run.viewer import TIMELINE

_FRAME_S = 0.05
_FRAME_STEP = 0.02


def time_column(t_ns: npt.ArrayLike) -> rr.TimeColumn:
    """Return simulated times [ns] as the recording's only timeline."""
    exact = np.asarray(t_ns, dtype=np.int64).astype("timedelta64[ns]")
    return rr.TimeColumn(TIMELINE, duration=exact)


def flange_frame(robot: str) -> str:
    """Return the name of the frame that held objects hang on."""
    return f"{robot}/@flange"


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
    tip = joints[robot.model.joint_names[-1]].child_link.removeprefix(f"{robot.name}/")
    flange = flange_frame(robot.name)
    _log_pose(
        rec, f"{entity}/flange", robot.model.flange, f"{robot.name}/{tip}", flange
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
    moving = {name: q[:, j] for j, name in enumerate(robot.model.joint_names)}
    entry = ROBOTS.get(robot.model.name)
    held = entry.frozen if entry else {}
    for joint in tree.joints():
        times, values = np.zeros(1, np.int64), np.array([held.get(joint.name, 0.0)])
        if joint.name in moving:
            changes = np.append(True, np.diff(moving[joint.name]) != 0.0)
            times, values = t_ns[changes], moving[joint.name][changes]
        elif joint.name not in held:
            continue
        rec.send_columns(
            entity_path(part, "joints", joint.name),
            indexes=[time_column(times)],
            columns=joint.compute_transform_columns(values.tolist(), clamp=False),
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


_FIXTURE_GREYS = ((178, 170, 158), (196, 201, 207), (140, 146, 154))


def draw_fixtures(rec: rr.RecordingStream, cell: Workcell) -> None:
    """Draw what never moves."""
    ground, *others = _FIXTURE_GREYS
    for k, fixture in enumerate(cell.fixtures):
        # The first one, mostly the table, is told apart from all that stand on it.
        grey = ground if k == 0 else others[(k - 1) % len(others)]
        rec.log(
            entity_path(layout.FIXTURES, fixture.name),
            rr.CoordinateFrame(WORLD_FRAME),
            rr.Boxes3D(
                # A hair larger each: faces that lie in one plane would flicker.
                sizes=[fixture.size + 0.0004 * (k % 6)],
                centers=[fixture.pose[:3, 3]],
                quaternions=[quat_xyzw(fixture.pose)],
                colors=[grey],
                fill_mode=rr.components.FillMode.Solid,
            ),
            static=True,
        )


def log_objects(
    rec: rr.RecordingStream, cell: Workcell, placements: Sequence[Placement]
) -> None:
    """Hang every object on what holds it: one row a change.

    What comes up later is drawn from then on.
    """
    rows: dict[str, list[Placement]] = {}
    for placement in placements:
        rows.setdefault(placement.object, []).append(placement)
    for item in cell.objects:
        if item.name in rows:  # otherwise it never came up
            draw_object(rec, item, rows[item.name][0].t_ns)
            place_object(rec, item.name, rows[item.name])


def draw_object(rec: rr.RecordingStream, item: CellObject, t_ns: int) -> None:
    """Draw an object; one that comes up later, from a time on [ns]."""
    entity, frame = entity_path(layout.OBJECTS, item.name), f"@{item.name}"
    if item.later:
        rec.set_time(TIMELINE, duration=np.timedelta64(t_ns, "ns"))
    fill = rr.components.FillMode
    body = rr.Boxes3D(sizes=[item.size], colors=[item.colour], fill_mode=fill.Solid)
    # Edges tell neighbours of one colour apart.
    edges = rr.Boxes3D(
        sizes=[item.size],
        colors=[tuple(channel // 3 for channel in item.colour)],
        radii=rr.Radius.ui_points(0.6),
        fill_mode=fill.MajorWireframe,
    )
    for path, shape in ((entity, body), (f"{entity}/edges", edges)):
        rec.log(path, rr.CoordinateFrame(frame), shape, static=not item.later)
    rec.reset_time()


def place_object(
    rec: rr.RecordingStream, name: str, placements: Sequence[Placement]
) -> None:
    """Hang an object that has been drawn on what holds it, from some times on."""
    parents = [
        WORLD_FRAME if p.holder is None else flange_frame(p.holder) for p in placements
    ]
    # Each row must be whole: Rerun does not join halves of a transform.
    rec.send_columns(
        f"{entity_path(layout.OBJECTS, name)}/pose",
        indexes=[time_column([p.t_ns for p in placements])],
        columns=rr.Transform3D.columns(
            translation=[p.pose[:3, 3] for p in placements],
            quaternion=[quat_xyzw(p.pose) for p in placements],
            parent_frame=parents,
            child_frame=[f"@{name}"] * len(placements),
        ),
    )
