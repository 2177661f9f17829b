"""Clearance of the tool among the bricks: the third pruning criterion of APEX-MR App. A.

The tool is divided into convex pieces. At every pose of a skill, each piece is bounded by a box along the axes of the
plate. A pose is unobstructed if no box meets a brick or the plate. The test is conservative, because the boxes are
larger than the round parts of the tool. Collisions of arms are checked later, in motion planning.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from planning.caches import BoundedCache
from planning.cell.cover import cut_along_axis
from planning.handling.skill_targets import SkillTargets, Subgoal
from planning.kernels import kernel
from planning.lego.bricks.assembly import (
    LAYER_HEIGHT,
    STUD_PITCH,
    PlacedBrick,
    Plate,
    Press,
    Support,
)
from planning.lego.bricks.brick_grips import grip_pose
from planning.lego.bricks.grid import box_size, brick_height, top_pose
from planning.lego.skills.brick_contacts import lever_reaches_below
from planning.lego.skills.support_targets import STUD_HEIGHT, support_targets
from planning.lego.skills.targets import APPROACH_HEIGHT, BrickGrip, place_targets
from planning.robots.registry import robot_model
from planning.transforms import Array, Transform, inverse, read_only_copy, translation

_THICK = 0.0045
"""Greatest thickness of the pieces of a tapering body along the tool [m]."""

_SAME = 1e-6
"""Corners at the same height, or above each other, to within this [m]."""

PLATE = "the plate"
"""Name of the plate among the names of blocking bricks."""

GRID = Plate(translation(24 * STUD_PITCH, 24 * STUD_PITCH, 0.0), (48, 48))
"""A plate whose corner is the origin: poses on it are poses in the plate's frame."""

TOUCH = 0.0005
"""Overlap that counts as touching [m]."""

KEPT = 0.0006
"""Clearance that planning keeps around a robot, and a little more [m]."""

Approach = tuple[int, float]
"""Side that a brick comes from (+1 or -1), and height of its approach [m]."""


def _box(corners: Array) -> Array:
    return read_only_copy([corners.min(axis=0), corners.max(axis=0)])


def _cut(corners: Array) -> list[Array]:
    """Cut a convex body in two where it tapers."""
    z = corners[:, 2]
    low, high = (corners[np.abs(z - end) < _SAME, :2] for end in (z.min(), z.max()))
    same = np.allclose(
        [low.min(axis=0), low.max(axis=0)],
        [high.min(axis=0), high.max(axis=0)],
        rtol=0.0,
        atol=_SAME,
    )
    count = 1 if same else int(np.ceil(np.ptp(z) / _THICK))
    return cut_along_axis(corners, 2, count)


@dataclass(frozen=True)
class BrickBoxes:
    """The boxes of some bricks in the plate's frame.

    Attributes:
        names: the bricks.
        corners: least and greatest corner of each, shape (n, 2, 3) [m].
    """

    names: tuple[str, ...]
    corners: Array

    def without(self, some: Collection[str]) -> BrickBoxes:
        """Return the boxes of all bricks but some."""
        kept = [k for k, name in enumerate(self.names) if name not in some]
        return BrickBoxes(tuple(self.names[k] for k in kept), self.corners[kept])


def brick_box(item: PlacedBrick) -> Array:
    """Return the least and greatest corner of a brick in the plate's frame, (2, 3) [m]."""
    pose = top_pose(GRID, item)
    size = np.abs(pose[:3, :3]) @ box_size(item.brick)
    top = pose[:3, 3]
    half = np.array([size[0] / 2, size[1] / 2, 0.0])
    height = brick_height(item.brick)
    return np.stack([top - half - [0.0, 0.0, height], top + half])


def blocking_bricks(
    boxes: Array, bricks: BrickBoxes, *, clearance: float = 0.0
) -> list[str]:
    """Return the bricks that any of the boxes overlaps, and ``PLATE`` for the plate.

    Args:
        boxes: shape (k, 2, 3) in the plate's frame [m].
        bricks: the bricks.
        clearance: distance that must be left [m]; by default touching is not meeting.
    """
    shrink = -clearance if clearance > 0.0 else TOUCH
    low, high = boxes[:, 0] + shrink, boxes[:, 1] - shrink
    plate = [PLATE] if float(low[:, 2].min()) < 0.0 else []
    hit = np.flatnonzero(_met(low, high, bricks.corners))
    return plate + [bricks.names[int(k)] for k in hit]


