"""Robots that hold something for another one are there in time, and stay until it is done."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import Workcell
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.grips import finger_travel
from twin.audit.motion.executed import ObjectRow, Recording, RobotRows
from twin.audit.places import rows_at, taken
from twin.audit.tools import hand_of
from twin.audit.violation import Violation
from twin.audit.wanted import Wanted
from twin.audit.worlds.world import FAR, AuditWorld

SUPPORT = 0.003
"""A tool that holds against objects is no further away from one: studs, 1.7 mm high, are no part
of the boxes [m]."""

STANDING = 1e-9
"""Joints that move by less than this stand: rounding [rad or m]."""

_SUPPORTS = ("support-bottom", "support-top")
_PLACES = ("place-down", "place-up")


@dataclass(frozen=True)
class _Change:
    """An object changes hands at a robot's node.

    Attributes:
        row: from then on it is there.
        giver: who held it.
        begin, end: of the node [s].
    """

    row: ObjectRow
    giver: str
    begin: float
    end: float


def support_violations(
    world: AuditWorld, tpg: TemporalPlanGraph, recording: Recording, wanted: Wanted
) -> Iterator[Violation]:
    """Yield what was put down without the support that it needs, and handovers to who moves.

    A step needs a support where the scenario says so, or where the plan has a support for it.
    While the node in which the object is put down lasts, one other robot must stand still with
    its tool at an object at rest. At a handover, one of the two must stand still while the node
    of the other lasts.

    Args:
        world: to measure in.
        tpg: says which tasks are supports.
        recording: what was executed.
        wanted: says which places need one.
    """
    held = _held_objects(world.cell, tpg, recording, wanted)
    before: dict[str, ObjectRow] = {}
    for row in recording.objects:
        giver = before[row.object].holder if row.object in before else None
        before[row.object] = row
        if giver is None or row.t <= 0.0 or row.holder == giver:
            continue
        change = _change(recording.robots[giver], row, giver)
        if row.holder is not None:
            yield from _handed_over(recording, change)
        elif row.object in held:
            yield from _supported(world, recording, change, wanted)


def _held_objects(
    cell: Workcell, tpg: TemporalPlanGraph, recording: Recording, wanted: Wanted
) -> set[str]:
    """Return the objects that need a support when they are put down."""
    steps = {task.step for task in tpg.tasks if task.kind in _SUPPORTS}
    planned = (t for t in tpg.tasks if t.kind in _PLACES and t.step in steps)
    out = {task.object for task in planned if task.object is not None}
    filled = taken(cell, rows_at(cell, recording), wanted.places)
    pairs = zip(wanted.places, filled, strict=True)
    return out | {name for place, name in pairs if place.held and name is not None}


def _change(rows: RobotRows, row: ObjectRow, giver: str) -> _Change:
    k = min(int(np.searchsorted(rows.t, row.t - 1e-9)), len(rows.t) - 1)
    begin, end = _node_span(rows, k)
    return _Change(row, giver, begin, end)


def _node_span(rows: RobotRows, k: int) -> tuple[float, float]:
    """Return from when to when a robot moves in the node of a row [s]."""
    moves = np.any(np.diff(rows.q, axis=0) != 0.0, axis=1)
    own = np.flatnonzero((rows.node[1:] == rows.node[k]) & moves)
    if not len(own):
        return float(rows.t[k]), float(rows.t[k])
    return float(rows.t[own[0]]), float(rows.t[own[-1] + 1])


def stands_still(rows: RobotRows, begin: float, end: float) -> bool:
    """Tell whether a robot stands from one time to another [s]."""
    inside = rows.t[(rows.t > begin) & (rows.t < end)]
    q = rows.at(np.concatenate([[begin], inside, [end]]))
    return bool(np.all(np.abs(q - q[0]) <= STANDING))


def _handed_over(recording: Recording, change: _Change) -> Iterator[Violation]:
    row, taker = change.row, change.row.holder
    assert taker is not None
    rows = recording.robots
    other = _change(rows[taker], row, taker)
    still = stands_still(rows[taker], change.begin, change.end)
    if not still and not stands_still(rows[change.giver], other.begin, other.end):
        detail = f"{row.object} changes hands while both move"
        yield Violation(row.t, row.t, change.giver, taker, 0.0, detail, "support")


def _supported(
    world: AuditWorld, recording: Recording, change: _Change, wanted: Wanted
) -> Iterator[Violation]:
    row = change.row
    least, nearest, closing = FAR, "nobody", 0.0
    for index, robot in enumerate(world.cell.robots):
        rows = recording.robots[robot.name]
        if robot.name == change.giver or not stands_still(
            rows, change.begin, change.end
        ):
            continue
        gap, closes = _gap_to_objects(world, recording, index, change, wanted)
        if gap - closes < least - closing:
            least, nearest, closing = gap, robot.name, closes
    if least > SUPPORT + closing:
        detail = "is put down without its support: nobody else stands still meanwhile"
        if nearest != "nobody":
            detail = (
                "is put down without its support: of those who stand still meanwhile, "
            )
            detail += f"{nearest} is nearest to an object, {least * 1e3:.2f} mm away"
        gap = least if nearest != "nobody" else 0.0
        yield Violation(
            change.begin, change.end, row.object, nearest, gap, detail, "support"
        )


def _gap_to_objects(
    world: AuditWorld,
    recording: Recording,
    robot: int,
    change: _Change,
    wanted: Wanted,
) -> tuple[float, float]:
    """Return how far a robot's tool is from the nearest object at rest, and how far it closes [m].

    Fingers that stand open close on the thinnest edge.
    """
    name = world.cell.robots[robot].name
    q: Array = recording.robots[name].at(np.array([change.begin]))[0]
    there = rows_at(world.cell, recording, change.row.t)
    hand = hand_of(world, robot, q, there, wanted)
    opening, tools = hand.opening(wanted.opening_m), {t.name for t in wanted.tools}
    least, closing = FAR, 0.0
    for shape in world.objects:
        at = there.get(shape.entity)
        if at is None or at.holder is not None or shape.entity in tools:
            continue
        world.place(shape, shape.at(at.pose))
        gap = min(world.distance(part, shape, FAR) for part in hand.shapes)
        closes = finger_travel(shape, opening)
        if gap - closes < least - closing:
            least, closing = gap, closes
    return least, closing
