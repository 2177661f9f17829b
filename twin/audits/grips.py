"""Audit of grips: held objects must be between finger pads, or under the suction cup.

The z axis of a tool frame points out of the hand (*depth*), fingers close along y (*closing*), and x is
called *across*. Fingers are the shapes of a tool that are wholly on one side of the plane in which they meet.
They close in a straight line and must touch the object from both sides, after equal travel. A suction cup
must touch the object, with the origin of the tool frame inside the cup.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planning.cell.workcell import CellObject
from planning.transforms import Array, Transform, translation
from twin.audits.case import AuditCase, Hand, Violation
from twin.audits.motion.executed import Stay
from twin.audits.worlds.world import FAR, AuditWorld, WatchedShape

GRIP = 0.005
"""Largest gap between a held object and a closed tool without identifiable fingers [m]."""

CLOSING = 0.0021
"""What fingers hold may be so far off the middle between them, along the axis in which they close [m]."""

BESIDE = 0.0006
"""Largest offset of pads from the object, along or across the tool [m]."""

CUP = 0.0011
"""Largest gap between cup and object, and offset of the tool frame from the cup [m]."""

_PLAY = 1e-4
"""A box may be wider than its fingers open by this: rounding of files [m]."""

_SIDE = 5e-4
"""What reaches over the plane in which fingers meet by less belongs to one side [m]."""

_PAST = 0.01
"""Travel beyond that plane up to which fingers are followed, to measure a miss [m]."""

_TOUCHES = 5e-5
"""What is nearer than this touches: the engines' own errors [m]."""

_MOST_STEPS = 200
"""Steps in which a finger advances at most, each as long as it is away."""

_HALVINGS = 30
"""Steps of the search for the least distance along a travel: each leaves two thirds."""

_NEAR = 0.5
"""No finger reaches farther from its tool frame [m]."""

_NUDGE = 1e-4
"""Something is moved by so much to see in which direction it is away [m]."""

RIGHT = (0.0, "")
"""Of a hold at which nothing is wrong."""

_Sides = tuple[list[WatchedShape], list[WatchedShape]]


