"""Places on a table where the parts of an assembly lie at the start: stable, with room for hands, within reach."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from planning.cad.table import Area, Table
from planning.cell.shape import Shape
from planning.cell.workcell import CellObject, Fixture, PlacedRobot
from planning.contacts.touching import PlacedObject, nearby_entities
from planning.grips.closing_fingers import swept_fingers
from planning.grips.grip import Grip, GripRules
from planning.grips.pads import own_bodies
from planning.grips.shape_grips import part_grips
from planning.grips.tool_grips import explain_tool_misfit, robot_grips, tool_heights
from planning.handling.skill_targets import is_possible_in_some_posture
from planning.parts.assembly import PartHandling
from planning.parts.part_skills import pick_targets, place_targets
from planning.transforms import Array, Transform, frame_along, inverse, translation

_PITCH = 0.02
"""Step between the places that are tried on the table [m]."""

_TILT = math.radians(1.5)
"""A part lies so that it does not fall where the table is tilted by this [rad]."""

_SAME_SIDE = math.cos(math.radians(5.0))
"""Sides of a part on which it lies differ by more."""

_SIDES = 4
"""Sides of a part on which it may lie, those first for which it is turned least."""

_LOW_PART, _ROOM, _ROOM_OF_HAND = 0.05, 0.045, 0.1
"""Parts that are no higher than the first have the second around them, others the third: a hand is as wide [m]."""

_EDGE = 0.02
"""Room at the edges of the table [m]."""

_NEAR_ROBOT = 0.45
"""Distance of parts from the base of a robot that is best [m]."""

_SHARE = 0.5
"""Weight of the distance from the assembly, beside that of the deviation from the best distance from a robot."""

_ROOM_OF_TOOL = 0.0015
"""Room around a tool that puts a part in its place: motions keep a margin [m]."""

_ABOVE = 0.001
"""Room between a tool that grips a part and what the part lies on [m]."""

_DEPTHS = (0.012, 0.006, 0.003, 0.0015)
"""Depths of grips that are tried where the tool has no room at that of the rules [m]."""

_OPENINGS = (0.056, 0.036, 0.016)
"""Widths of places that are gripped, where all wider ones have no room for the tool [m]."""

_SHARE_OF_STAND = 0.8
"""Width of a stand, as a share of that of the part: fingers reach down beside it."""

_MOST_GRIPS = 12
"""Grips that are tried at a place."""

_MOST_PLACES = 150
"""Places that are tried for a part."""


@dataclass(frozen=True, eq=False)
class PartToLay:
    """Parts of one type that are laid on the table.

    Attributes:
        name: of the type.
        item: one of them.
        goals: their poses in the assembly, in the world.
        handling: how they are gripped and led.
        there: what is in the assembly before them, by name.
    """

    name: str
    item: CellObject
    goals: tuple[Transform, ...]
    handling: PartHandling
    there: Mapping[str, PlacedObject]


@dataclass(frozen=True, eq=False)
class Lying:
    """How parts of a type lie at the start.

    Attributes:
        turn: their rotation, shape (3, 3).
        height: of the origin of their frame above what they lie on [m].
        grips: on them, by robot.
        rules: for grips on them, with which tools have room; None for those of the assembly.
        stand: height of the stand under each, 0 for none [m].
        size: edges of the top of that, along x and y [m].
    """

    turn: Array
    height: float
    grips: Mapping[str, list[Grip]]
    rules: GripRules | None = None
    stand: float = 0.0
    size: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Layout:
    """Poses of parts in the world at the start and how they lie, by type, and notes on those that no robot reaches."""

    starts: dict[str, list[Transform]] = field(default_factory=dict)
    lying: dict[str, Lying] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def lay_out(
    parts: Iterable[PartToLay], robots: Sequence[PlacedRobot], frame: str, table: Table
) -> Layout:
    """Return where all parts lie at the start.

    Grips are of a tool frame. The parts are added to what stands on the table.

    Raises:
        ValueError: the table has no room for a part; the message names it.
    """
    search = _Search(robots, frame, table)
    for part in sorted(parts, key=lambda own: -_footprint(own.item.shape)):
        search.add(part)
    return search.layout


def _footprint(shape: Shape) -> float:
    return float(np.prod(np.sort(shape.high - shape.low)[1:]))


def least_opening(
    parts: Sequence[tuple[Shape, Transform]],
    rules: GripRules,
    openings: Sequence[float],
) -> float:
    """Return the least opening of fingers by which most parts are gripped as they are turned in their places [m].

    Given are the parts' shapes and goals, and openings from which it is chosen, the least first [m].
    """
    best = -1, 0.0
    for opening in openings:
        own = replace(rules, opening=opening)
        count = sum(bool(part_grips(shape, at, at, own)) for shape, at in parts)
        if count > best[0]:
            best = count, opening
        if count == len(parts):
            break
    return best[1]


class _Search:
    """Starts that are found one after another."""

    def __init__(self, robots: Sequence[PlacedRobot], frame: str, table: Table) -> None:
        self.layout = Layout()
        self._robots, self._frame, self._table = robots, frame, table
        self._tips = {r.name: r.model.frame_in_last_joint(frame) for r in robots}
        self._fronts = {
            robot.name: float(tool_heights(robot.model, self._tips[robot.name]).max())
            for robot in robots
        }
        self._count = 0

    def add(self, part: PartToLay) -> None:
        """Find the places of the parts of a type."""
        lying = self._lying(part)
        found = list[Transform]()
        self.layout.lying[part.name], self.layout.starts[part.name] = lying, found
        if lying.rules is not None:
            part = replace(part, handling=replace(part.handling, grips=lying.rules))
        far = False
        for goal in part.goals:
            able = self._able(part, goal, lying.grips)
            start = self._place(part, lying, able)
            far = far or not able or start is None
            if start is None and able:
                start = self._place(part, lying, {})
            if start is None:
                raise ValueError(part.name)
            found.append(start)
        words = ""
        if not any(lying.grips.values()):
            words = "no robot's tool grips it where it lies and in its place"
        elif far:
            words = "no robot reaches it and its place with one grip"
        if words:
            self.layout.notes.append(f"{part.name}: {words}")

    def _lying(self, part: PartToLay) -> Lying:
        """Return how a part lies: on the first side on which it is gripped for its place."""
        sides = list(resting_sides(part.item.shape, part.goals[0][:3, :3]))[:_SIDES]
        lying = (self._on_side(part, turn, height) for turn, height in sides)
        found = next((own for own in lying if any(own.grips.values())), None)
        return found or Lying(*sides[0], {})

    def _on_side(self, part: PartToLay, turn: Array, height: float) -> Lying:
        """Return how a part lies on a side: with fingers above the table, or else on a stand."""
        pose = translation(0.0, 0.0, height)
        pose[:3, :3] = turn
        first: Lying | None = None
        for rules in _variants(part.handling.grips):
            grips = self._free_grips(part, pose, rules)
            above = [
                float((pose @ grip.pose)[2, 3]) - self._fronts[name]
                for name, own in grips.items()
                for grip in own
            ]
            if above and max(above) >= _ABOVE:
                return Lying(turn, height, grips, rules)
            if above and first is None:
                stand = math.ceil(1e3 * (_ABOVE - max(above))) / 1e3
                low, high = _extent(part.item.shape, turn)
                x, y = (_SHARE_OF_STAND * (high - low)[:2]).round(4).tolist()
                size = max(x, 1e-3), max(y, 1e-3)
                first = Lying(turn, height, grips, rules, stand, size)
        return first or Lying(turn, height, {})

    def _free_grips(
        self, part: PartToLay, start: Transform, rules: GripRules
    ) -> dict[str, list[Grip]]:
        """Return grips by which robots put the first of some parts in its place; none if another one has none.

        The tool is free of the part, and of what is in the assembly by then.
        """
        found: dict[str, list[Grip]] = {}
        there = dict(part.there)
        for number, goal in enumerate(part.goals):
            own = {}
            for robot in self._robots:
                grips = robot_grips(robot, part.item.shape, start, goal, rules)
                free = (g for g in grips if self._has_room(robot, part, goal, g, there))
                own[robot.name] = list(islice(free, 1 if number else _MOST_GRIPS))
            if not any(own.values()):
                return {}
            found = found or own
            there[f"{part.name}/{number}"] = part.item, goal
        return found

    def _has_room(
        self,
        robot: PlacedRobot,
        part: PartToLay,
        goal: Transform,
        grip: Grip,
        there: Mapping[str, PlacedObject],
    ) -> bool:
        """Tell whether the tool at a grip is free of the part, and of what is there, in the part's place."""
        model, approach = robot.model, part.handling.approach
        if explain_tool_misfit(robot, self._frame, part.item, grip, approach):
            return False
        tip = self._tips[robot.name]
        # Fingers need room from where they are open to where they hold the part.
        closing = swept_fingers(model, tip, part.item.shape, grip.pose) or model
        bodies = tuple(own_bodies(closing))
        at = goal @ grip.pose @ inverse(tip)
        tool = Fixture("tool", Shape((), bodies), at)
        return not bodies or not nearby_entities((tool, at), there, _ROOM_OF_TOOL)

    def _able(
        self, part: PartToLay, goal: Transform, grips: Mapping[str, list[Grip]]
    ) -> dict[str, list[Grip]]:
        """Return the grips by which each robot puts a part in its place, if there were nothing else."""
        found = {}
        for robot in self._robots:
            targets = (
                (grip, place_targets(self._frame, goal @ grip.pose, part.handling))
                for grip in grips.get(robot.name, [])
            )
            own = [g for g, at in targets if is_possible_in_some_posture(robot, at)]
            if own:
                found[robot.name] = own
        return found

    def _place(
        self, part: PartToLay, lying: Lying, able: dict[str, list[Grip]]
    ) -> Transform | None:
        """Return a free place, where a robot picks the part if any is able to place it; None if there is none."""
        able_robots = [robot for robot in self._robots if robot.name in able]
        first = able_robots[self._count % len(able_robots)] if able_robots else None
        low, high = _extent(part.item.shape, lying.turn)
        area = Area(low[:2], high[:2])
        room = _ROOM if high[2] - low[2] <= _LOW_PART else _ROOM_OF_HAND
        places = self._free_places(area, room, first or self._robots[0])
        step = max(1, len(places) // _MOST_PLACES) if first is not None else 1
        for at in places[::step]:
            start = translation(
                at[0], at[1], self._table.top + lying.stand + lying.height
            )
            start[:3, :3] = lying.turn
            if first is None or any(
                is_possible_in_some_posture(
                    robot, pick_targets(self._frame, start @ grip.pose, part.handling)
                )
                for robot in able_robots
                for grip in able[robot.name]
            ):
                taken = Area(at + area.low, at + area.high)
                self._table.obstacles.append((taken, room))
                self._count += 1
                return start
        return None

    def _free_places(self, area: Area, room: float, robot: PlacedRobot) -> Array:
        """Return the free places, those first that are at the best distance from a robot, shape (n, 2) [m]."""
        table = self._table.area
        begin, end = table.low - area.low + _EDGE, table.high - area.high - _EDGE
        steps = (
            np.arange(a, b + 1e-9, _PITCH) for a, b in zip(begin, end, strict=True)
        )
        at = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
        at = np.round(at[self._table.is_free(at, area, room)], 6)
        away = np.abs(np.linalg.norm(at - robot.base[:2, 3], axis=1) - _NEAR_ROBOT)
        away = away + _SHARE * np.linalg.norm(at - self._table.middle, axis=1)
        return at[np.lexsort((at[:, 1], at[:, 0], np.round(away, 6)))]


def _variants(rules: GripRules) -> Iterator[GripRules]:
    """Yield rules for grips, and others by which tools reach less deep, and grip narrower places."""
    for opening in (rules.opening, *_OPENINGS):
        for depth in (rules.depth, *_DEPTHS):
            if opening <= rules.opening and depth <= rules.depth:
                yield replace(rules, depth=depth, opening=opening)


def _extent(shape: Shape, turn: Array) -> tuple[Array, Array]:
    """Return the corners of the box around a part that is turned, from the origin of its frame [m]."""
    corners = np.vstack([piece.vertices for piece in shape.pieces]) @ turn.T
    return corners.min(axis=0), corners.max(axis=0)


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
    foot, axes = corners[corners @ normal > offset - 1e-6], frame_along(normal)[:2].T
    try:
        hull = ConvexHull(foot @ axes)
    except QhullError:  # too few, or on a line: on an edge nothing lies
        return 0.0
    inside = -(hull.equations[:, :2] @ (centre @ axes) + hull.equations[:, 2])
    high = offset - float(centre @ normal)
    return math.atan2(float(inside.min()), max(high, 1e-9))


def _turned_down(normal: Array) -> Array:
    """Return the least rotation after which a direction points down."""
    cosine = float(-normal[2])
    axis = np.cross(normal, [0.0, 0.0, -1.0])
    if cosine < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + cosine))
