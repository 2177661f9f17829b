"""Robots, fixtures and objects in a Rerun recording: shapes, poses and name labels.

The label of a robot also names the object that the robot holds. It is shown at the base of the robot, because a label
at the gripper would hide the parts there. The name of an object at rest is shown when the pointer is over the object.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from rerun.urdf import UrdfTree

from planning.cell.shape import Shape
from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.robots.registry import ROBOTS
from planning.tasks.task import Handling
from twin.drawing.looks import coloured_fixtures, painted_description
from twin.drawing.team_colours import parse_rgb
from twin.drawing.triangles import triangles_of
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.rerun import entities
from twin.rerun import layout as layout
from twin.rerun.entities import (
    WORLD_FRAME,
    entity_path,
    fixed_pose,
    quat_xyzw,
    robot_part,
    time_column,
)
from twin.rerun.fingers import split_fingers
from twin.runs.trajectory import Placement, Trajectory

_FRAME_S = 0.05
"""Least time between two frames [s]."""

_FRAME_STEP = 0.02
"""Motion of a joint that is worth a frame [rad or m]."""

_NAME_COLOUR = (255, 255, 255)  # names stand on dark plates


def flange_frame(robot: str) -> str:
    """Return the name of the frame that held objects are attached to."""
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
        description = painted_description(robot, parse_rgb(colour), linear=True)
        split_fingers(robot, description.getroot())
        description.write(path)
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
        # All joints are drawn at zero statically; rows in time override this.
        rec.send_columns(
            entity_path(part, "joints", name),
            indexes=[time_column([0])],
            columns=joints[name].compute_transform_columns([value], clamp=False),
        )
    first = joints[names[3 if robot.model.is_mobile else 0]]
    foot = first.child_link if robot.mounted_on else first.parent_link
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
    """Draw the visual shapes of a URDF; collision shapes where it has none."""
    chunks = list(tree.stream())
    visual = entity_path(part, tree.name, "visual_geometries")
    collision = entity_path(part, tree.name, "collision_geometries")
    if any(chunk.entity_path.startswith(visual) for chunk in chunks):
        chunks = [c for c in chunks if not c.entity_path.startswith(collision)]
    rr.send_chunks(chunks, recording=rec)
    # Primitives are wire frames by default.
    for chunk in chunks:
        columns = " ".join(chunk.to_record_batch().schema.names)
        for shape in (rr.Boxes3D, rr.Cylinders3D, rr.Ellipsoids3D):
            if f"{shape.__name__}:" in columns:
                solid = shape.from_fields(fill_mode=rr.components.FillMode.Solid)
                rec.log(chunk.entity_path, solid, static=True)


def move_robot(
    rec: rr.RecordingStream, tree: UrdfTree, robot: PlacedRobot, motion: Trajectory
) -> None:
    """Move a drawn robot along a trajectory or a part of one."""
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
    """Return frame times for a smooth display of a robot's motion, shape (f,) [ns].

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


def draw_fixtures(rec: rr.RecordingStream, cell: Workcell) -> None:
    """Draw the fixtures."""
    for k, (fixture, colour) in enumerate(coloured_fixtures(cell)):
        entity = entity_path(entities.FIXTURES, fixture.name)
        if not fixture.shape.is_box:
            frame = f"@{fixture.name}"
            rec.log(
                entity,
                rr.CoordinateFrame(frame),
                rr.Mesh3D.from_fields(**_mesh_fields(fixture.shape, colour)),
                static=True,
            )
            pose = fixed_pose(fixture.pose, WORLD_FRAME, frame)
            rec.log(f"{entity}/pose", pose, static=True)
            continue
        rec.log(
            entity,
            rr.CoordinateFrame(WORLD_FRAME),
            rr.Boxes3D(
                # A hair larger each: faces that lie in one plane would flicker.
                sizes=[fixture.size + 0.0004 * (k % 6)],
                centers=[fixture.pose[:3, 3]],
                quaternions=[quat_xyzw(fixture.pose)],
                colors=[colour],
                fill_mode=rr.components.FillMode.Solid,
            ),
            static=True,
        )


def log_objects(
    rec: rr.RecordingStream, cell: Workcell, placements: Sequence[Placement]
) -> None:
    """Attach every object to its parent: one row per change.

    Objects are drawn from their arrival until they leave the cell.
    """
    rows: dict[str, list[Placement]] = {}
    for placement in placements:
        rows.setdefault(placement.object, []).append(placement)
    for item in cell.objects:
        if item.name not in rows:
            continue  # it never came up
        own = rows[item.name]
        seen = {0: not item.later, own[0].t_ns: True}
        if item.later:
            own = [hidden_placement(item), *own]
        if own[-1].holder == Handling.GONE:
            *own, last = own
            seen[last.t_ns] = False
        if seen == {0: True}:
            draw_object(rec, item)
        else:
            draw_temporary_object(rec, item, list(seen), list(seen.values()))
        place_object(rec, item.name, own)


