"""Places on a table where the parts of an assembly lie at the start: stable, with room for hands, within reach."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from planning.cell.shape import Shape
from planning.cell.workcell import PlacedRobot
from planning.grips.grip import Grip
from planning.grips.tool_grips import robot_grips
from planning.handling.skill_targets import is_possible_in_some_posture
from planning.parts.assembly import PartHandling
from planning.parts.part_skills import pick_targets, place_targets
from planning.transforms import Array, Transform

_PITCH = 0.02
"""Step between the places that are tried on the table [m]."""

_TILT = math.radians(1.5)
"""A part lies so that it does not fall where the table is tilted by this [rad]."""

_SAME_SIDE = math.cos(math.radians(5.0))
"""Sides of a part on which it lies differ by more."""

_SIDES = 8
"""Sides of a part on which it may lie, those first for which it is turned least."""

_LOW_PART, _ROOM, _ROOM_OF_HAND = 0.05, 0.045, 0.1
"""Parts that are no higher than the first have the second around them, others the third: a hand is as wide [m]."""

_FROM_ASSEMBLY = 0.1
"""Room around the assembly [m]."""

_FROM_ROBOT = 0.2
"""Room around the base of a robot [m]."""

_EDGE = 0.02
"""Room at the edges of the table [m]."""

_NEAR_ROBOT = 0.45
"""Distance of parts from the base of a robot that is best [m]."""

_SHARE = 0.5
"""Weight of the distance from the assembly, beside that of the deviation from the best distance from a robot."""

_MOST_GRIPS = 12
"""Grips that are tried at a place."""

_MOST_PLACES = 150
"""Places that are tried for a part."""


@dataclass(frozen=True)
class Area:
    """A rectangle seen from above.

    Attributes:
        low, high: corners, shape (2,) [m].
    """

    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class PartToLay:
    """Parts of one type that are laid on the table.

    Attributes:
        name: of the type.
        shape: of each.
        goals: their poses in the assembly, in the world.
        handling: how they are gripped and led.
    """

    name: str
    shape: Shape
    goals: tuple[Transform, ...]
    handling: PartHandling


@dataclass(frozen=True)
class Table:
    """A table, and what stands on it.

    Attributes:
        area: its top.
        top: height of that [m].
        obstacles: what stands there, with the room that it needs [m].
        middle: of the assembly, shape (2,) [m].
    """

    area: Area
    top: float
    obstacles: tuple[tuple[Area, float], ...]
    middle: Array


def lay_out(
    parts: Sequence[PartToLay], robots: Sequence[PlacedRobot], frame: str, table: Table
) -> tuple[dict[str, list[Transform]], list[str]]:
    """Return the starts of all parts by type, and notes on those that no robot reaches.

    Args:
        parts: the types.
        robots: of the cell.
        frame: tool frame of the grips.
        table: where they lie.

    Raises:
        ValueError: the table has no room for a part; the message names it.
    """
    layout = _Layout(robots, frame, table)
    for part in sorted(parts, key=lambda own: -_footprint(own.shape)):
        layout.add(part)
    return layout.starts, layout.notes


def _footprint(shape: Shape) -> float:
    return float(np.prod(np.sort(shape.high - shape.low)[1:]))


class _Layout:
    """Starts that are found one after another.

    Args:
        robots: of the cell.
        frame: tool frame of the grips.
        table: where the parts lie.
    """

    def __init__(self, robots: Sequence[PlacedRobot], frame: str, table: Table) -> None:
        self.starts: dict[str, list[Transform]] = {}
        self.notes: list[str] = []
        self._robots, self._frame, self._table = robots, frame, table
        self._used: list[tuple[Area, float]] = list(table.obstacles)
        self._count = 0

    def add(self, part: PartToLay) -> None:
        """Find the places of the parts of a type."""
        turn, height, grips = self._lying(part)
        found = self.starts[part.name] = list[Transform]()
        far = False
        for goal in part.goals:
            able = self._able(part, goal, grips)
            start = self._place(part, turn, height, able)
            if start is None and able:
                far, start = True, self._place(part, turn, height, {})
            if start is None:
                raise ValueError(part.name)
            found.append(start)
        if not any(grips.values()):
            self.notes.append(
                f"{part.name}: no robot's tool grips it where it lies and in its place"
            )
        elif far or not able:
            self.notes.append(f"{part.name}: no robot reaches it and its place")

    def _lying(self, part: PartToLay) -> tuple[Array, float, dict[str, list[Grip]]]:
        """Return the rotation in which a part lies, the height of its origin above the table, and its grips."""
        sides = list(resting_sides(part.shape, part.goals[0][:3, :3]))
        first: tuple[Array, float, dict[str, list[Grip]]] | None = None
        for turn, height in sides[:_SIDES]:
            lying = np.eye(4)
            lying[:3, :3] = turn
            grips = {
                robot.name: robot_grips(
                    robot, part.shape, lying, part.goals[0], part.handling.grips
                )
                for robot in self._robots
            }
            if any(grips.values()):
                return turn, height, grips
            first = first or (turn, height, grips)
        assert first is not None, "every body has a side on which it lies"
        return first

    def _able(
        self, part: PartToLay, goal: Transform, grips: dict[str, list[Grip]]
    ) -> dict[str, list[Grip]]:
        """Return the grips by which each robot puts a part in its place, if there were nothing else."""
        found = {}
        for robot in self._robots:
            own = [
                grip
                for grip in grips[robot.name][:_MOST_GRIPS]
                if is_possible_in_some_posture(
                    robot, place_targets(self._frame, goal @ grip.pose, part.handling)
                )
            ]
            if own:
                found[robot.name] = own
        return found

    def _place(
        self,
        part: PartToLay,
        turn: Array,
        height: float,
        able: dict[str, list[Grip]],
    ) -> Transform | None:
        """Return a free place, where a robot picks the part if any is able to place it; None if there is none."""
        able_robots = [robot for robot in self._robots if robot.name in able]
        first = able_robots[self._count % len(able_robots)] if able_robots else None
        corners = np.vstack([piece.vertices for piece in part.shape.pieces]) @ turn.T
        low, high = corners.min(axis=0), corners.max(axis=0)
        room = _ROOM if high[2] - low[2] <= _LOW_PART else _ROOM_OF_HAND
        places = self._free_places(low[:2], high[:2], room, first or self._robots[0])
        step = max(1, len(places) // _MOST_PLACES) if first is not None else 1
        for x, y in places[::step]:
            start = np.eye(4)
            start[:3, :3], start[:3, 3] = turn, (x, y, self._table.top + height)
            if first is None or any(
                self._picks(robot, part, start, able[robot.name])
                for robot in able_robots
            ):
                at = np.array([x, y])
                self._used.append((Area(at + low[:2], at + high[:2]), room))
                self._count += 1
                return start
        return None

    def _picks(
        self, robot: PlacedRobot, part: PartToLay, start: Transform, grips: list[Grip]
    ) -> bool:
        return any(
            is_possible_in_some_posture(
                robot, pick_targets(self._frame, start @ grip.pose, part.handling)
            )
            for grip in grips
        )

    def _free_places(
        self, low: Array, high: Array, room: float, robot: PlacedRobot
    ) -> list[tuple[float, float]]:
        """Return the free places, those first that are at the best distance from a robot."""
        table = self._table.area
        begin, end = table.low - low + _EDGE, table.high - high - _EDGE
        xs, ys = (
            np.arange(a, b + 1e-9, _PITCH) for a, b in zip(begin, end, strict=True)
        )
        at = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)
        free = np.ones(len(at), dtype=bool)
        for area, kept in self._used:
            apart = np.maximum(at + low - area.high, area.low - at - high).max(axis=1)
            free &= apart >= max(room, kept)
        at = np.round(at[free], 6)
        away = np.abs(np.linalg.norm(at - robot.base[:2, 3], axis=1) - _NEAR_ROBOT)
        away = away + _SHARE * np.linalg.norm(at - self._table.middle, axis=1)
        order = np.lexsort((at[:, 1], at[:, 0], np.round(away, 6)))
        return [(x, y) for x, y in at[order].tolist()]


def resting_sides(shape: Shape, wanted: Array) -> Iterator[tuple[Array, float]]:
    """Yield the rotations in which a part lies safely on a plane, and the height of its origin above that.

    Args:
        shape: of the part.
        wanted: rotation of which as much as possible is kept, shape (3, 3).

    Yields:
        Rotations, shape (3, 3), those first that are nearest to the wanted one, and heights [m].
    """
    corners = np.vstack([piece.vertices for piece in shape.pieces])
    hull = ConvexHull(corners)
    planes = np.unique(np.round(hull.equations, 7), axis=0)
    down = planes[:, :3] @ wanted[2]
    centre = shape.centre_of_mass
    seen: list[Array] = []
    for k in np.argsort(down, kind="stable").tolist():
        normal, offset = planes[k, :3], -float(planes[k, 3])
        if any(normal @ other > _SAME_SIDE for other in seen):
            continue
        margin = _tilt_margin(corners[hull.vertices], normal, offset, centre)
        if margin > _TILT:
            seen.append(normal)
            yield _turned_down(wanted @ normal) @ wanted, offset


def _tilt_margin(corners: Array, normal: Array, offset: float, centre: Array) -> float:
    """Return the angle by which a body on one of its sides may be tilted until it falls [rad]."""
    foot = corners[corners @ normal > offset - 1e-6]
    x = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    x /= np.linalg.norm(x)
    axes = np.column_stack([x, np.cross(normal, x)])
    if len(foot) < 3:
        return 0.0
    try:
        hull = ConvexHull(foot @ axes)
    except QhullError:  # on a line: on an edge nothing lies
        return 0.0
    inside = -(hull.equations[:, :2] @ (centre @ axes) + hull.equations[:, 2])
    high = offset - float(centre @ normal)
    return math.atan2(float(inside.min()), max(high, 1e-9))


def _turned_down(normal: Array) -> Array:
    """Return the least rotation after which a direction points down."""
    cosine = float(-normal[2])
    axis = np.cross(normal, [0.0, 0.0, -1.0])
    if np.linalg.norm(axis) < 1e-9:
        return np.eye(3) if cosine > 0.0 else np.diag([1.0, -1.0, -1.0])
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + cosine))
