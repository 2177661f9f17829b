"""Grips on parts of any shape: between two fingers, or by suction.

A tool frame's z axis points out of the hand; fingers close along y. Boxes are gripped at their
faces. On what is no box, lines through its convex pieces tell where fingers find opposite faces
and room beside them, and where a cup finds a flat spot.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from planning.cell.cover import directions
from planning.cell.shape import Box, Element, InnerStretch, Mesh, Shape, SolidLines
from planning.files import KeptAnswers
from planning.parts.assembly import Grip, GripRules, box_grips, points_well
from planning.transforms import Array, Transform, readonly

_MOST_GRIPS = 48
"""Grips on a part that is no box."""

_OPPOSITE = np.cos(np.radians(15.0))
"""Fingers hold faces that are turned from the direction in which they close by no more."""

_KNOWN: KeptAnswers[list[Grip]] = KeptAnswers(2000)
_IN_TURN: KeptAnswers[list[tuple[float, Grip]]] = KeptAnswers(50_000)

_FLAT = 0.001
"""Heights under a cup differ by no more than this [m]."""

_SAME = 0.002
"""Grips that are nearer to each other than this are one [m]."""

_LEVELS = 3
"""Heights along an edge at which fingers are tried."""

_CLUSTER = np.cos(np.radians(10.0))
_MOST_CLUSTERS = 10
"""Directions of faces that grips are looked for on."""


def part_grips(
    shape: Shape, start: Transform, goal: Transform, rules: GripRules
) -> list[Grip]:
    """Return the grips with which a part can be taken up and put down.

    What is left are grips whose tool points in a wanted direction both where the part is picked
    and where it is placed. Places nearest to its centre of mass come first; of a box, nearest to
    its middle.

    Args:
        shape: of the part.
        start, goal: poses of its frame in the world.
        rules: which grips are tried.
    """
    if shape.is_box and not rules.suction:
        return box_grips(shape.size, start, goal, rules)
    # Where tools may point is a matter of how a part is turned, not of where it is.
    key = (shape, start[:3, :3].tobytes(), goal[:3, :3].tobytes(), rules)
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
    """Return the grips of a tool that is turned in one way, with how far they are from the middle."""
    tried = _spots if rules.suction else _holds
    found = []
    for at, words in tried(lines, turn, rules):
        away = float(np.linalg.norm(at - lines.shape.centre_of_mass))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, at
        found.append((round(away, 4), Grip(readonly(pose), words)))
    return found


def thinnest(shape: Shape) -> float:
    """Return the least thickness of any of a shape's pieces along the axes of its frame [m]."""
    return min(float(np.min(2.0 * piece.half)) for piece in shape.pieces)


def _varied(grips: list[Grip]) -> list[Grip]:
    """Return the first grips, those of every direction of the tool in turns."""
    by_turn: dict[bytes, list[Grip]] = {}
    for grip in grips:
        by_turn.setdefault(grip.pose[:3, :3].tobytes(), []).append(grip)
    ranks = {
        id(grip): (k, n)
        for n, own in enumerate(by_turn.values())
        for k, grip in enumerate(own)
    }
    kept = sorted(grips, key=lambda grip: ranks[id(grip)])[:_MOST_GRIPS]
    chosen = {id(grip) for grip in kept}
    return [grip for grip in grips if id(grip) in chosen]


def _wanted_turns(
    shape: Shape, poses: Sequence[Transform], rules: GripRules
) -> list[Array]:
    """Return the rotations of the tool frame in the part's that are tried, each once."""
    out: dict[bytes, Array] = {}
    for element in shape.elements:
        for turn, tilt in product(
            _turns_about(element, rules), dict.fromkeys(rules.tilts)
        ):
            tool = np.eye(4)
            tool[:3, :3] = element.pose[:3, :3] @ turn @ _about_y(tilt)
            if all(points_well(tool, pose, rules) for pose in poses):
                key = np.round(tool[:3, :3], 4) + 0.0
                out.setdefault(key.tobytes(), tool[:3, :3])
    return list(out.values())


