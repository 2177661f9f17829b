"""Audit of object locations at the start, at each transfer and at the end of a run.

Tools must be in their rack or mounted on their robot.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np
from scipy.optimize import linear_sum_assignment

from planning.cell.workcell import CellObject, Workcell
from planning.tasks.task import Handling, TaskKind
from planning.transforms import Array, Transform, rotation
from twin.audits.case import AuditCase, Violation
from twin.audits.expectations import ChangedTool, Expectations, Place
from twin.audits.motion.executed import ReplayedRun, Stay

PLACED = 0.001
"""Tolerance of places: no point of an object may be further off [m]."""

JUMP = 0.001
"""Tolerance of transfers: no point of an object may jump further [m]."""

_NOWHERE = 1e6
"""Position of held objects: far from all places [m]."""


def start_violations(replay: ReplayedRun) -> Iterator[Violation]:
    """Yield objects that are misplaced at the start."""
    for box in replay.cell.objects:
        for start in replay.stays[box.name][:1]:
            away = distance_of(box, start.pose, box.start)
            if box.later or start.holder is not None or away <= PLACED:
                continue
            detail = f"starts {away * 1e3:.2f} mm away from where it is in the cell"
            yield Violation(start.t, start.t, box.name, "start", away, detail, "place")


def jump_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield objects whose pose jumps at a transfer.

    Arriving objects must appear at their planned poses. A displaced object found by measurement has
    been there all along.
    """
    measured = [
        (h.object, h.pose)
        for h in case.tpg.handlings
        if case.tpg.task_of(h).kind == TaskKind.FAILED
    ]
    times = np.unique([stay.t for stay in case.handed()])
    flanges = {
        robot: case.world.flange_poses(k, case.robots[robot].at(times))
        for robot, k in case.numbers.items()
    }

    def in_world(stay: Stay, t: float) -> Transform:
        if stay.holder is None:
            return stay.pose
        now = flanges[stay.holder][np.searchsorted(times, t)]
        return np.asarray(now @ stay.pose)

    for item in case.cell.objects:
        before: Stay | None = None
        for stay in case.stays[item.name]:
            if stay.until <= max(stay.t, 0.0):
                continue
            whose, old = "rest", item.start
            if before is not None and before.holder != Handling.GONE:
                whose, old = before.holder or whose, in_world(before, stay.t)
            before = stay
            if stay.t <= 0.0 or stay.holder == Handling.GONE:
                continue
            if stay.holder is None and whose == "rest":
                own = (pose for name, pose in measured if name == item.name)
                if any(np.allclose(stay.pose, pose, atol=1e-9) for pose in own):
                    continue
            new = in_world(stay, stay.t)
            jump = max(
                _displacement(shape.at(old), shape.at(new), shape.radius)
                for shape in case.shapes[item.name]
            )
            if jump > JUMP:
                detail = f"when it goes from {whose} to {stay.holder or 'rest'}"
                yield Violation(stay.t, stay.t, item.name, "jump", jump, detail, "jump")


