"""What is built must stand where the scenario says, at the end and nowhere else."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from planning.cell.workcell import CellObject, Workcell
from planning.tasks.task import GONE
from planning.transforms import Array, Transform, rotation
from twin.audit.motion.executed import ObjectRow, Recording
from twin.audit.motion.reach import travel_of_points
from twin.audit.violation import Violation
from twin.audit.wanted import Place, Wanted

PLACED = 0.001
"""No point of an object is further than this away from where it belongs [m]."""

_NOWHERE = 1e6
"""Where what is in a hand is put: far from all spots [m]."""


def rows_at(
    cell: Workcell, recording: Recording, until: float = np.inf
) -> dict[str, ObjectRow]:
    """Return where every object that is there is at a time [s], by default at the end."""
    rows = {
        box.name: ObjectRow(0.0, box.name, None, box.start)
        for box in cell.objects
        if not box.later
    }
    rows |= {row.object: row for row in recording.objects if row.t <= until}
    return {name: row for name, row in rows.items() if row.holder != GONE}


def start_violations(cell: Workcell, recording: Recording) -> Iterator[Violation]:
    """Yield the objects that are not where they belong at the start."""
    first: dict[str, ObjectRow] = {}
    for row in recording.objects:
        first.setdefault(row.object, row)
    for box in cell.objects:
        start = first.get(box.name)
        if start is None or box.later or start.holder is not None:
            continue
        away = distance_of(box, start.pose, box.start)
        if away > PLACED:
            detail = f"starts {away * 1e3:.2f} mm away from where it is in the cell"
            yield Violation(start.t, start.t, box.name, "start", away, detail, "place")


def place_violations(
    cell: Workcell, recording: Recording, wanted: Wanted
) -> Iterator[Violation]:
    """Yield what stands elsewhere than the scenario says when all is done.

    Args:
        cell: names objects, their kinds and sizes.
        recording: an execution that came to its end.
        wanted: where the scenario wants what.
    """
    if not wanted.places:
        return
    rows = rows_at(cell, recording)
    boxes = {box.name: box for box in cell.objects}
    filled = taken(cell, rows, wanted.places)
    for place, name in zip(wanted.places, filled, strict=True):
        if name is None:
            detail = f"no {place.kind} is there"
            yield _at_end(recording, place.object or place.kind, place, 0.0, detail)
            continue
        row = rows[name]
        if row.holder is not None:
            detail = f"is still held by {row.holder}"
            yield _at_end(recording, name, place, 0.0, detail)
            continue
        away = _off(boxes[name], row.pose, place)
        if away > PLACED:
            shift = (row.pose[:3, 3] - place.pose[:3, 3]) * 1e3
            detail = f"is up to {away * 1e3:.2f} mm off: its centre by "
            detail += f"({shift[0]:.2f}, {shift[1]:.2f}, {shift[2]:.2f}) mm"
            yield _at_end(recording, name, place, away, detail)
    for name in rows.keys() - {*filled, *(tool.name for tool in wanted.tools)}:
        box, row = boxes[name], rows[name]
        away = distance_of(box, row.pose, box.start)
        if row.holder is not None or (away > PLACED and not wanted.helpers):
            where = f"in the hand of {row.holder}" if row.holder else "elsewhere"
            end, text = recording.end, "belongs where it was, or to a place of its kind"
            yield Violation(
                end, end, name, "start", away, f"ends {where}, and {text}", "place"
            )


def helpers_left(
    cell: Workcell, recording: Recording, wanted: Wanted
) -> tuple[str, ...]:
    """Return the objects that were put down where they only help, such as temporary bricks."""
    if not wanted.helpers:
        return ()
    rows = rows_at(cell, recording)
    filled = set(taken(cell, rows, wanted.places))
    return tuple(
        box.name
        for box in cell.objects
        if box.name in rows.keys() - filled
        and rows[box.name].holder is None
        and distance_of(box, rows[box.name].pose, box.start) > PLACED
    )


def taken(
    cell: Workcell, rows: dict[str, ObjectRow], places: Sequence[Place]
) -> list[str | None]:
    """Return the object of each place: the one of its name, or the nearest of its kind.

    Objects of a kind are shared out so that the sum of distances is least.
    """
    out: list[str | None] = [p.object if p.object in rows else None for p in places]
    for kind in dict.fromkeys(p.kind for p in places if p.object is None):
        which = [k for k, p in enumerate(places) if p.kind == kind and p.object is None]
        own = [b.name for b in cell.objects if b.kind == kind and b.name in rows]
        own = [name for name in own if name not in out]
        if not own:
            continue
        at = np.array([_spot(rows[name]) for name in own])
        to = np.array([places[k].pose[:3, 3] for k in which])
        cost = np.linalg.norm(to[:, None] - at[None], axis=2)
        for i, j in zip(*linear_sum_assignment(cost), strict=True):
            out[which[i]] = own[j]
    return out


def distance_of(box: CellObject, pose: Transform, place: Transform) -> float:
    """Return how far the furthest point of an object is from where it belongs [m]."""
    farthest = np.maximum(np.abs(box.shape.low), np.abs(box.shape.high))
    radius = float(np.linalg.norm(farthest))
    ends = np.stack([pose, place])
    return float(travel_of_points(ends[:, :3, :3], ends[:, :3, 3], radius)[0])


def _off(box: CellObject, pose: Transform, place: Place) -> float:
    turns = [0.0] if place.object is not None else [0.0, np.pi]
    return min(distance_of(box, pose @ rotation("z", a), place.pose) for a in turns)


def _spot(row: ObjectRow) -> Array:
    return row.pose[:3, 3] if row.holder is None else np.full(3, _NOWHERE)


def _at_end(
    recording: Recording, name: str, place: Place, away: float, detail: str
) -> Violation:
    end = recording.end
    return Violation(end, end, name, place.words, away, detail, "place")
