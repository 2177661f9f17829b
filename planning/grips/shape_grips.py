"""Grips on parts of any shape: between two fingers, or by suction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice, product, zip_longest

import numpy as np

from planning.caches import BoundedCache
from planning.cell.cover import sphere_directions
from planning.cell.shape import Box, Element, Mesh, Shape
from planning.grips.grip import (
    USUAL_CUP,
    Grip,
    GripRules,
    box_grips,
    lean_angle,
    tool_turn,
)
from planning.grips.solid_lines import InnerStretch, SolidLines
from planning.transforms import Array, Transform, read_only_copy

_MOST_GRIPS = 48
"""Grips on a part that is no box."""

_OPPOSITE = np.cos(np.radians(15.0))
"""Fingers hold faces that are turned from the direction in which they close by no more."""

_KNOWN: BoundedCache[list[Grip]] = BoundedCache(2000)
_IN_TURN: BoundedCache[list[tuple[float, Grip]]] = BoundedCache(50_000)

_FLAT = 0.001
"""Heights under a cup differ by no more than this [m]."""

_SAME = 0.002
"""Grips that are nearer to each other than this are one [m]."""

_LEVELS = 3
"""Heights along an edge at which fingers are tried."""

_CLUSTER = np.cos(np.radians(10.0))
_MOST_CLUSTERS = 10
"""Directions of faces on which grips are searched."""


def part_grips(
    shape: Shape, start: Transform, goal: Transform, rules: GripRules
) -> list[Grip]:
    """Return the grips that allow a part to be picked and placed.

    What is left are grips whose tool points in a wanted direction both where the part is picked
    and where it is placed. Places nearest to its centre of mass come first; of a box, nearest to
    its middle.

    Args:
        shape: of the part.
        start, goal: poses of its frame in the world.
        rules: which grips are tried.
    """
    # Where tools may point is a matter of how a part is turned, not of where it is.
    turns = start[:3, :3].tobytes(), goal[:3, :3].tobytes()
    if shape.is_box and not rules.suction:
        key: tuple[object, ...] = (shape.size.tobytes(), *turns, rules)
        return list(_KNOWN.get(key, lambda: box_grips(shape.size, start, goal, rules)))
    key = (shape, *turns, rules)
    return list(_KNOWN.get(key, lambda: _found(shape, (start, goal), rules)))


def _found(
    shape: Shape, poses: tuple[Transform, Transform], rules: GripRules
) -> list[Grip]:
    lines = SolidLines(shape)
    found: list[tuple[float, Grip]] = []
    for turn in _wanted_turns(shape, poses, rules):
        key = (shape, turn.tobytes(), rules)
        found += _IN_TURN.get(key, partial(_in_turn, lines, turn, rules))
    found.sort(key=lambda entry: entry[0])
    return _varied([grip for _, grip in found])


def _in_turn(
    lines: SolidLines, turn: Array, rules: GripRules
) -> list[tuple[float, Grip]]:
    """Return the grips at one tool rotation, with their distances from the middle."""
    seen = np.vstack([piece.vertices for piece in lines.shape.pieces]) @ turn
    view = _ToolView(lines, turn, seen.min(axis=0), seen.max(axis=0), rules)
    found = []
    for at, words in view.spots() if rules.suction else view.holds():
        away = float(np.linalg.norm(at - lines.shape.centre_of_mass))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, at
        millimetres = ", ".join(str(round(value * 1e3)) for value in at.tolist())
        found.append(
            (
                round(away, 4),
                Grip(read_only_copy(pose), f"{words} at ({millimetres} mm)"),
            )
        )
    return found


def _varied(grips: list[Grip]) -> list[Grip]:
    """Return the first grips, alternating between the directions of the tool."""
    by_turn: dict[bytes, list[int]] = {}
    for place, grip in enumerate(grips):
        by_turn.setdefault(grip.pose[:3, :3].tobytes(), []).append(place)
    rounds = chain.from_iterable(zip_longest(*by_turn.values()))
    kept = islice((place for place in rounds if place is not None), _MOST_GRIPS)
    return [grips[place] for place in sorted(kept)]


def _wanted_turns(
    shape: Shape, poses: Sequence[Transform], rules: GripRules
) -> list[Array]:
    """Return the distinct rotations of the tool frame in the part's frame to try."""
    out: dict[bytes, Array] = {}
    for element in shape.elements:
        for turn, tilt in product(
            _turns_about(element, rules), dict.fromkeys(rules.tilts)
        ):
            tool = np.eye(4)
            tool[:3, :3] = element.pose[:3, :3] @ turn @ lean_angle(tilt)
            if rules.allow(tool, *poses):
                key = np.round(tool[:3, :3], 4) + 0.0
                out.setdefault(key.tobytes(), tool[:3, :3])
    return list(out.values())