def grip_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield objects that are held without proper contact, or are wider than the fingers open.

    Every hold is measured once, when it begins: from then on tool and object move as one.
    """
    tools = {tool.name for tool in case.wanted.tools}
    for stay in case.in_order:
        name, robot, t = stay.object, stay.holder, max(stay.t, 0.0)
        if robot is None or robot not in case.robots:
            continue
        if name in tools or stay.until <= t:
            continue
        wrong = _wrong(case, stay, robot, t)
        times = t, min(stay.until, case.end)
        if wrong is not None:
            yield Violation(*times, name, robot, *wrong, "grip")
            continue
        # Fingers close as it begins, and open as it ends.
        for end in times if stay.until <= case.end else (t,):
            if met := _met(case, stay, robot, end):
                yield Violation(end, end, robot, *met, "grip")


def _wrong(
    case: AuditCase, stay: Stay, robot: str, t: float
) -> tuple[float, str] | None:
    """Return size and description of a grip error; None for a valid grip [m]."""
    hand, flange = case.hand(robot, t), case.flange(robot, t)
    pose, grip, name = flange @ stay.pose, hand.grip, stay.object
    held = case.put(name, pose)
    width = _width(case.cell.object(name), hand, stay.pose)
    if grip is not None and width > hand.opening + _PLAY:
        detail = f"is {width * 1e3:.2f} mm wide between the fingers of {grip.tool},"
        detail += f" which open to {hand.opening * 1e3:.2f} mm"
        return width - hand.opening, detail
    told = grip_mismatch(case, hand, robot, flange, name, pose)
    if told is not None:
        return None if told == RIGHT else told
    gap, nearest = min(
        (case.world.distance(part, own, FAR), part.detail)
        for part in hand.shapes
        for own in held
    )
    closing = max(hand.closes_by(own) for own in held)
    if gap <= GRIP + closing:
        return None
    detail = f"is held {gap * 1e3:.2f} mm away from {nearest}"
    detail += f", which closes by {closing * 1e3:.2f} mm" if closing else ""
    return gap, detail


def grip_mismatch(
    case: AuditCase,
    hand: Hand,
    robot: str,
    flange: Transform,
    name: str,
    pose: Transform,
) -> tuple[float, str] | None:
    """Return size and description of the mismatch of pads or cup with an object [m].

    Args:
        case: the execution.
        hand: tool of a robot, placed.
        robot: its name.
        flange: pose of its flange in the world.
        name: of the object.
        pose: of that in the world.

    Returns:
        ``RIGHT`` where they hold it; None where the tool's shapes are inconclusive.
    """
    wanted, grip = case.wanted, hand.grip
    if wanted.gripped_at is None or (grip and grip.opening == (0.0, 0.0)):
        return None
    at = hand.frames.get(wanted.gripped_at, np.eye(4))
    held = case.put(name, pose)
    grasp = _Grasp(case.world, hand.shapes, flange @ at, held, pose)
    tool = robot if grip is None else grip.tool
    if grip is not None and grip.suction:
        return grasp.off_cup(tool) or RIGHT
    sides = grasp.sides()
    if sides is None or (grip is None and name in wanted.by_suction):
        return None
    return grasp.off_pads(sides, tool) or RIGHT


def _width(item: CellObject, hand: Hand, held: Transform) -> float:
    """Return the width of a box along the closing axis of fingers [m].

    None without fingers, or for other shapes, which may be gripped at any part.
    """
    tool, grip = hand.frames.get("tool"), hand.grip
    if grip is None or grip.opening is None or tool is None or not item.shape.is_box:
        return 0.0
    return float(np.abs(held[:3, :3].T @ tool[:3, 1]) @ item.size)


def _met(
    case: AuditCase, stay: Stay, robot: str, t: float
) -> tuple[str, float, str] | None:
    """Return the obstacle that fingers meet before the object, with distance and description [m].

    Fixtures and all objects are looked at that the robot does not hold at that time.
    """
    hand, flange, name = case.hand(robot, t), case.flange(robot, t), stay.object
    pose, frame = flange @ stay.pose, case.wanted.gripped_at
    if frame is None or (hand.grip is not None and hand.grip.suction):
        return None
    at = flange @ hand.frames.get(frame, np.eye(4))
    grasp = _Grasp(case.world, hand.shapes, at, case.put(name, pose), pose)
    sides = grasp.sides()
    if sides is None or (hand.grip is None and name in case.wanted.by_suction):
        return None
    directions = grasp.ways(sides)
    for other, where in _around(case, robot, t):
        if np.linalg.norm(where[:3, 3] - at[:3, 3]) > _NEAR + case.reaches[other]:
            continue
        beside = replace(grasp, held=case.put(other, where), pose=where)
        for first, way in zip(beside.ways(sides, directions), directions, strict=True):
            early = 0.0 if first is None or way is None else way - first
            if early > BESIDE:
                words = f"is met by a finger {early * 1e3:.2f} mm before that touches {name}"
                return other, early, words
    return None


def _around(case: AuditCase, robot: str, t: float) -> Iterator[tuple[str, Transform]]:
    """Yield fixtures and objects that a robot does not hold at a time, with poses."""
    for fixture in case.cell.fixtures:
        yield fixture.name, fixture.pose
    for item in case.cell.objects:
        stay = case.place(item.name, t)
        if stay is None or stay.holder == robot:
            continue
        if stay.holder is None:
            yield item.name, stay.pose
        elif stay.holder in case.robots:
            yield item.name, case.flange(stay.holder, t) @ stay.pose


@dataclass(frozen=True)
class _Grasp:
    """A tool and its held object in the world at one time.

    Attributes:
        world: to measure in.
        tool: its shapes, in their places.
        frame: pose of the tool frame in the world.
        held: shapes of the held object.
        pose: of that in the world.
    """

    world: AuditWorld
    tool: list[WatchedShape]
    frame: Transform
    held: list[WatchedShape]
    pose: Transform

    def sides(self) -> _Sides | None:
        """Return the fingers at positive and at negative y of the frame; None where there are none.

        What is between them must not reach farther than they do.
        """
        sides: _Sides = [], []
        middle, tips = -math.inf, [-math.inf, -math.inf]
        for shape in self.tool:
            tip = self._reach(shape, (0.0, 0.0, 1.0))
            if self._reach(shape, (0.0, -1.0, 0.0)) <= _SIDE:
                side = 0
            elif self._reach(shape, (0.0, 1.0, 0.0)) <= _SIDE:
                side = 1
            else:
                middle = max(middle, tip)
                continue
            sides[side].append(shape)
            tips[side] = max(tips[side], tip)
        return sides if min(tips) > middle else None

    def off_pads(self, sides: _Sides, tool: str) -> tuple[float, str] | None:
        """Return size and description of a finger mismatch; None if they hold it [m]."""
        directions, missed = [], []
        for shapes, sign in zip(sides, (-1.0, 1.0), strict=True):
            way, nearest = self._closed(shapes, sign)
            if way is None:
                missed.append(self._miss(*nearest, sign))
            else:
                directions.append(way)
        self._back()
        if missed:
            miss = max(missed, key=lambda vector: float(np.linalg.norm(vector)))
            away = float(np.linalg.norm(miss))
            who = "both fingers" if len(missed) == 2 else "a finger"
            return away, f"is not held: {who} of {tool} would pass it {_words(miss)}"
        off = 0.5 * abs(directions[0] - directions[1])
        if off <= CLOSING:
            return None
        words = f"{off * 1e3:.2f} mm off the middle between the fingers of {tool}"
        return off, f"is {words} (closing)"

    def off_cup(self, tool: str) -> tuple[float, str] | None:
        """Return size and description of a cup mismatch; None if it holds it [m]."""
        gaps = [min(self._gap(part, own) for own in self.held) for part in self.tool]
        least = min(gaps)
        if least > CUP:
            return least, f"is held {least * 1e3:.2f} mm away from the cup of {tool}"
        touching = [p for p, gap in zip(self.tool, gaps, strict=True) if gap <= CUP]
        for axis in np.vstack([np.eye(3)[:2], -np.eye(3)[:2]]):
            beside = -max(self._reach(part, axis) for part in touching)
            if beside > CUP:
                words = f"{beside * 1e3:.2f} mm beside what of {tool} is at it (across)"
                return beside, f"is held at a tool frame that is {words}"
        return None

    def _reach(self, shape: WatchedShape, axis: tuple[float, ...] | Array) -> float:
        """Return the extent of a shape along an axis of the frame [m]."""
        return self.world.reach(
            shape, self.frame[:3, 3], self.frame[:3, :3] @ np.asarray(axis)
        )

    def _room(self, shape: WatchedShape, sign: float) -> float:
        """Return the default travel up to which a finger is followed [m]."""
        return max(0.0, -self._reach(shape, (0.0, sign, 0.0))) + _PAST

    def _closed(
        self, shapes: list[WatchedShape], sign: float
    ) -> tuple[float | None, tuple[WatchedShape, WatchedShape, float]]:
        """Return the finger travel until first contact, the nearest shape, and its travel."""
        rooms = [self._room(shape, sign) for shape in shapes]
        self._back()
        pairs = [
            (self._gap(one, own), k, own)
            for k, one in enumerate(shapes)
            for own in self.held
        ]
        pairs.sort(key=lambda pair: pair[0])
        touched, grazed, least = math.inf, math.inf, math.inf
        nearest = (shapes[pairs[0][1]], pairs[0][2], rooms[pairs[0][1]])
        for gap, k, own in pairs:
            one, most = shapes[k], rooms[k]
            if gap > touched:
                break
            if gap - most > max(least, BESIDE):
                continue
            way, passed, graze = self._advance(one, own, sign, gap, most)
            touched, grazed = min(touched, way), min(grazed, graze)
            if passed < least:
                least, nearest = passed, (one, own, most)
        first = touched if math.isfinite(touched) else grazed
        return (first if math.isfinite(first) else None), nearest

    def _advance(
        self, one: WatchedShape, own: WatchedShape, sign: float, gap: float, most: float
    ) -> tuple[float, float, float]:
        """Return the closing of a finger on a shape.

        A step as long as it is away never goes through. What is drawn in the shape is followed from
        outside.

        Returns:
            How far until it touches, infinite if it does not; how near it has come; how far until it
            has been nearer than it may pass and still count as touching [m].
        """
        way, least, graze = 0.0, math.inf, math.inf
        if gap < -_TOUCHES:
            way = -2.0 * (one.radius + own.radius)
            gap = self._moved(one, own, sign, way)
        for _ in range(_MOST_STEPS):
            least = min(least, gap)
            if gap <= BESIDE:
                graze = min(graze, way)
            if gap <= _TOUCHES:
                return way, least, graze
            if way >= most:
                break
            way = min(way + gap, most)
            gap = self._moved(one, own, sign, way)
        return math.inf, least, graze

    def ways(
        self, sides: _Sides, most: Sequence[float | None] = (None, None)
    ) -> list[float | None]:
        """Return the travel of the fingers of each side until contact; None without contact [m].

        Args:
            sides: the fingers.
            most: maximum travel of each side; None until they meet [m].
        """
        found = []
        for shapes, sign, end in zip(sides, (-1.0, 1.0), most, strict=True):
            directions = [math.inf]
            for one in shapes:
                limit = self._room(one, sign) if end is None else end
                for own in self.held:
                    gap = self.world.distance(one, own, limit + BESIDE)
                    if -_TOUCHES <= gap <= limit:
                        directions.append(self._advance(one, own, sign, gap, limit)[0])
                        self.world.place(own, own.at(self.pose))
            found.append(min(directions) if math.isfinite(min(directions)) else None)
        return found

    def _miss(
        self, one: WatchedShape, own: WatchedShape, most: float, sign: float
    ) -> Array:
        """Return the offset of a finger from a shape at its closest passage, along the frame's axes [m].

        Their distance is a convex function of travel. Its change under small displacements of the shape
        gives the direction.
        """
        low, high = 0.0, most
        for _ in range(_HALVINGS):
            near, far = low + (high - low) / 3.0, high - (high - low) / 3.0
            directions = (self._moved(one, own, sign, way) for way in (near, far))
            low, high = (
                (low, far) if next(directions) <= next(directions) else (near, high)
            )
        gap, slope = self._moved(one, own, sign, low), np.zeros(3)
        for k, axis in enumerate(np.eye(3)):
            more, less = (
                self._moved(one, own, sign, low, nudge * axis)
                for nudge in (_NUDGE, -_NUDGE)
            )
            slope[k] = more - less
        length = float(np.linalg.norm(slope))
        return gap * slope / length if length else np.array([0.0, 0.0, gap])

    def _moved(
        self,
        one: WatchedShape,
        own: WatchedShape,
        sign: float,
        way: float,
        nudge: Array | float = 0.0,
    ) -> float:
        """Return the distance of a finger after some travel, by moving the object towards it [m]."""
        shift = self.frame[:3, :3] @ (np.array([0.0, -sign * way, 0.0]) + nudge)
        self.world.place(own, own.at(translation(*shift.tolist()) @ self.pose))
        return self._gap(one, own)

    def _gap(self, one: WatchedShape, own: WatchedShape) -> float:
        return self.world.distance(one, own, FAR)

    def _back(self) -> None:
        """Move the held object back to its pose."""
        for own in self.held:
            self.world.place(own, own.at(self.pose))


def _words(miss: Array) -> str:
    """Describe how fingers pass a missed object, by direction."""
    across, closing, depth = miss.tolist()
    named = (
        (across, f"{abs(across) * 1e3:.2f} mm beside it (across)"),
        (closing, f"{abs(closing) * 1e3:.2f} mm away from it (closing)"),
        (
            depth,
            f"{abs(depth) * 1e3:.2f} mm {'short of' if depth > 0.0 else 'beyond'} it (depth)",
        ),
    )
    plain = max(abs(across), abs(closing), abs(depth))
    words = [word for by, word in named if abs(by) > BESIDE or abs(by) == plain]
    return " and ".join(words)