def _turns_about(element: Element, rules: GripRules) -> Iterator[Array]:
    """Yield rotations of the tool that go with the faces of a form, in its frame."""
    form = element.form
    axes = _face_directions(form) if isinstance(form, Mesh) else np.eye(3)
    count = 4 if isinstance(form, Box) else max(1, round(2.0 * np.pi / rules.around))
    angles = 2.0 * np.pi / count * np.arange(count, dtype=np.float64)
    if not isinstance(form, Box | Mesh):
        # Fingers close across the axis, the tool from any side or from an end; or along it.
        for angle in angles.tolist():
            c, s = np.cos(angle), np.sin(angle)
            aside, around, axis = (
                np.array([c, s, 0.0]),
                np.array([-s, c, 0.0]),
                np.array([0.0, 0.0, 1.0]),
            )
            for z, y in (
                (-aside, around),
                (-aside, axis),
                (axis, aside),
                (-axis, aside),
            ):
                yield _axes(z, y)
                yield _axes(z, -y)
        return
    for y in [*axes, *(-axes)]:
        aside = _across(y, axes)
        other = np.cross(y, aside)
        for angle in angles.tolist():
            yield _axes(np.cos(angle) * aside + np.sin(angle) * other, y)


def _axes(z: Array, y: Array) -> Array:
    return np.column_stack([np.cross(y, z), y, z])


def _across(y: Array, axes: Array) -> Array:
    """Return a direction across another one: along a face of the part, if there is one."""
    for axis in axes:
        aside = axis - (axis @ y) * y
        length = float(np.linalg.norm(aside))
        if length > 0.5:
            return np.asarray(aside / length)
    aside = np.cross(y, [1.0, 0.0, 0.0] if abs(y[0]) < 0.9 else [0.0, 1.0, 0.0])
    return np.asarray(aside / np.linalg.norm(aside))