def _turns_about(element: Element, rules: GripRules) -> Iterator[Array]:
    """Yield tool rotations aligned with the faces of a form, in its frame."""
    form = element.form
    count = 4 if isinstance(form, Box) else max(1, round(2.0 * np.pi / rules.around))
    angles = 2.0 * np.pi / count * np.arange(count, dtype=np.float64)
    turns = [(np.cos(angle), np.sin(angle)) for angle in angles.tolist()]
    if isinstance(form, Box | Mesh):
        axes = _face_directions(form) if isinstance(form, Mesh) else np.eye(3)
        for y in [*axes, *(-axes)]:
            side = _across(y, axes)
            other = np.cross(y, side)
            yield from (tool_turn(c * side + s * other, y) for c, s in turns)
        return
    # Fingers close across the axis, the tool from any side or from an end; or along it.
    axis = np.array([0.0, 0.0, 1.0])
    for c, s in turns:
        side, around = np.array([c, s, 0.0]), np.array([-s, c, 0.0])
        for z, y in ((-side, around), (-side, axis), (axis, side), (-axis, side)):
            yield tool_turn(z, y)
            yield tool_turn(z, -y)


def _across(y: Array, axes: Array) -> Array:
    """Return a direction perpendicular to another one: along a face of the part, if there is one."""
    for axis in axes:
        side = axis - (axis @ y) * y
        length = float(np.linalg.norm(side))
        if length > 0.5:
            return np.asarray(side / length)
    side = np.cross(y, [1.0, 0.0, 0.0] if abs(y[0]) < 0.9 else [0.0, 1.0, 0.0])
    return np.asarray(side / np.linalg.norm(side))


