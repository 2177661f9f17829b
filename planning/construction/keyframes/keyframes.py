"""Keyframes as data: configurations at mode switches, with time windows (Hartmann et al. IV-B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.construction.keyframes.step_scenes import Hold
from planning.construction.world.skill_motion import SkillMotion
from planning.transforms import Array


@dataclass(frozen=True)
class Keyframe:
    """A motion for one skill, and the time windows in which it can begin.

    Attributes:
        motion: of the skill, the configuration at the switch in the middle of it.
        windows: spans of time in which the skill may begin, among all that is fixed, shape
            (w, 2) [s].
    """

    motion: SkillMotion
    windows: Array

    @property
    def start(self) -> Array:
        """Configuration at which the skill begins, shape (n,)."""
        return np.asarray(self.motion.path[0])

    @property
    def earliest(self) -> float:
        """Earliest time at which the skill can begin [s]."""
        return float(self.windows[0, 0])


@dataclass(frozen=True)
class Meeting:
    """A handover of the part: the giver's keyframe and the taker's configuration.

    Attributes:
        giver: the skill of the robot that brings the part to the other one's pad.
        taker: where that one stands meanwhile, shape (n,).
    """

    giver: Keyframe
    taker: Array


@dataclass(frozen=True)
class Keyframes:
    """Consistent alternatives for all mode switches of a sub-problem.

    Every pick goes with every meeting and every place: they hold the part alike.

    Attributes:
        holds: how each robot that has the part holds it, in order.
        picks: ways to pick it, the most promising first.
        places: ways to place it, likewise.
        meetings: ways to hand it over, likewise; empty where one robot does all.
    """

    holds: tuple[Hold, ...]
    picks: tuple[Keyframe, ...]
    places: tuple[Keyframe, ...]
    meetings: tuple[Meeting, ...] = ()