@kernel
def _met(low: Array, high: Array, corners: Array) -> npt.NDArray[np.bool_]:
    """Return which of the boxes of bricks overlap any of some boxes, shape (n,)."""
    found = np.zeros(len(corners), np.bool_)
    for n in range(len(corners)):
        for k in range(len(low)):
            apart = False
            for x in range(3):
                if low[k, x] >= corners[n, 1, x] or high[k, x] <= corners[n, 0, x]:
                    apart = True
                    break
            if not apart:
                found[n] = True
                break
    return found


@kernel
def _bounds(corners: Array) -> Array:
    """Return the boxes around groups of points, shape (k, 2, 3), of those of shape (k, v, 3)."""
    out = np.empty((len(corners), 2, 3))
    for k in range(len(corners)):
        for x in range(3):
            low = high = corners[k, 0, x]
            for v in range(1, corners.shape[1]):
                low, high = min(low, corners[k, v, x]), max(high, corners[k, v, x])
            out[k, 0, x], out[k, 1, x] = low, high
    return out


@dataclass(frozen=True)
class SupportRoom:
    """Volume of a supporting tool, in the plate's frame.

    Attributes:
        boxes: around the tool, before and while it supports, shape (k, 2, 3) [m].
        face: least and greatest corner of the rectangle in which it touches bricks: of the side
            of the tip that looks up, or of the end of the lever wall where it stands on them,
            shape (2, 3) [m].
    """

    boxes: Array
    face: Array


@cache
def tool_room(robot: str) -> ToolRoom:
    """Return the swept volumes of the LEGO tool of a registered robot."""
    model = robot_model(robot)
    to_tool = inverse(model.flange @ model.frames["tool"])
    bodies = [
        part.body.vertices @ to_tool[:3, :3].T + to_tool[:3, 3]
        for part in model.parts
        if part.joint == model.dof - 1
    ]
    pieces = [piece for corners in bodies for piece in _cut(corners)]
    most = max(map(len, pieces))
    rows = [np.vstack([p, np.repeat(p[-1:], most - len(p), axis=0)]) for p in pieces]
    # The tip ends in the grip plane, the lever beyond it.
    lever = max(bodies, key=lambda corners: float(corners[:, 2].max()))
    tip = min(bodies, key=lambda corners: abs(float(corners[:, 2].max())))
    end = lever[lever[:, 2] > lever[:, 2].max() - _SAME]
    supports = BoundedCache[SupportRoom](20_000)
    return ToolRoom(model.frames, read_only_copy(rows), _box(tip), _box(end), supports)