def hidden_placement(item: CellObject) -> Placement:
    """Return placements that hide an object until it arrives.

    A frame needs a pose before there is anything in it: the viewer warns of one that has none.
    """
    return Placement(0, item.name, None, item.start)


def draw_object(rec: rr.RecordingStream, item: CellObject) -> None:
    """Draw an object that is there from the start."""
    frame = rr.CoordinateFrame(_frame(item.name))
    for path, (kind, fields) in _object_drawing(item).items():
        rec.log(path, frame, kind.from_fields(**fields), static=True)


def draw_temporary_object(
    rec: rr.RecordingStream,
    item: CellObject,
    t_ns: Sequence[int],
    seen: Sequence[bool],
) -> None:
    """Draw an object that arrives or leaves: visibility from given times [ns] on."""
    count = sum(seen)
    for path, (kind, fields) in _object_drawing(item).items():
        columns = [*rr.CoordinateFrame.columns(frame=[_frame(item.name)] * len(t_ns))]
        for name, value in fields.items():
            if isinstance(value, np.ndarray):
                every = np.concatenate([value[:0], *[value] * count])
            else:
                every = value * count
            counts = [len(value) * there for there in seen]
            columns += kind.columns(**{name: every}).partition(counts)
        rec.send_columns(path, indexes=[time_column(t_ns)], columns=columns)


def place_object(
    rec: rr.RecordingStream, name: str, placements: Sequence[Placement]
) -> None:
    """Attach a drawn object to its parents from given times on."""
    parents = [
        WORLD_FRAME if p.holder is None else flange_frame(p.holder) for p in placements
    ]
    # Each row must be whole: Rerun does not join halves of a transform.
    rec.send_columns(
        f"{entity_path(entities.OBJECTS, name)}/pose",
        indexes=[time_column([p.t_ns for p in placements])],
        columns=rr.Transform3D.columns(
            translation=[p.pose[:3, 3] for p in placements],
            quaternion=[quat_xyzw(p.pose) for p in placements],
            parent_frame=parents,
            child_frame=[_frame(name)] * len(placements),
        ),
    )


def _frame(name: str) -> str:
    return f"@{name}"


def _mesh_fields(shape: Shape, colour: tuple[int, int, int]) -> dict[str, Any]:
    """Return the mesh of a shape that is no box: triangles in one colour."""
    drawn = triangles_of(shape)
    return {
        "vertex_positions": drawn.vertices.astype(np.float32),
        "vertex_normals": drawn.normals.astype(np.float32),
        "triangle_indices": drawn.faces.astype(np.uint32),
        "albedo_factor": np.array([colour], dtype=np.uint8),
    }


def _object_drawing(item: CellObject) -> dict[str, tuple[Any, dict[str, Any]]]:
    """Return the drawing of an object: archetype and field rows by entity."""
    entity = entity_path(entities.OBJECTS, item.name)
    if not item.shape.is_box:
        return {entity: (rr.Mesh3D, _mesh_fields(item.shape, item.colour))}
    fill = rr.components.FillMode
    half = item.size / 2.0
    body = {"half_sizes": [half], "colors": [item.colour], "fill_mode": [fill.Solid]}
    # Edges separate neighbours of one colour.
    edges = {
        "half_sizes": [half],
        "colors": [tuple(channel // 3 for channel in item.colour)],
        "radii": [rr.Radius.ui_points(0.6)],
        "fill_mode": [fill.MajorWireframe],
    }
    return {entity: (rr.Boxes3D, body), f"{entity}/edges": (rr.Boxes3D, edges)}


class RobotNames:
    """Collects placements of objects by time, and writes each robot's name with its held object."""

    def __init__(self, rec: rr.RecordingStream, robots: Iterable[str]) -> None:
        """Begin with no held objects."""
        self._rec = rec
        self._held: dict[str, list[str]] = {robot: [] for robot in robots}
        self._rows = {robot: [(0, robot)] for robot in self._held}

    def take(self, placement: Placement) -> None:
        """Record a transfer of an object."""
        for robot, held in self._held.items():
            had = placement.object in held
            if had:
                held.remove(placement.object)
            if robot == placement.holder:
                held.append(placement.object)
            if had or robot == placement.holder:
                name = f"{robot}: {', '.join(held)}" if held else robot
                self._rows[robot].append((placement.t_ns, name))

    def send(self) -> None:
        """Write the rows since the last call."""
        for robot, rows in self._rows.items():
            if rows:
                self._rec.send_columns(
                    name_entity(robot),
                    indexes=[time_column([t_ns for t_ns, _ in rows])],
                    columns=rr.Points3D.columns(labels=[name for _, name in rows]),
                )
        self._rows = {robot: [] for robot in self._rows}
