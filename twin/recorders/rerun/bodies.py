"""Fixtures and objects in the Rerun recording: what they look like, where they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr

from planning.cell.shape import Shape
from planning.cell.workcell import CellObject, Workcell
from planning.tasks.task import GONE
from twin.drawing.fixture_colours import coloured_fixtures
from twin.drawing.triangles import triangles_of
from twin.recorders.rerun import layout as layout
from twin.recorders.rerun.layout import WORLD_FRAME, entity_path
from twin.recorders.rerun.robots import flange_frame
from twin.recorders.rerun.time_and_pose import fixed_pose, quat_xyzw, time_column
from twin.run.trajectory import Placement


def draw_fixtures(rec: rr.RecordingStream, cell: Workcell) -> None:
    """Draw what never moves."""
    for k, (fixture, colour) in enumerate(coloured_fixtures(cell)):
        entity = entity_path(layout.FIXTURES, fixture.name)
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
    """Hang every object on what holds it: one row a change.

    What comes up later is drawn from then on, what leaves the cell until then.
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
            own = [unseen(item), *own]
        if own[-1].holder == GONE:
            *own, last = own
            seen[last.t_ns] = False
        if seen == {0: True}:
            draw_object(rec, item)
        else:
            draw_later(rec, item, list(seen), list(seen.values()))
        place_object(rec, item.name, own)


def unseen(item: CellObject) -> Placement:
    """Return where an object is to come up, from the start on.

    A frame needs a pose before there is anything in it: the viewer warns of one that has none.
    """
    return Placement(0, item.name, None, item.start)


def draw_object(rec: rr.RecordingStream, item: CellObject) -> None:
    """Draw an object that is there from the start."""
    frame = rr.CoordinateFrame(_frame(item.name))
    if not item.shape.is_box:
        looks = rr.Mesh3D.from_fields(**_mesh_fields(item.shape, item.colour))
        rec.log(entity_path(layout.OBJECTS, item.name), frame, looks, static=True)
        return
    for path, fields in _boxes(item).items():
        rec.log(path, frame, rr.Boxes3D.from_fields(**fields), static=True)


def draw_later(
    rec: rr.RecordingStream,
    item: CellObject,
    t_ns: Sequence[int],
    seen: Sequence[bool],
) -> None:
    """Draw an object that comes or leaves: at some times [ns], whether it is seen from then on."""
    frames = rr.CoordinateFrame.columns(frame=[_frame(item.name)] * len(t_ns))
    times = [time_column(t_ns)]
    if not item.shape.is_box:
        columns = [*frames]
        for name, value in _mesh_fields(item.shape, item.colour).items():
            every = np.concatenate([value] * sum(seen)) if any(seen) else value[:0]
            counts = [len(value) * there for there in seen]
            field: dict[str, Any] = {name: every}
            columns += rr.Mesh3D.columns(**field).partition(counts)
        rec.send_columns(entity_path(layout.OBJECTS, item.name), times, columns)
        return
    for path, looks in _boxes(item).items():
        some: dict[str, Any] = {
            name: value * sum(seen) for name, value in looks.items()
        }
        columns = [*frames, *rr.Boxes3D.columns(**some).partition(seen)]
        rec.send_columns(path, indexes=times, columns=columns)


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
            child_frame=[_frame(name)] * len(placements),
        ),
    )


def _frame(name: str) -> str:
    return f"@{name}"


def _mesh_fields(shape: Shape, colour: tuple[int, int, int]) -> dict[str, Any]:
    """Return what is drawn of what is no box: triangles in one colour."""
    drawn = triangles_of(shape)
    return {
        "vertex_positions": drawn.vertices.astype(np.float32),
        "vertex_normals": drawn.normals.astype(np.float32),
        "triangle_indices": drawn.faces.astype(np.uint32),
        "albedo_factor": np.array([colour], dtype=np.uint8),
    }


def _boxes(item: CellObject) -> dict[str, dict[str, Any]]:
    """Return what is drawn of a box: by entity, one value each of what it has."""
    entity = entity_path(layout.OBJECTS, item.name)
    fill = rr.components.FillMode
    half = item.size / 2.0
    edge = tuple(channel // 3 for channel in item.colour)
    return {
        entity: {
            "half_sizes": [half],
            "colors": [item.colour],
            "fill_mode": [fill.Solid],
        },
        # Edges tell neighbours of one colour apart.
        f"{entity}/edges": {
            "half_sizes": [half],
            "colors": [edge],
            "radii": [rr.Radius.ui_points(0.6)],
            "fill_mode": [fill.MajorWireframe],
        },
    }