def _face_directions(mesh: Mesh) -> Array:
    """Return the directions that most of a mesh's surface is turned to, one of each two opposite."""
    corners = mesh.vertices[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    normal = across / np.maximum(area, 1e-300)[:, None]
    # Faces are gathered in the directions of a fine ball first: meshes have very many.
    ball = directions(600)
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


def _about_y(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


@dataclass(frozen=True, eq=False)
class _ToolView:
    """A part as a tool sees it: x aside, y along which fingers close, z away from the hand.

    Attributes:
        lines: through the part.
        turn: rotation of the tool in the part's frame, shape (3, 3).
        low, high: corners of the part, as seen, shape (3,) [m].
    """

    lines: SolidLines
    turn: Array
    low: Array
    high: Array

    def point(self, x: float, y: float, z: float) -> Array:
        """Return a point in the part's frame."""
        return np.asarray(self.turn @ np.array([x, y, z]))

    def across(self, x: float, z: float) -> list[InnerStretch]:
        """Return where the line along which fingers close is inside of the part."""
        return self.lines.stretches(self.point(x, 0.0, z), self.turn[:, 1])

    def tops(self, xs: Array, ys: Array) -> Array:
        """Return how high the part comes towards the hand, least z first met, shape (x, y)."""
        grid = np.array([(x, y, 0.0) for x in xs.tolist() for y in ys.tolist()])
        found = self.lines.tops(grid @ self.turn.T, self.turn[:, 2])
        return found.reshape(len(xs), len(ys))


def _tool_view(lines: SolidLines, turn: Array) -> _ToolView:
    seen = np.vstack([piece.vertices for piece in lines.shape.pieces]) @ turn
    return _ToolView(lines, turn, seen.min(axis=0), seen.max(axis=0))


def _places(low: float, high: float, rules: GripRules) -> list[float]:
    """Return places along the part, the middle among them [m]."""
    middle, reach = 0.5 * (low + high), 0.5 * (high - low) - rules.end_margin
    if rules.positions == 1 or reach <= 0.0:
        return [middle]
    spread = np.linspace(-reach, reach, rules.positions).tolist()
    # A round peg is met squarely in the middle alone.
    return [middle + at for at in sorted({0.0, *spread})]


def _holds(
    lines: SolidLines, turn: Array, rules: GripRules
) -> Iterator[tuple[Array, str]]:
    """Yield places of the tool frame at which fingers hold the part, with words."""
    view = _tool_view(lines, turn)
    aside = 0.5 * rules.finger_width * np.array([-1.0, 0.0, 1.0])
    seen: list[Array] = []
    ys = np.linspace(view.low[1], view.high[1], 15)
    for x in _places(float(view.low[0]), float(view.high[0]), rules):
        tops = view.tops(x + aside, ys)
        for top in _levels(tops[1]):
            z = _depth_below(view, x, ys, top, rules)
            for stretch in _spanned(view.across(x, z)):
                y = 0.5 * (stretch.begin + stretch.end)
                place = np.array([x, y, z])
                if any(np.abs(place - other).max() < _SAME for other in seen):
                    continue
                if not _fits(view, stretch, (x, z), rules):
                    continue
                seen.append(place)
                at, width = view.point(x, y, z), stretch.end - stretch.begin
                yield at, f"grip {width * 1e3:.0f} mm wide at ({_millimetres(at)})"


def _spanned(walls: Sequence[InnerStretch]) -> list[InnerStretch]:
    """Return walls of a part, and all of them as one: a ring is held from outside, too."""
    if len(walls) < 2:
        return list(walls)
    first = min(walls, key=lambda wall: wall.begin)
    last = max(walls, key=lambda wall: wall.end)
    whole = InnerStretch(first.begin, last.end, first.begin_normal, last.end_normal)
    return [*walls, whole]


def _levels(tops: Array) -> list[float]:
    """Return the heights at which faces are met, the nearest to the hand first."""
    levels: list[float] = []
    for top in np.sort(tops[np.isfinite(tops)]).tolist():
        if all(abs(top - other) > 2e-3 for other in levels):
            levels.append(top)
    return levels[:_LEVELS]


def _depth_below(
    view: _ToolView, x: float, ys: Array, top: float, rules: GripRules
) -> float:
    """Return how far the tool goes: its depth below what it meets, at most to the middle."""
    starts = np.array([view.point(x, y, 0.0) for y in ys.tolist()])
    enter, leave = view.lines.spans(starts, view.turn[:, 2])
    here = (leave > enter) & (np.abs(enter - top) < 2e-3)
    bottom = float(leave[here].max(initial=top))
    return top + min(rules.depth, 0.5 * (bottom - top))


def _fits(
    view: _ToolView, held: InnerStretch, at: tuple[float, float], rules: GripRules
) -> bool:
    """Tell whether fingers span a stretch, meet it squarely, and have room beside it."""
    width, (x, z) = held.end - held.begin, at
    closing = view.turn[:, 1]
    if not rules.least_opening <= width <= rules.opening:
        return False
    if (
        -held.begin_normal @ closing < _OPPOSITE
        or held.end_normal @ closing < _OPPOSITE
    ):
        return False
    middle = 0.5 * (held.begin + held.end)
    room = 0.5 * rules.opening + rules.finger_depth
    near = 0.5 * width + max(1e-4, (1.0 / _OPPOSITE - 1.0) * rules.finger_width)
    grid = [
        view.point(x + side * rules.finger_width, 0.0, z - share * rules.depth)
        for side in (-0.5, 0.0, 0.5)
        for share in (0.0, 0.5, 1.0)
    ]
    enter, leave = view.lines.spans(np.array(grid), closing)
    enter, leave = enter - middle, leave - middle
    there = (leave > enter) & (leave > -room) & (enter < room)
    # Beside what is held, up to where fingers are when they are open, nothing else is.
    if np.any(there & ((enter < -near) | (leave > near))):
        return False
    ys = middle + np.linspace(-room, room, 9)
    tops = view.tops(x + 0.5 * rules.finger_width * np.array([-1.0, 0.0, 1.0]), ys)
    return bool(tops.min() >= z - rules.depth - 1e-6)


def _spots(
    lines: SolidLines, turn: Array, rules: GripRules
) -> Iterator[tuple[Array, str]]:
    """Yield places of the tool frame at which a cup finds a flat spot, with words."""
    view = _tool_view(lines, turn)
    xs = _places(float(view.low[0]), float(view.high[0]), rules)
    ys = _places(float(view.low[1]), float(view.high[1]), rules)
    middle = lines.shape.centre_of_mass @ turn
    xs, ys = [float(middle[0]), *xs], [float(middle[1]), *ys]
    angles = 0.25 * np.pi * np.arange(8)
    seen: set[tuple[int, int]] = set()
    for x, y in product(xs, ys):
        key = round(x * 1e4), round(y * 1e4)
        if key in seen:
            continue
        seen.add(key)
        ring = [
            view.point(x + rules.cup * np.cos(a), y + rules.cup * np.sin(a), 0.0)
            for a in angles.tolist()
        ]
        starts = np.array([view.point(x, y, 0.0), *ring])
        tops = lines.tops(starts, turn[:, 2])
        if np.all(np.isfinite(tops)) and np.ptp(tops) <= _FLAT:
            at = view.point(x, y, float(tops.min()))
            yield at, f"suction at ({_millimetres(at)})"


def _millimetres(point: Array) -> str:
    return ", ".join(str(round(value * 1e3)) for value in point.tolist()) + " mm"
