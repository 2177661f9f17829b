"""Whether the tool has room among the bricks: the third pruning of APEX-MR App. A.

The tool is cut into slices, each slice bounded by a box along the plate's axes at every pose of
a skill; a pose has room when no box meets a brick or the plate. That errs on the safe side at
the corners of the round parts. Arms are left to motion planning.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from planning.lego.bricks.assembly import (
    LAYER_HEIGHT,
    STUD_PITCH,
    Plate,
    Press,
    Support,
)
from planning.lego.bricks.contacts import PlacedBrick
from planning.lego.bricks.grid import box_size, top_pose
from planning.lego.skills.support import support_bottom_targets, support_top_targets
from planning.lego.skills.targets import (
    place_down_targets,
    place_up_contact,
    place_up_targets,
)
from planning.skills.subgoals import Subgoal
from planning.transforms import Array, Transform, inverse, translation

PLATE = "the plate"
"""Name that stands for the plate where a blocking brick is named."""

GRID = Plate(translation(24 * STUD_PITCH, 24 * STUD_PITCH, 0.0), (48, 48))
"""A plate whose corner is the origin: poses on it are poses in the plate's frame."""

TOUCH = 0.0005
"""Overlap that counts as touching [m]."""

KEPT = 0.0006
"""What planning keeps between a robot and what it must not touch, and a bit [m]."""

_CONE_SLICES = 8


@dataclass(frozen=True)
class BrickTool:
    """The tool on a robot's flange, as far as bricks are concerned.

    The default is the LEGO tool LT-V2 of APEX-MR (Fig. 5c) on its force sensor, with the
    published dimensions. Box coordinates are in the frame ``"tool"``: z out of the tool, origin
    in the grip plane, x towards the middle of a brick gripped from above.

    Attributes:
        frames: the tool's frames in the flange frame.
        slices: least and greatest corners of the boxes it is made of, shape (m, 2, 3) [m].
        tip: least and greatest x, y, z of the tip.
        lever: those of the wall beside the grip.
    """

    frames: Mapping[str, Transform] = field(default_factory=lambda: _FRAMES)
    slices: Array = field(default_factory=lambda: _slices(), repr=False)
    tip: tuple[tuple[float, float, float], tuple[float, float, float]] = (
        (-0.008, -0.008, -0.0165),
        (0.008, 0.008, 0.0),
    )
    lever: tuple[tuple[float, float, float], tuple[float, float, float]] = (
        (-0.008, -0.008, 0.0),
        (0.0, 0.008, 0.0032),
    )

    def poses(self, subgoals: Iterable[Subgoal]) -> tuple[Transform, ...]:
        """Return the pose of the frame ``"tool"`` at each subgoal."""
        tool = self.frames["tool"]
        return tuple(g.pose @ inverse(self.frames[g.frame]) @ tool for g in subgoals)

    def boxes(self, poses: Sequence[Transform]) -> Array:
        """Return boxes along the outer axes around the slices at each pose, (k, 2, 3)."""
        low, high = self.slices[:, 0], self.slices[:, 1]
        middle, half = (low + high) / 2, (high - low) / 2
        out = []
        for pose in poses:
            centre = middle @ pose[:3, :3].T + pose[:3, 3]
            reach = half @ np.abs(pose[:3, :3]).T
            out.append(np.stack([centre - reach, centre + reach], axis=1))
        return np.concatenate(out)


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
    pose = top_pose(GRID, item.cell, item.brick)
    size = np.abs(pose[:3, :3]) @ box_size(item.brick)
    top = pose[:3, 3]
    half = np.array([size[0] / 2, size[1] / 2, 0.0])
    return np.stack([top - half - [0.0, 0.0, LAYER_HEIGHT], top + half])


def blocking(boxes: Array, bricks: BrickBoxes, *, clearance: float = 0.0) -> str | None:
    """Return the first brick that any of the boxes meets, ``PLATE`` for the plate.

    Args:
        boxes: shape (k, 2, 3) in the plate's frame [m].
        bricks: the bricks.
        clearance: distance that must be left [m]; by default touching is not meeting.

    Returns:
        A name, or None when there is room.
    """
    shrink = -clearance if clearance > 0.0 else TOUCH
    low, high = boxes[:, 0] + shrink, boxes[:, 1] - shrink
    if float(low[:, 2].min()) < 0.0:
        return PLATE
    them = bricks.corners
    apart = (low[:, None] >= them[None, :, 1]) | (high[:, None] <= them[None, :, 0])
    hit = np.flatnonzero(~apart.any(axis=2).all(axis=0))
    return bricks.names[int(hit[0])] if hit.size else None


def place_down_blocked(
    tool: BrickTool, item: PlacedBrick, press: Press, others: BrickBoxes
) -> str | None:
    """Return what leaves no room to put a brick down, None when there is room.

    Args:
        tool: the tool.
        item: the brick and its goal.
        press: the grip.
        others: boxes of the bricks that are there already.
    """
    targets = place_down_targets(tool.frames, item.brick, _top(item), press)
    first = blocking(tool.boxes(tool.poses(targets.subgoals)), others)
    return first or blocking(_above(item), others)