def place_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield objects that are misplaced at the end."""
    wanted = case.wanted
    if not wanted.places:
        return
    there, end = case.at(), case.end
    boxes = {box.name: box for box in case.cell.objects}
    filled = assign_objects_to_places(case.cell, there, wanted.places)

    def at_end(name: str, where: str, away: float, detail: str) -> Violation:
        return Violation(end, end, name, where, away, detail, "place")

    for place, name in zip(wanted.places, filled, strict=True):
        if name is None:
            detail = f"no {place.kind} is there"
            yield at_end(place.object or place.kind, place.words, 0.0, detail)
            continue
        stay = there[name]
        if stay.holder is not None:
            yield at_end(name, place.words, 0.0, f"is still held by {stay.holder}")
            continue
        away = _deviation(boxes[name], stay.pose, place)
        if away > PLACED:
            shift = (stay.pose[:3, 3] - place.pose[:3, 3]) * 1e3
            detail = f"is up to {away * 1e3:.2f} mm off: its centre by "
            detail += f"({shift[0]:.2f}, {shift[1]:.2f}, {shift[2]:.2f}) mm"
            yield at_end(name, place.words, away, detail)
    for name in there.keys() - {*filled, *(tool.name for tool in wanted.tools)}:
        stay = there[name]
        away = distance_of(boxes[name], stay.pose, boxes[name].start)
        if stay.holder is not None or (away > PLACED and not wanted.helpers):
            where = f"in the hand of {stay.holder}" if stay.holder else "elsewhere"
            detail = (
                f"ends {where}, and belongs where it was, or to a place of its kind"
            )
            yield at_end(name, "start", away, detail)


def leftover_helpers(replay: ReplayedRun, wanted: Expectations) -> tuple[str, ...]:
    """Return objects put down only as helpers, such as temporary bricks."""
    there = replay.at()
    filled = assign_objects_to_places(replay.cell, there, wanted.places)
    helping = {
        name
        for place, name in zip(wanted.places, filled, strict=True)
        if place.temporary and name is not None
    }

    def helps(box: CellObject) -> bool:
        if box.name in helping or not wanted.helpers:
            return box.name in helping
        return (
            box.name in there.keys() - set(filled)
            and there[box.name].holder is None
            and distance_of(box, there[box.name].pose, box.start) > PLACED
        )

    return tuple(box.name for box in replay.cell.objects if helps(box))


def with_object_names(replay: ReplayedRun, wanted: Expectations) -> Expectations:
    """Return the expectations with the names of interchangeable objects actually placed."""
    filled = assign_objects_to_places(replay.cell, replay.at(), wanted.places)
    pairs = list(zip(wanted.places, filled, strict=True))
    names = {p.object: name for p, name in pairs if p.object and name}
    # Objects that took the place of another get the names of the objects that took none: names stay unique.
    moved = [own for own in names.values() if own not in names]
    replaced = [name for name in names if name not in names.values()]
    names |= dict(zip(moved, replaced, strict=True))
    places = (replace(p, object=name) if p.any_of else p for p, name in pairs)
    return replace(wanted, places=tuple(places)).renamed(names)


def assign_objects_to_places(
    cell: Workcell, there: Mapping[str, Stay], places: Sequence[Place]
) -> list[str | None]:
    """Return the object of each place: the one of its name, or the nearest interchangeable one.

    Interchangeable objects are assigned so that the sum of distances is least. If the named object has left the
    cell, another one of its kind may be in its place, and a third one in the place of that one.
    """
    left = {p.kind for p in places if p.object is not None and p.object not in there}
    came: dict[int, str] = {}
    for k, place in enumerate(places):
        if place.object is not None and place.kind in left:
            alike = (
                b for b in cell.objects if b.kind == place.kind and b.name in there
            )
            found = (b.name for b in alike if rests_at(b, there[b.name], place.pose))
            came.update((k, name) for name in islice(found, 1))
    others = there.keys() - set(came.values())
    out = [
        came.get(k, p.object if p.object in others else None)
        for k, p in enumerate(places)
    ]
    groups = dict.fromkeys((p.kind, p.any_of) for p in places if p.object is None)
    for kind, names in groups:
        which = [
            k
            for k, p in enumerate(places)
            if (p.kind, p.any_of) == (kind, names) and p.object is None
        ]
        fits = (
            b for b in cell.objects if (b.name in names if names else b.kind == kind)
        )
        own = [b.name for b in fits if b.name in there and b.name not in out]
        if not own:
            continue
        at = np.array([_position(there[name]) for name in own])
        to = np.array([places[k].pose[:3, 3] for k in which])
        cost = np.linalg.norm(to[:, None] - at[None], axis=2)
        for i, j in zip(*linear_sum_assignment(cost), strict=True):
            out[which[i]] = own[j]
    return out


def rests_at(box: CellObject, stay: Stay, place: Transform) -> bool:
    """Return whether an object rests at a place."""
    return stay.holder is None and distance_of(box, stay.pose, place) <= PLACED


def distance_of(box: CellObject, pose: Transform, place: Transform) -> float:
    """Return the largest point deviation of an object from its goal pose [m]."""
    farthest = np.maximum(np.abs(box.shape.low), np.abs(box.shape.high))
    return _displacement(pose, place, float(np.linalg.norm(farthest)))


def _displacement(pose: Transform, place: Transform, radius: float) -> float:
    """Return the largest point displacement of a body between two poses [m]."""
    moved = place - pose
    # Of the difference of two rotations the spectral norm is the Frobenius norm over sqrt(2).
    turned = float(np.linalg.norm(moved[:3, :3])) / math.sqrt(2.0)
    return float(np.linalg.norm(moved[:3, 3])) + radius * turned


def _deviation(box: CellObject, pose: Transform, place: Place) -> float:
    turns = [0.0] if place.object is not None else [0.0, np.pi]
    return min(distance_of(box, pose @ rotation("z", a), place.pose) for a in turns)


def _position(stay: Stay) -> Array:
    return stay.pose[:3, 3] if stay.holder is None else np.full(3, _NOWHERE)


def tool_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield tools that are neither in their rack nor mounted on their robot.

    A robot has one of them on it at a time.
    """
    for tool in case.wanted.tools:
        for stay in case.stays[tool.name]:
            words, away = _misplacement(case, tool, stay)
            if words and stay.until > stay.t:
                times, other = (stay.t, min(stay.until, case.end)), stay.holder
                yield Violation(*times, tool.name, other or "rack", away, words, "tool")
    owners = {tool.name: tool.robot for tool in case.wanted.tools}
    on_it: dict[str, list[str]] = {robot: [] for robot in owners.values()}
    for stay in case.in_order:
        robot = owners.get(stay.object)
        if robot is None:
            continue
        if stay.object in on_it[robot]:
            on_it[robot].remove(stay.object)
        if stay.holder == robot:
            on_it[robot].append(stay.object)
        if len(on_it[robot]) > 1:
            words = f"is on {robot} along with {on_it[robot][0]}"
            yield Violation(stay.t, stay.t, stay.object, robot, 0.0, words, "tool")


def _misplacement(case: AuditCase, tool: ChangedTool, stay: Stay) -> tuple[str, float]:
    """Return description and size of a tool's misplacement; empty if none [m]."""
    item = case.cell.object(tool.name)
    if stay.holder is not None:
        if stay.holder != tool.robot:
            return f"is a tool of {tool.robot}", 0.0
        away = distance_of(item, stay.pose, tool.mount)
        return _format_deviation("as it is mounted", away), away
    away = distance_of(item, stay.pose, tool.rack)
    if away > PLACED and stay.t == 0.0 and tool.first:
        hand = case.flange(tool.robot, 0.0)
        away = min(away, distance_of(item, stay.pose, hand @ tool.mount))
    return _format_deviation("its rack", away), away


def _format_deviation(place: str, away: float) -> str:
    return f"is {away * 1e3:.2f} mm off {place}" if away > PLACED else ""
