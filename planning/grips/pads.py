"""Contacts of a tool with the part that it holds: two closing pads, or a cup on a face.

The z axis of a tool frame points out of the hand (*depth*), fingers close along y (*closing*), and x is *across*.
Pads are derived from the shapes of the tool. Fingers meet at the plane through the tool frame normal to y. A body
that is entirely on one side of this plane closes towards it in a straight line until it touches the part. Fingers
hold a part if pads of both sides touch it after equal travel. A cup holds a part if the whole cup is on a face of the
part and the tool frame is within the cup.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from planning.caches import BoundedCache
from planning.cell.body import ConvexBody
from planning.cell.robot_model import RobotModel
from planning.cell.shape import Shape
from planning.geometry.exact import hull_shape, shape_distance
from planning.transforms import Array, Transform, inverse

_ALONG_CLOSING = 0.002
"""Allowed offset of a part from the middle between the fingers, for inaccurate models [m]."""

BESIDE = 0.0005
"""Distance by which pads may miss a part, along the tool or across it, and still count as touching [m]."""

TO_CUP = 0.001
"""A cup, and the frame in front of it, may be so far from the face that it holds [m]."""

_SIDE = 5e-4
"""What reaches over the plane between the fingers by less belongs to one side [m]."""

_PAST = 0.01
"""Fingers are followed so far beyond the plane in which they meet, to tell how far off a part is [m]."""

_TOUCHES = 1e-6
"""Bodies that are nearer to each other than this touch [m]."""

_EXACT = 5e-6
"""Error of the travel until a pad touches [m]."""

_MOST_STEPS = 100
"""Steps in which a pad advances to a part at most; it rarely takes more than five."""

_HALVINGS = 40
"""Steps of the search for the least distance along a displacement: each leaves two thirds."""

_PADS: BoundedCache[Pads] = BoundedCache(50_000)
_CUPS: BoundedCache[Cup] = BoundedCache(50_000)

Sides = tuple[list[ConvexBody], list[ConvexBody]]


@dataclass(frozen=True)
class Pad:
    """Contact of the fingers of one side of a tool with a part.

    Attributes:
        travel: travel until one of them touches it; negative for an overlap, None if none does [m].
        miss: from where they pass it nearest to the part there, along the axes of the tool frame:
            across, closing, depth, shape (3,); zero where they touch it [m].
    """

    travel: float | None
    miss: Array


@dataclass(frozen=True)
class Pads:
    """Contacts of both sides of a tool with a part.

    Attributes:
        sides: the fingers that close against y of the tool frame, and those that do along it.
        reach: how far the tips are in front of the frame, along its z axis; negative behind it [m].
    """

    sides: tuple[Pad, Pad]
    reach: float

    @property
    def off(self) -> float | None:
        """Offset of the part from the middle, along y; None where a side does not touch it [m]."""
        first, second = (pad.travel for pad in self.sides)
        return None if first is None or second is None else 0.5 * (second - first)


@dataclass(frozen=True)
class Cup:
    """Contact of a cup with a face.

    Attributes:
        gap: between the tool and the part, along all directions; negative if they overlap [m].
        offset: offset of the tool frame from the cup at the part, along x and y, shape (2,) [m].
    """

    gap: float
    offset: Array


def finger_sides(model: RobotModel, tip: Transform) -> Sides | None:
    """Return the bodies of a robot's tool on either side of the plane in which its fingers meet.

    Args:
        model: of the robot, with its tool.
        tip: pose of the tool frame in the last joint's frame.

    Returns:
        Those at positive and those at negative y of the frame, in the last joint's frame; None
        where they are no fingers: on a side there is nothing, or what is between reaches farther.
    """
    sides: Sides = [], []
    middle, tips = -np.inf, [-np.inf, -np.inf]
    for body in own_bodies(model):
        _, y, z = ((body.vertices - tip[:3, 3]) @ tip[:3, :3]).T
        side = 0 if y.min() >= -_SIDE else 1 if y.max() <= _SIDE else None
        if side is None:
            middle = max(middle, z.max())
        else:
            sides[side].append(body)
            tips[side] = max(tips[side], z.max())
    return sides if min(tips) > middle else None


def own_bodies(model: RobotModel) -> list[ConvexBody]:
    """Return the bodies of a robot's tool, in the last joint's frame; none where it has no tool."""
    parts = (part for part in model.parts if part.group == "tool")
    return [part.body for part in parts if part.joint == model.dof - 1]


def pads_at(
    model: RobotModel, tip: Transform, shape: Shape, grip: Transform
) -> Pads | None:
    """Return the finger contacts of a tool on a part, None for a tool without fingers.

    Args:
        model: of the robot, with its tool.
        tip: pose of the tool frame in the last joint's frame.
        shape: of the part.
        grip: pose of the tool frame in the part's.
    """
    sides = finger_sides(model, tip)
    if sides is None:
        return None
    key = (model, tip.tobytes(), shape, grip.tobytes())
    return _PADS.get(key, lambda: _pads(sides, tip, shape, grip))


def _pads(sides: Sides, tip: Transform, shape: Shape, grip: Transform) -> Pads:
    corners = [np.vstack([body.vertices for body in side]) for side in sides]
    reach = min(float(((c - tip[:3, 3]) @ tip[:3, 2]).max()) for c in corners)
    first, second = (
        _pad(side, shape.pieces, grip @ inverse(tip), sign, grip)
        for side, sign in zip(sides, (-1.0, 1.0), strict=True)
    )
    return Pads((first, second), reach)


def _pad(
    bodies: Sequence[ConvexBody],
    pieces: Sequence[ConvexBody],
    at: Transform,
    sign: float,
    grip: Transform,
) -> Pad:
    """Return the contact of the bodies of one side as they close on the pieces of a part.

    Args:
        bodies: of one side of a tool.
        pieces: of the part, in its frame.
        at: pose of the bodies in that frame.
        sign: whether they close along y of the tool frame, 1, or against it, -1.
        grip: pose of that frame in the part's.
    """
    closing = sign * grip[:3, 1]
    moves = []
    for body in bodies:
        corners = body.vertices @ at[:3, :3].T + at[:3, 3]
        # Links of a finger turn as it closes: each comes to the middle by itself.
        room = float(((grip[:3, 3] - corners) @ closing).min())
        about = hull_shape(body), corners, at, closing
        most = max(0.0, room) + _PAST
        moves += [_Move.towards(*about, piece, most) for piece in pieces]
    moves.sort(key=lambda move: move.at_least)
    for margin in (0.0, BESIDE):
        directions = [
            travel
            for move in moves
            if move.at_least <= margin and (travel := move.travel(margin)) is not None
        ]
        if directions:
            return Pad(min(directions), np.zeros(3))
    least, miss = np.inf, np.zeros(3)
    for move in moves:
        if move.at_least >= least:
            break
        gap, vector = move.nearest()
        if gap < least:
            least, miss = gap, vector @ grip[:3, :3]
    return Pad(None, miss)


@dataclass(frozen=True)
class _Move:
    """A convex body that closes in a straight line on a convex piece.

    Attributes:
        body, piece: coal's shapes of both.
        at: pose of the body in the frame of the piece, before it closes.
        closing: direction in which it does, of length one.
        start: from where it is followed; below zero where it is in the piece at first [m].
        most: up to where [m].
        at_least: they are nowhere nearer to each other, as their boxes tell [m].
    """

    body: Any
    piece: Any
    at: Transform
    closing: Array
    start: float
    most: float
    at_least: float

    @classmethod
    def towards(
        cls,
        body: Any,
        corners: Array,
        at: Transform,
        closing: Array,
        piece: ConvexBody,
        most: float,
    ) -> _Move:
        """Return the motion of a body with given corners, in the frame of a piece."""
        low, high = corners.min(axis=0), corners.max(axis=0)
        low = np.minimum(low, low + most * closing)
        high = np.maximum(high, high + most * closing)
        apart = np.maximum(0.0, np.maximum(low - piece.high, piece.low - high))
        at_least, shape = float(np.linalg.norm(apart)), hull_shape(piece)
        move = cls(body, shape, at, closing, 0.0, most, at_least)
        if at_least > 0.0 or move.gap(0.0)[0] > _TOUCHES:
            return move
        # From behind it: what is drawn in a part has been closed too far.
        behind = float((piece.vertices @ closing).min() - (corners @ closing).max())
        return cls(body, shape, at, closing, min(0.0, behind), most, at_least)

    def gap(self, travel: float) -> tuple[float, Array]:
        """Return the distance after a displacement, and the direction from the body to the piece [m]."""
        pose = coal.Transform3s(self.at[:3, :3], self.at[:3, 3] + travel * self.closing)
        result, still = coal.DistanceResult(), coal.Transform3s()
        gap = shape_distance(self.body, pose, self.piece, still, result)
        return gap, np.asarray(result.normal)

    def travel(self, margin: float) -> float | None:
        """Return the travel of the body until it is within a distance of the piece; None if it never is [m].

        Nothing is skipped: along the way, a plane between both is no nearer than the step goes.
        """
        travel = before = self.start
        for _ in range(_MOST_STEPS):
            gap, normal = self.gap(travel)
            if gap <= margin + _TOUCHES:
                return self._refined(before, travel, margin)
            before, ahead = travel, float(normal @ self.closing)
            if ahead <= 0.0 or travel >= self.most:
                return None
            travel = min(travel + (gap - margin) / ahead, self.most)
        return None

    def _refined(self, before: float, touching: float, margin: float) -> float:
        """Return the least travel with which the body touches, given one with which it does not [m].

        Directions between bodies that nearly touch are inexact, so that the last step may be too long.
        """
        middle = touching - _EXACT
        while touching - before > 1.01 * _EXACT:
            if self.gap(middle)[0] <= margin + _TOUCHES:
                touching = middle
            else:
                before = middle
            middle = 0.5 * (before + touching)
        return touching

    def nearest(self) -> tuple[float, Array]:
        """Return the least distance during the motion, and the vector from body to piece there, shape (3,) [m].

        The distance of convex bodies, one of which moves in a straight line, is a convex function.
        """
        low, high = self.start, self.most
        for _ in range(_HALVINGS):
            one, two = low + (high - low) / 3.0, high - (high - low) / 3.0
            if self.gap(one)[0] <= self.gap(two)[0]:
                high = two
            else:
                low = one
        gap, normal = self.gap(low)
        return gap, gap * normal


def cup_at(
    model: RobotModel, tip: Transform, shape: Shape, grip: Transform
) -> Cup | None:
    """Return the cup contact on a part, None for a robot without a tool of its own.

    Args:
        model, tip, shape, grip: see ``pads_at``.
    """
    bodies = own_bodies(model)
    if not bodies:
        return None
    key = (model, tip.tobytes(), shape, grip.tobytes())
    return _CUPS.get(key, lambda: _cup(bodies, tip, shape, grip))


def _cup(
    bodies: Sequence[ConvexBody], tip: Transform, shape: Shape, grip: Transform
) -> Cup:
    at = grip @ inverse(tip)
    gaps = []
    for body in bodies:
        moves = (
            _Move(hull_shape(body), hull_shape(piece), at, np.zeros(3), 0.0, 0.0, 0.0)
            for piece in shape.pieces
        )
        gaps.append(min(move.gap(0.0)[0] for move in moves))
    least = min(gaps)
    near = max(least, TO_CUP) + _TOUCHES
    touching = [b.vertices for b, gap in zip(bodies, gaps, strict=True) if gap <= near]
    across = ((np.vstack(touching) - tip[:3, 3]) @ tip[:3, :3])[:, :2]
    offset = np.maximum(0.0, np.maximum(across.min(axis=0), -across.max(axis=0)))
    return Cup(least, offset)


def explain_not_held(
    model: RobotModel,
    tip: Transform,
    part: str,
    shape: Shape,
    grip: Transform,
    *,
    suction: bool,
) -> str | None:
    """Return in words why a tool does not hold a part, None where it does or cannot be checked.

    Args:
        model, tip, shape, grip: see ``pads_at``.
        part: its name.
        suction: whether it holds by suction; fingers otherwise.
    """
    tool = "the tool" if model.grip is None else model.grip.tool
    if suction:
        # Of fingers that are said to hold as a cup does, the position of the cup is unknown.
        cup = None if model.grip is None else cup_at(model, tip, shape, grip)
        return None if cup is None else "; ".join(_off_cup(cup, tool, part)) or None
    pads = pads_at(model, tip, shape, grip)
    return None if pads is None else "; ".join(_off_pads(pads, tool, part)) or None


def _off_cup(cup: Cup, tool: str, part: str) -> Iterator[str]:
    """Yield the faults of a cup contact on a face."""
    if cup.gap > TO_CUP:
        yield (
            f"{tool} ends {_mm(cup.gap)} away from {part}, and must be at it to {_mm(TO_CUP)}:"
            " move its tcp to the cup"
        )
    elif cup.offset.max() > TO_CUP:
        yield (
            f"the tcp of {tool} is {_mm(cup.offset.max())} beside what is at {part}, and may be"
            f" {_mm(TO_CUP)}: move it to the middle of the cup"
        )


def _off_pads(pads: Pads, tool: str, part: str) -> Iterator[str]:
    """Yield the faults of finger contacts on a part, by direction."""
    off = pads.off
    if off is None:
        missed = [pad.miss for pad in pads.sides if pad.travel is None]
        miss = max(missed, key=lambda miss: float(miss @ miss))
        who = "the fingers of" if len(missed) == 2 else "a finger of"
        close = "close" if len(missed) == 2 else "closes"
        beyond = ""
        if pads.reach < 0.0 < miss[2]:
            beyond = f": its tcp lies {_mm(-pads.reach)} beyond their tips"
        yield f"{who} {tool} {close} {_past(miss)} {part}, and must touch it{beyond}"
    elif abs(off) > _ALONG_CLOSING:
        yield (
            f"{part} would be {_mm(abs(off))} off the middle between the fingers of {tool}, and may be"
            f" {_mm(_ALONG_CLOSING)} (closing): move its tcp to where they meet"
        )


def _past(miss: Array) -> str:
    """Return in words by how much fingers miss a part, by direction; at least the clearest one."""
    across, closing, depth = miss.tolist()
    named = (
        (across, f"{_mm(abs(across))} beside (across)"),
        (closing, f"{_mm(abs(closing))} away from (closing)"),
        (depth, f"{_mm(abs(depth))} {'short of' if depth > 0.0 else 'beyond'} (depth)"),
    )
    plain = max(abs(miss))
    words = [word for by, word in named if abs(by) > BESIDE or abs(by) == plain]
    return " and ".join(words)


def _mm(distance: float) -> str:
    return f"{1e3 * distance:.1f} mm"