def _face_directions(mesh: Mesh) -> Array:
    """Return the main surface normals of a mesh, one of each two opposite."""
    corners = mesh.vertices[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    normal = across / np.maximum(area, 1e-300)[:, None]
    # Faces are gathered in the directions of a fine ball first: meshes have very many.
    ball = sphere_directions(600)
    nearest = np.concatenate(
        [
            np.abs(part @ ball.T).argmax(axis=1)
            for part in np.array_split(normal, 1 + len(normal) // 20000)
        ]
    )
    gathered = np.bincount(nearest, area, len(ball))
    found: list[Array] = []
    for k in np.argsort(-gathered).tolist():
        if len(found) == _MOST_CLUSTERS or gathered[k] < 0.01 * area.sum():
            break
        own = nearest == k
        signs = np.sign(normal[own] @ ball[k])
        mean = (signs * area[own]) @ normal[own]
        mean = mean / np.linalg.norm(mean)
        if all(abs(mean @ other) < _CLUSTER for other in found):
            found.append(mean)
    return np.array(found) if found else np.eye(3)


@dataclass(frozen=True, eq=False)
class _ToolView:
    """A part in tool coordinates: x sideways, y along which fingers close, z away from the hand.

    Attributes:
        lines: through the part.
        turn: rotation of the tool in the part's frame, shape (3, 3).
        low, high: corners of the part, as seen, shape (3,) [m].
        rules: for its grips.
    """

    lines: SolidLines
    turn: Array
    low: Array
    high: Array
    rules: GripRules

    def holds(self) -> Iterator[tuple[Array, str]]:
        """Yield poses of the tool frame in the part's at which fingers hold it, with words."""
        seen: list[Array] = []
        ys = np.linspace(self.low[1], self.high[1], 15)
        for x in self._places(0):
            for top in _levels(self._tops(x, ys)[1]):
                z = self._depth_below(x, ys, top)
                through = self._point(x, 0.0, z)
                walls = self.lines.stretches(through, self.turn[:, 1])
                for stretch in _spanned(walls):
                    y = 0.5 * (stretch.begin + stretch.end)
                    place = np.array([x, y, z])
                    if any(np.abs(place - other).max() < _SAME for other in seen):
                        continue
                    if self._fits(stretch, x, z):
                        seen.append(place)
                        width = stretch.end - stretch.begin
                        yield self._point(x, y, z), f"grip {width * 1e3:.0f} mm wide"

    def spots(self) -> Iterator[tuple[Array, str]]:
        """Yield poses of the tool frame in the part's at which a cup finds a flat spot, with words."""
        middle = self.lines.shape.centre_of_mass @ self.turn
        xs, ys = ([float(middle[k]), *self._places(k)] for k in (0, 1))
        angles = (0.25 * np.pi * np.arange(8)).tolist()
        cup = self.rules.cup or USUAL_CUP
        ring = ((cup * np.cos(a), cup * np.sin(a)) for a in angles)
        lips = self.rules.lips or ((0.0, 0.0), *ring)
        seen: set[tuple[int, int]] = set()
        for x, y in product(xs, ys):
            if (key := (round(x * 1e4), round(y * 1e4))) in seen:
                continue
            seen.add(key)
            starts = [self._point(x + a, y + b, 0.0) for a, b in lips]
            tops = self.lines.tops(np.array(starts), self.turn[:, 2])
            if np.all(np.isfinite(tops)) and np.ptp(tops) <= _FLAT:
                yield self._point(x, y, float(tops.min())), "suction"

    def _places(self, axis: int) -> list[float]:
        """Return grip positions along the part, the middle among them [m]."""
        low, high = float(self.low[axis]), float(self.high[axis])
        # A round peg is met squarely in the middle alone.
        offsets = sorted({0.0, *self.rules.offsets(high - low)})
        return [0.5 * (low + high) + at for at in offsets]

    def _point(self, x: float, y: float, z: float) -> Array:
        """Return a point in the part's frame."""
        return np.asarray(self.turn @ np.array([x, y, z]))

    def _tops(self, x: float, ys: Array) -> Array:
        """Return the heights of the part at the sides and the middle of a finger, shape (3, y)."""
        xs = x + 0.5 * self.rules.finger_width * np.array([-1.0, 0.0, 1.0])
        grid = np.array([(x, y, 0.0) for x in xs.tolist() for y in ys.tolist()])
        found = self.lines.tops(grid @ self.turn.T, self.turn[:, 2])
        return found.reshape(len(xs), len(ys))

    def _depth_below(self, x: float, ys: Array, top: float) -> float:
        """Return the insertion depth of the tool below the surface, at most to the middle."""
        starts = np.array([self._point(x, y, 0.0) for y in ys.tolist()])
        enter, leave = self.lines.spans(starts, self.turn[:, 2])
        here = (leave > enter) & (np.abs(enter - top) < 2e-3)
        bottom = float(leave[here].max(initial=top))
        return top + min(self.rules.depth, 0.5 * (bottom - top))

    def _fits(self, held: InnerStretch, x: float, z: float) -> bool:
        """Tell whether fingers span an interval, touch it squarely, and have room next to it."""
        width, closing, rules = held.end - held.begin, self.turn[:, 1], self.rules
        square = min(-held.begin_normal @ closing, held.end_normal @ closing)
        if not rules.spans(width) or square < _OPPOSITE:
            return False
        middle = 0.5 * (held.begin + held.end)
        room = 0.5 * rules.opening + rules.finger_depth
        near = 0.5 * width + max(1e-4, (1.0 / _OPPOSITE - 1.0) * rules.finger_width)
        grid = [
            self._point(x + side * rules.finger_width, 0.0, z - share * rules.depth)
            for side in (-0.5, 0.0, 0.5)
            for share in (0.0, 0.5, 1.0)
        ]
        enter, leave = self.lines.spans(np.array(grid), closing)
        enter, leave = enter - middle, leave - middle
        there = (leave > enter) & (leave > -room) & (enter < room)
        # Next to the held walls, as far as open fingers reach, there is nothing else.
        if np.any(there & ((enter < -near) | (leave > near))):
            return False
        tops = self._tops(x, middle + np.linspace(-room, room, 9))
        return bool(tops.min() >= z - rules.depth - 1e-6)


def _spanned(walls: Sequence[InnerStretch]) -> list[InnerStretch]:
    """Return the walls of a part, and all of them as one: a ring can also be held from outside."""
    if len(walls) < 2:
        return list(walls)
    first = min(walls, key=lambda wall: wall.begin)
    last = max(walls, key=lambda wall: wall.end)
    whole = InnerStretch(first.begin, last.end, first.begin_normal, last.end_normal)
    return [*walls, whole]


def _levels(tops: Array) -> list[float]:
    """Return the heights of the faces, the nearest to the hand first."""
    levels: list[float] = []
    for top in np.sort(tops[np.isfinite(tops)]).tolist():
        if all(abs(top - other) > 2e-3 for other in levels):
            levels.append(top)
    return levels[:_LEVELS]
