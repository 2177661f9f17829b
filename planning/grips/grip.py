"""Grips on a part of any shape, between two fingers or by suction, and the rules for them.

The z axis of a tool frame points out of the hand; fingers close along its y axis. Boxes are gripped at their faces.
On other shapes, lines through the convex pieces are used to find opposite faces with free space for fingers, and
flat areas for a suction cup.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from planning.cell.robot_model import ToolGrip
from planning.transforms import Array, Transform, read_only_copy

CupPoints = tuple[tuple[float, float], ...]

USUAL_CUP = 0.01
"""Radius of a cup where neither the rules nor the tool's shapes tell it [m]."""

DOWN = (0.0, 0.0, -1.0)
"""The direction of a tool that points straight down, in the world."""

UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class GripRules:
    """Rules for candidate grips.

    A tool frame's z axis points out of the hand and its fingers close along y.

    All but the last two are the keys of ``assembly.grips`` in a scenario, without their units: lengths are
    in metres, angles in radians, directions are unit vectors.

    Attributes:
        least_opening: narrowest part that the fingers hold [m].
        lips: points of the tool's cups that must be on the part; none for a ring of radius ``cup`` [m].
    """

    frame: str = "tool"
    positions: int = 5
    end_margin: float = 0.02
    opening: float = 0.04
    depth: float = 0.03
    directions: tuple[tuple[float, float, float], ...] = (DOWN,)
    steepest: float = float(np.radians(60.0))
    tilts: tuple[float, ...] = (0.0,)
    around: float = float(np.radians(45.0))
    finger_width: float = 0.02
    finger_depth: float = 0.01
    suction: bool = False
    cup: float | None = None
    least_opening: float = 0.0
    lips: CupPoints = ()

    def spans(self, width: float) -> bool:
        """Tell whether the fingers open to a width [m]."""
        return self.least_opening <= width <= self.opening

    def offsets(self, length: float) -> list[float]:
        """Return the grip positions along a part of a given length, from its middle [m]."""
        reach = 0.5 * length - self.end_margin
        if self.positions == 1 or reach <= 0.0:
            return [0.0]
        return [float(at) for at in np.linspace(-reach, reach, self.positions)]

    def allow(self, grip: Transform, *parts: Transform) -> bool:
        """Tell whether the tool points along an allowed direction at all given poses of the part.

        Args:
            grip: pose of the tool frame in the frame of the part.
            parts: poses of that in the world.
        """
        pointing = [pose[:3, :3] @ grip[:3, 2] for pose in parts]
        nearest = (max(float(np.dot(p, d)) for d in self.directions) for p in pointing)
        return all(near >= math.cos(self.steepest) - 1e-9 for near in nearest)


@dataclass(frozen=True)
class Grip:
    """A grip on a part.

    Attributes:
        pose: of the tool frame in the frame of the part.
        words: description for messages.
        tool: the kind of tool; None where unknown.
    """

    pose: Transform
    words: str
    tool: ToolGrip | None = None


def tool_turn(z: Array, y: Array) -> Array:
    """Return the rotation of a tool that points along ``z`` and closes along ``y``."""
    return np.column_stack([np.cross(y, z), y, z])


def lean_angle(angle: float) -> Array:
    """Return the tilt of a tool about its closing axis [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def box_grips(
    size: Array, start: Transform, goal: Transform, rules: GripRules
) -> list[Grip]:
    """Return the grips that allow a box to be picked and placed.

    The tool points into a face, its fingers close on the two faces beside it, and it may lean
    about the closing axis. What is left are grips whose tool points in a wanted direction both
    where the box is picked and where it is placed, and whose fingers span the box. Places
    nearest to the middle come first.

    Args:
        size: edge lengths, shape (3,) [m].
        start, goal: poses of the box centre in the world.
        rules: which grips are tried.
    """
    longest = int(np.argmax(size))
    out: list[tuple[float, Grip]] = []
    for face, side, closing, sign in product(range(3), (1, -1), range(3), (1, -1)):
        if face == closing or not rules.spans(size[closing]):
            continue
        along = 3 - face - closing
        offsets = rules.offsets(float(size[along])) if along == longest else [0.0]
        into, across = np.zeros(3), np.zeros(3)
        into[face], across[closing] = -side, sign
        turn = tool_turn(into, across)
        for offset, tilt in product(offsets, dict.fromkeys(rules.tilts)):
            pose = np.eye(4)
            pose[:3, :3] = turn @ lean_angle(tilt)
            if not rules.allow(pose, start, goal):
                continue
            pose[along, 3] = offset
            # From the middle towards the face that the tool comes from.
            pose[face, 3] = side * max(0.0, 0.5 * size[face] - rules.depth)
            words = f"grip {offset * 1e3:+.0f} mm from {'+' if side > 0 else '-'}{'xyz'[face]}"
            words += " turned" if sign < 0 else ""
            words += f" leaning {np.degrees(tilt):+.0f} deg" if tilt else ""
            out.append((abs(offset), Grip(read_only_copy(pose), words)))
    return [grip for _, grip in sorted(out, key=lambda entry: round(entry[0], 9))]
