"""Pick-and-place assemblies as data: where every part goes, in which order, held how."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from planning.transforms import Transform

DOWN = (0.0, 0.0, -1.0)
"""The direction of a tool that points straight down, in the world."""


@dataclass(frozen=True)
class GripRules:
    """Rules for the grips that are tried.

    A tool frame's z axis points out of the hand and its fingers close along y.

    Attributes:
        frame: name of the tool frame, a key of ``RobotModel.frames``.
        positions: number of places along a part's longest edge.
        end_margin: distance of the outermost place from the end of the part [m].
        opening: widest edge that fits between the fingers [m].
        depth: how far the tool frame goes below the face it comes from; never beyond the
            middle of the part [m].
        directions: unit vectors in the world along which the tool may point, each (3,).
        steepest: largest angle between the tool and the nearest of them, where a part is
            picked and where it is placed [rad].
        tilts: leanings of the tool about the axis along which its fingers close [rad].
    """

    frame: str = "tool"
    positions: int = 5
    end_margin: float = 0.02
    opening: float = 0.04
    depth: float = 0.03
    directions: tuple[tuple[float, float, float], ...] = (DOWN,)
    steepest: float = float(np.radians(60.0))
    tilts: tuple[float, ...] = (0.0,)


@dataclass(frozen=True)
class PickPlaceAssembly:
    """A pick-and-place assembly: goal poses of parts, in order.

    Attributes:
        goals: pose of the centre of every part that is placed, in the world.
        steps: names of the parts in the order in which they are placed.
        approach: way straight towards a part before it is gripped, and straight down with it
            before it is put in place [m].
        leave: way straight up with a part after it is gripped, and straight back from it after
            it is put in place [m].
        touch: parts that are nearer to each other than this touch [m].
        grips: which grips are tried.
    """

    goals: Mapping[str, Transform]
    steps: tuple[str, ...]
    approach: float = 0.06
    leave: float = 0.06
    touch: float = 0.002
    grips: GripRules = field(default_factory=GripRules)
