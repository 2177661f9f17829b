"""Fixtures and objects in the Rerun recording: boxes, some of which change hands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from planning.cell.workcell import CellObject, Workcell
from twin.recorders.rerun import layout as layout
from twin.recorders.rerun.robots import (
    TIMELINE,
    WORLD_FRAME,
    entity_path,
    flange_frame,
    quat_xyzw,
    time_column,
)
from twin.run.trajectory import Placement

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
    rec.log(
        entity,
        rr.CoordinateFrame(frame),
        rr.Boxes3D(
            sizes=[item.size],
            colors=[item.colour],
            fill_mode=rr.components.FillMode.Solid,
        ),
        static=not item.later,
    )
    # Edges tell neighbours of one colour apart.
    rec.log(
        f"{entity}/edges",
        rr.CoordinateFrame(frame),
        rr.Boxes3D(
            sizes=[item.size],
            colors=[tuple(channel // 3 for channel in item.colour)],
            radii=rr.Radius.ui_points(0.6),
            fill_mode=rr.components.FillMode.MajorWireframe,
        ),
        static=not item.later,
    )
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