@dataclass(frozen=True)
class ToolRoom:
    """A LEGO tool in its frame ``"tool"``, its swept volumes in the skills, and their obstacles.

    That frame has z out of the tool, the origin in the grip plane, and x towards the middle of a
    brick gripped from above.

    Attributes:
        frames: tool frames in the flange frame.
        pieces: corners of the convex pieces, the last one of each repeated to fill its row,
            shape (m, v, 3) [m].
        tip: least and greatest corner of the part that grips, shape (2, 3) [m].
        lever_end: likewise of the end of the wall beside the grip.
        supports: room of supports that is known.
    """

    frames: Mapping[str, Transform]
    pieces: Array
    tip: Array
    lever_end: Array
    supports: BoundedCache[SupportRoom]

    def boxes_at(self, *poses: Transform) -> Array:
        """Return axis-aligned boxes around the pieces, pose by pose, shape (k, 2, 3) [m].

        The poses are those of the frame ``"tool"``.
        """
        every = np.array(poses)
        turned = self.pieces @ every[:, None, :3, :3].swapaxes(-1, -2)
        corners = turned + every[:, None, None, :3, 3]
        return _bounds(corners.reshape(-1, *self.pieces.shape[1:]))

    def place_blocked(
        self, item: PlacedBrick, press: Press, others: BrickBoxes, *, up: bool
    ) -> list[str]:
        """Return the obstacles to pressing a brick on at its goal; from above, for any approach."""
        goals = self._targets(item, press, up=up).subgoals
        if up:
            boxes = self._boxes(goals)
            # Only what stands beside the brick may be touched; from the others planning keeps off.
            aloof = others.without(_side_neighbours(item, others))
            found = blocking_bricks(boxes, others) + blocking_bricks(
                boxes, aloof, clearance=KEPT
            )
            return found + blocking_bricks(
                _moved(item, goals[3].pose, goals[:2]), others
            )
        found = blocking_bricks(self._boxes(goals[1:]), others)
        if lever_reaches_below(item.brick):
            found += blocking_bricks(self._below_lever(item, press), others)
        return found + blocking_bricks(_above(item), others)

    def approach_blocked(
        self, item: PlacedBrick, press: Press, others: BrickBoxes, approach: Approach
    ) -> list[str]:
        """Return the obstacles to the approach of a brick that is pressed on from above.

        Planning keeps off all bricks there, those beside its place included.
        """
        attack, height = approach
        targets = self._targets(item, press, up=False, attack=attack, height=height)
        start = targets.subgoals[:1]
        moved = _moved(item, targets.subgoals[2].pose, start)
        found = blocking_bricks(self._boxes(start), others, clearance=KEPT)
        return found + blocking_bricks(moved, others, clearance=KEPT)

    def support(self, support: Support) -> SupportRoom:
        """Return the volume of a supporting tool."""
        return self.supports.get(support, lambda: self._support(support))

    def _support(self, support: Support) -> SupportRoom:
        top, subgoals = support.from_above, support_targets(GRID, support)[0].subgoals
        pose = self._pose(subgoals[-1])
        (x0, y0, z0), (x1, y1, z1) = self.lever_end if top else self.tip
        ends = [[x0, y0, z1], [x1, y1, z1]] if top else [[x1, y0, z0], [x1, y1, z1]]
        face = _box(np.array(ends) @ pose[:3, :3].T + pose[:3, 3])
        return SupportRoom(read_only_copy(self._boxes(subgoals)), face)

    def attack_side(
        self, item: PlacedBrick, press: Press, others: BrickBoxes, *, up: bool
    ) -> int:
        """Return +1 or -1: the side of the approach, past no other brick if possible, else +1."""
        for attack in (1, -1):
            targets = self._targets(item, press, up=up, attack=attack)
            at, goals = targets.change_at or 0, targets.subgoals
            if not blocking_bricks(
                _moved(item, goals[at].pose, goals[at - 2 : at]), others
            ):
                return attack
        return 1

    def _targets(
        self,
        item: PlacedBrick,
        press: Press,
        *,
        up: bool,
        attack: int = 1,
        height: float = APPROACH_HEIGHT,
    ) -> SkillTargets:
        grip = BrickGrip(self.frames, item.brick, top_pose(GRID, item), press)
        return place_targets(grip, up=up, attack=attack, height=height)

    def _below_lever(self, item: PlacedBrick, press: Press) -> Array:
        """Return the volume of the knobs under the tool's wall next to a plate."""
        grip = grip_pose(top_pose(GRID, item), item.brick, press)
        wall = np.add(self.lever_end, [[0.0, 0.0, 0.0], [0.0, 0.0, STUD_HEIGHT]])
        return _box(wall @ grip[:3, :3].T + grip[:3, 3])[None]

    def _boxes(self, subgoals: Sequence[Subgoal]) -> Array:
        """Return boxes along the plate's axes around the tool at each subgoal, (k, 2, 3) [m]."""
        return self.boxes_at(*map(self._pose, subgoals))

    def _pose(self, subgoal: Subgoal) -> Transform:
        """Return the pose of the frame ``"tool"`` at a subgoal."""
        return subgoal.pose @ inverse(self.frames[subgoal.frame]) @ self.frames["tool"]


def _side_neighbours(item: PlacedBrick, others: BrickBoxes) -> set[str]:
    """Return the bricks adjacent to a brick, corners included."""
    low, high = brick_box(item)
    them = others.corners
    near = (them[:, 0] <= high + TOUCH) & (them[:, 1] >= low - TOUCH)
    near[:, 2] = (them[:, 0, 2] < high[2] - TOUCH) & (them[:, 1, 2] > low[2] + TOUCH)
    return {others.names[k] for k in np.flatnonzero(near.all(axis=1))}


def _above(item: PlacedBrick) -> Array:
    """Return the volume swept by a brick on its last two layers down."""
    box = brick_box(item)
    box[0, 2] += brick_height(item.brick)
    box[1, 2] += 2 * LAYER_HEIGHT
    return box[None]


def _moved(item: PlacedBrick, goal: Transform, approach: Iterable[Subgoal]) -> Array:
    """Return a box around a brick on its straight path to its goal, shape (1, 2, 3).

    The frame that carries it comes to the goal along subgoals with the same axes.
    """
    boxes = brick_box(item) + np.array(
        [(g.pose[:3, 3] - goal[:3, 3])[None] for g in approach]
    )
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])[None]