def place_up_blocked(
    tool: BrickTool, item: PlacedBrick, press: Press, others: BrickBoxes
) -> str | None:
    """Return what leaves no room to bring a brick in from below, None when there is room."""
    contact = place_up_contact(_top(item), item.brick, press)
    targets = place_up_targets(tool.frames, contact)
    boxes = tool.boxes(tool.poses(targets.subgoals))
    # Only what stands beside the brick may be touched; from the others planning keeps off.
    aloof = others.without(_beside(item, others))
    first = blocking(boxes, others) or blocking(boxes, aloof, clearance=KEPT)
    return first or blocking(_moved(item, contact, targets.subgoals[:2]), others)


def support_boxes(tool: BrickTool, support: Support, *, top: bool) -> Array:
    """Return boxes around a supporting tool, before and while it supports, (k, 2, 3) [m]."""
    targets = (support_top_targets if top else support_bottom_targets)(GRID, support)
    return tool.boxes(tool.poses((targets.pre[0], targets.support)))


def support_face(tool: BrickTool, support: Support, *, top: bool) -> Array:
    """Return the rectangle in which a supporting tool touches bricks, (2, 3) [m].

    That is the side of the tip that looks up for a support-bottom, the end of the lever wall
    for a support-top; in the plate's frame, its least and greatest corner.
    """
    targets = (support_top_targets if top else support_bottom_targets)(GRID, support)
    (pose,) = tool.poses((targets.support,))
    (x0, y0, z0), (x1, y1, z1) = tool.lever if top else tool.tip
    ends = [[x0, y0, z1], [x1, y1, z1]] if top else [[x1, y0, z0], [x1, y1, z1]]
    corners = np.array(ends) @ pose[:3, :3].T + pose[:3, 3]
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def attack_side(
    tool: BrickTool,
    item: PlacedBrick,
    press: Press,
    others: BrickBoxes,
    *,
    up: bool,
) -> int:
    """Return +1 or -1: the side to come from, past no neighbour if there is one, else +1.

    Args:
        tool: the tool.
        item: the brick and its goal.
        press: the grip.
        others: boxes of the bricks that are there already.
        up: True for a place-up.
    """
    contact = place_up_contact(_top(item), item.brick, press)
    for attack in (1, -1):
        if up:
            targets = place_up_targets(tool.frames, contact, attack=attack)
            way, goal = targets.subgoals[1:3], contact
        else:
            targets = place_down_targets(
                tool.frames, item.brick, _top(item), press, attack=attack
            )
            way, goal = targets.subgoals[:2], targets.subgoals[2].pose
        if blocking(_moved(item, goal, way), others) is None:
            return attack
    return 1


def _beside(item: PlacedBrick, others: BrickBoxes) -> set[str]:
    """Return the bricks of its own layer that touch a brick, corners included."""
    low, high = brick_box(item)
    them = others.corners
    near = (them[:, 0] <= high + TOUCH) & (them[:, 1] >= low - TOUCH)
    near[:, 2] = np.abs(them[:, 0, 2] - low[2]) < TOUCH
    return {others.names[k] for k in np.flatnonzero(near.all(axis=1))}


def _top(item: PlacedBrick) -> Transform:
    return top_pose(GRID, item.cell, item.brick)


def _above(item: PlacedBrick) -> Array:
    """Return the room of a brick that comes down the last two layers."""
    box = brick_box(item)
    box[0, 2] += LAYER_HEIGHT
    box[1, 2] += 2 * LAYER_HEIGHT
    return box[None]


def _moved(item: PlacedBrick, goal: Transform, way: Iterable[Subgoal]) -> Array:
    """Return a box around a brick on its straight way to its goal, shape (1, 2, 3).

    Args:
        item: the brick at its goal.
        goal: pose of the frame that carries it when the brick is there.
        way: subgoals of that frame before, with the same axes.
    """
    boxes = brick_box(item) + np.array(
        [(g.pose[:3, 3] - goal[:3, 3])[None] for g in way]
    )
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])[None]


def _slices() -> Array:
    def upright(low: float, high: float, half: float) -> list[list[float]]:
        return [[-half, -half, low], [half, half, high]]

    out = [upright(-0.111, -0.0605, 0.0472), upright(-0.0605, -0.0505, 0.040)]
    heights = np.linspace(-0.0505, -0.0165, _CONE_SLICES + 1)
    radii = np.linspace(0.0393, 0.011, _CONE_SLICES + 1)
    out += [upright(heights[k], heights[k + 1], radii[k]) for k in range(_CONE_SLICES)]
    out.append(upright(-0.0165, 0.0, 0.008))
    out.append([[-0.008, -0.008, 0.0], [0.0, 0.008, 0.0032]])
    out.append([[-0.008, -0.046, -0.0605], [0.008, -0.038, -0.0165]])
    slices = np.array(out)
    slices.setflags(write=False)
    return slices


_FRAMES: Mapping[str, Transform] = MappingProxyType(
    {
        "tool": translation(0.0, 0.0, 0.111),
        "assemble": translation(0.0078, 0.0, 0.1105),
        "disassemble": translation(0.0, 0.0, 0.120),
        "handover_assemble": translation(0.0078, 0.0, 0.1095),
        "alt": translation(-0.0174, 0.0, 0.1064),
        "alt_assemble": translation(-0.0078, 0.0, 0.1064),
    }
)
